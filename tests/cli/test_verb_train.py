"""`downrange train`: what it refuses. What it writes is in tests/training/test_train_resume.py."""

import json
import os
from pathlib import Path

import pytest

from cli.main import main


@pytest.fixture(autouse=True)
def _same_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """The verb chooses JAX's platform for its process; this one goes on."""
    monkeypatch.setenv("JAX_PLATFORMS", os.environ.get("JAX_PLATFORMS", "cpu"))


def train(out: Path, *more: str) -> int:
    return main(["train", "--mode", "2d", "--device", "cpu", "--out", str(out), *more])


def test_help_explains_itself_to_a_newcomer(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["train", "--help"])
    assert end.value.code == 0
    text = capsys.readouterr().out
    for word in (
        "--mode",
        "{2d,3d}",
        "--out",
        "--iterations",
        "--environments",
        "--response",
        "after an interruption",
    ):
        assert word in text


BAD_VALUES = (
    (["--iterations", "0"], "iterations must be 1 or more, is 0"),
    (["--iterations", "-5"], "iterations must be 1 or more, is -5"),
    (["--environments", "0"], "0 environments do not split into 4 minibatches"),
    (["--environments", "10"], "10 environments do not split into 4 minibatches"),
    (["--environments", "-8"], "-8 environments"),
    (["--seed", "-1"], "seed must be 0 or more, is -1"),
    (["--throws", "-1"], "throws must be 0 or more, is -1"),
    (["--unroll", "0"], "unroll must be 1 or more, is 0"),
    (["--seconds", "0"], "seconds must be more than 0, is 0"),
    (["--seconds", "nan"], "seconds must be more than 0, is nan"),
    (["--policy-id", "My Policy"], "policy id 'My Policy' does not fit"),
    (["--policy-id", "../up"], "policy id '../up' does not fit"),
    (["--response"], "--response needs files"),
    (["--response", "no.json"], "response no.json cannot be read (No such file or directory)"),
)


def test_what_cannot_work_is_one_clear_line_before_anything_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    for options, words in BAD_VALUES:
        assert train(out, *options) == 1, options
        error = capsys.readouterr().err
        assert error.startswith("downrange train: ")
        assert words in error
        assert error.count("\n") == 1
        assert not out.exists()


WRONG_OPTIONS = (
    (["--mode", "4d"], "4d"),
    (["--mode", "2d"], "--out"),
    (["--mode", "2d", "--out", "x", "--iterations", "many"], "many"),
    (["--mode", "2d", "--out", "x", "--wrong", "1"], "--wrong"),
)


def test_a_wrong_option_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    for options, words in WRONG_OPTIONS:
        with pytest.raises(SystemExit) as end:
            main(["train", *options])
        assert end.value.code == 1, "2 is an ambiguity"
        assert words in "".join(capsys.readouterr()), options


def test_a_folder_that_cannot_be_written_is_refused_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "file"
    file.write_text("not a folder")
    for out in (file, file / "below"):
        assert train(out) == 1
        error = capsys.readouterr().err
        assert f"cannot write to {out}" in error
        assert "choose another --out" in error


def test_every_response_file_is_looked_at_however_often_the_option_is_given(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good = tmp_path / "good.json"
    training = {"boom": {"gain_positive_ratio": [0.9, 1.0]}}
    good.write_text(json.dumps({"machine_id": "m1", "result": {"training": training}}))
    one = str(good)
    for words in (
        ["--response", one, "--response", one, "no.json"],
        ["--response", "no.json", "--response", one],
    ):
        assert train(tmp_path / "run", *words) == 1
        printed = capsys.readouterr()
        assert "response no.json cannot be read" in printed.err
        assert printed.out == ""
    assert not (tmp_path / "run").exists()
