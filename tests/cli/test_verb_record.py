from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from cli.main import main
from machine.messages import EventKind
from machine.spec import load_spec
from runtime.records.log_reader import read_throw_log
from tests.cases import each


def record(policies: Path, out: Path, *more: str) -> int:
    return main(
        [
            "record",
            "--mode",
            "2d",
            "--plant",
            "twin",
            "--policies",
            str(policies),
            "--out",
            str(out),
            *more,
        ]
    )


def test_logs_hold_what_a_machine_would_have_written(
    swing_policies: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "logs"
    assert record(swing_policies, out, "--throws", "4", "--targets", "6,6.5", "--seed", "2") == 0
    files = sorted(out.iterdir())
    assert [f.name for f in files] == [f"twin-0-2d-s2-{i:04d}.mcap" for i in range(4)]
    assert "4 logs" in capsys.readouterr().out
    logs = [read_throw_log(f) for f in files]
    assert [log.metadata["target"]["x_m"] for log in logs] == [6.0, 6.5, 6.0, 6.5]
    landed = [log for log in logs if log.impact is not None]
    assert landed, "at least one of four throws lands"
    for log in logs:
        assert log.is_complete
        assert log.metadata["model_sha256"] == load_spec().sha256
        assert len(log.metadata["calibration"]["tables"]) == 4
        assert (np.diff(log.control["t_mono_ns"]) == 10_000_000).all()
        assert (np.diff(log.policy["t_mono_ns"]) == 80_000_000).all()
        assert (np.diff(log.imu["t_mono_ns"]) > 0).all()
        assert len(log.imu) >= len(log.control)
        kinds = [event.kind for event in log.events]
        assert kinds[0] is EventKind.THROW_STARTED
        assert kinds[-1] is EventKind.THROW_ENDED
        times = [event.t_mono_ns for event in log.events]
        assert times == sorted(times)
    for log in landed:
        kinds = [event.kind for event in log.events]
        assert EventKind.RELEASE_COMMANDED in kinds
        assert EventKind.IMPACT in kinds
        assert log.impact is not None
        assert np.linalg.norm(log.ball["position_m"][-1] - log.impact.position_m) < 0.3
        assert log.control["payload_held"][0]
        assert not log.control["payload_held"][-1]
        assert log.metadata["result"]["outcome"] == "landed"


def test_two_recordings_with_one_seed_are_the_same_throws(
    swing_policies: Path, tmp_path: Path
) -> None:
    for name in ("a", "b"):
        assert record(swing_policies, tmp_path / name, "--throws", "1", "--targets", "6") == 0
    one, two = (read_throw_log(next((tmp_path / name).iterdir())) for name in ("a", "b"))
    np.testing.assert_array_equal(
        one.control["valve_applied_ratio"], two.control["valve_applied_ratio"]
    )
    assert one.impact == two.impact


def test_a_folder_that_cannot_be_made_is_an_error(
    swing_policies: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    assert record(swing_policies, blocked / "logs", "--throws", "1", "--targets", "6") == 1
    assert "cannot make the folder" in capsys.readouterr().err


def test_help_explains_itself_to_a_newcomer(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["record", "--help"])
    text = capsys.readouterr().out
    for word in ("--out", "--throws", "MCAP", "Example"):
        assert word in text


def test_logs_carry_the_twin_profile_of_their_machine(
    swing_policies: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert record(swing_policies, tmp_path / "twin", "--throws", "1", "--targets", "6") == 0
    (path,) = (tmp_path / "twin").iterdir()
    own = read_throw_log(path).metadata
    assert own["twin_profile"]["machine_id"] == "nominal"
    assert own["twin_profile_version"] == own["twin_profile"]["version_count"] == 0


def test_modes_take_turns_under_the_machines_own_name_and_clock(
    swing_policies: Path, tmp_path: Path
) -> None:
    out = tmp_path / "logs"
    more = ("--mode", "both", "--machine-id", "yard-1", "--throws", "4", "--targets", "6")
    assert record(swing_policies, out, *more, "--seed", "1") == 0
    assert record(swing_policies, out, *more, "--seed", "2") == 0
    logs = [
        read_throw_log(out / f"yard-1-2d-3d-s{s}-{i:04d}.mcap") for s in (1, 2) for i in range(4)
    ]
    assert {log.metadata["machine_id"] for log in logs} == {"yard-1"}
    assert [log.metadata["mode"] for log in logs] == ["2d", "3d", "2d", "3d"] * 2
    for earlier, later in pairwise(logs):
        end_ns = earlier.control["t_mono_ns"][-1]
        assert later.control["t_mono_ns"][0] > end_ns
        assert later.imu["t_mono_ns"][0] > end_ns
        assert later.events[0].t_mono_ns == later.control["t_mono_ns"][0]
        assert later.impact is None or later.impact_t_mono_ns > later.control["t_mono_ns"][0]


@each(
    ("more", "reason"),
    [
        (("--machine-id", "Yard 1"), "--machine-id"),
        (("--mode", "both", "--policy", "x"), "--policy is of one mode"),
    ],
)
def test_options_that_cannot_work_are_explained(
    swing_policies: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    more: tuple[str, ...],
    reason: str,
) -> None:
    assert record(swing_policies, tmp_path, *more) == 1
    assert reason in capsys.readouterr().err
