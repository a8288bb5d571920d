"""A training that is killed goes on with the same line, and ends where an uninterrupted one ends."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from machine.errors import UsageError
from machine.policy_card import POLICY_FILE, file_sha256, load_card
from machine.spec import load_spec
from runtime.control.policy import PolicyRunner
from training.checkpoint import CHECKPOINT_FILE, load_checkpoint
from training.ppo import Learner
from training.progress import CSV_FILE, CURVE_FILE, SUMMARY_FILE, read_rows

ROOT = Path(__file__).parents[2]
ITERATIONS, ENVIRONMENTS = 40, 4

pytestmark = pytest.mark.long


IDENTIFIED = {
    "machine_id": "m9",
    "result": {"training": {"telescope": {"gain_positive_ratio": [0.92, 0.96]}}},
}


def _command(out: Path) -> list[str]:
    response = out / "m9.json"
    response.write_text(json.dumps(IDENTIFIED), encoding="utf-8")
    return [
        *(sys.executable, "-m", "cli.main", "train", "--mode", "2d", "--device", "cpu"),
        *("--iterations", str(ITERATIONS), "--environments", str(ENVIRONMENTS)),
        *("--throws", "0", "--seed", "2", "--checkpoint-seconds", "0", "--out", str(out)),
        *("--response", str(response)),
    ]


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The processes compile once between them, and quickly."""
    return {
        **os.environ,
        "JAX_COMPILATION_CACHE_DIR": str(tmp_path_factory.mktemp("compiled")),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.3",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
        "JAX_DISABLE_MOST_OPTIMIZATIONS": "1",
    }


def _run(command: list[str], environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False, timeout=280
    )


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory, environment: dict[str, str]) -> Path:
    """A run that nobody interrupts."""
    out = tmp_path_factory.mktemp("whole")
    done = _run(_command(out), environment)
    assert done.returncode == 0, done.stderr[-2000:]
    assert f"wrote {out / 'm545-2d-local'}" in done.stdout
    assert "telescope: from the files gain positive 0.915..0.965; built in dead time" in done.stdout
    return out


@pytest.fixture(scope="module")
def killed(
    tmp_path_factory: pytest.TempPathFactory, environment: dict[str, str], whole: Path
) -> Path:
    """The same run, killed once it has a checkpoint."""
    out = tmp_path_factory.mktemp("killed")
    with subprocess.Popen(
        _command(out),
        cwd=ROOT,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as process:
        deadline = time.monotonic() + 250.0
        while not (out / CHECKPOINT_FILE).is_file() and process.poll() is None:
            assert time.monotonic() < deadline, "no checkpoint in 250 s"
            time.sleep(0.005)
        process.send_signal(signal.SIGKILL)
    assert process.returncode == -signal.SIGKILL
    assert not (out / "m545-2d-local").exists()
    return out


def test_a_run_leaves_metrics_a_curve_and_a_policy_that_loads(whole: Path):
    rows = read_rows(whole / CSV_FILE)
    assert [row.iteration_count for row in rows] == list(range(1, ITERATIONS + 1))
    steps = ENVIRONMENTS * 32
    assert rows[-1].environment_step_count == ITERATIONS * steps
    assert all(np.isfinite(row.reward_ratio) for row in rows)
    assert (whole / CURVE_FILE).read_bytes().startswith(b"\x89PNG")
    summary = json.loads((whole / SUMMARY_FILE).read_text(encoding="utf-8"))
    assert summary["last"]["iteration_count"] == ITERATIONS
    runner = PolicyRunner(whole / "m545-2d-local", load_spec())
    assert np.isfinite(runner.act(np.zeros((3, 57)))).all()
    record = runner.card.training
    assert (record.iteration_count, record.seed_count) == (ITERATIONS, 2)
    assert record.environment_step_count == ITERATIONS * steps
    assert record.config["ppo"]["environment_count"] == ENVIRONMENTS
    assert record.config["task"]["mode"] == "2d"
    assert record.wall_s > 0.0
    # What was identified is what was drawn, and the card says where from.
    response = record.config["task"]["response"]
    assert response["gain_positive_min_ratio"][3] == pytest.approx(0.915)
    assert response["gain_positive_max_ratio"][3] == pytest.approx(0.965)
    (source,) = record.config["response_sources"]
    assert source == {
        "file": "m9.json",
        "machine_id": "m9",
        "sha256": file_sha256(whole / "m9.json"),
    }


def test_a_killed_run_goes_on_and_ends_as_if_it_had_not_been_killed(
    whole: Path, killed: Path, environment: dict[str, str]
):
    before = read_rows(killed / CSV_FILE)
    assert 20 <= len(before) < ITERATIONS
    # A kill between metrics and checkpoint leaves rows, or half a row, of iterations that are run again.
    with (killed / CSV_FILE).open("a", newline="", encoding="utf-8") as stream:
        last = (killed / CSV_FILE).read_text(encoding="utf-8").splitlines()[-1]
        later = last.replace(str(len(before)), str(len(before) + 1), 1)
        stream.write(f"{later}\r\n{later[:40]}")
    done = _run(_command(killed), environment)
    assert done.returncode == 0, done.stderr[-2000:]
    resumed = int(done.stdout.split("at iteration ")[1].split()[0])
    assert 20 <= resumed < ITERATIONS
    rows, expected = read_rows(killed / CSV_FILE), read_rows(whole / CSV_FILE)
    assert [row.iteration_count for row in rows] == list(range(1, ITERATIONS + 1))
    wall = [row.wall_s for row in rows]
    assert wall == sorted(wall)
    for ours, theirs in zip(rows, expected, strict=True):
        assert {**vars(ours), "wall_s": 0.0} == pytest.approx(
            {**vars(theirs), "wall_s": 0.0}, nan_ok=True
        )
    names = ("m545-2d-local", POLICY_FILE)
    assert killed.joinpath(*names).read_bytes() == whole.joinpath(*names).read_bytes()
    ours, theirs = (load_card(folder / "m545-2d-local").training for folder in (killed, whole))
    assert ours.environment_step_count == theirs.environment_step_count
    with np.load(killed / CHECKPOINT_FILE) as one, np.load(whole / CHECKPOINT_FILE) as other:
        assert set(one) == set(other)
        for name in one:
            np.testing.assert_array_equal(one[name], other[name], err_msg=name)


def test_another_configuration_does_not_go_on_from_this_checkpoint(whole: Path, tmp_path: Path):
    # The fingerprint is looked at before the learner it would fill.
    nothing = cast(Learner, None)
    with pytest.raises(UsageError, match="was written under another configuration"):
        load_checkpoint(whole / CHECKPOINT_FILE, nothing, "another")
    damaged = tmp_path / CHECKPOINT_FILE
    damaged.write_bytes((whole / CHECKPOINT_FILE).read_bytes()[:1000])
    for path in (damaged, tmp_path / "missing.npz"):
        with pytest.raises(UsageError, match="not a readable checkpoint"):
            load_checkpoint(path, nothing, "any")
