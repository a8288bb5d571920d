"""The verb `challenge`: its actions are reached, and what cannot work is refused in one line."""

import hashlib
import json
from pathlib import Path

import pytest

from cli.main import main


def sealed_and_answers(folder: Path) -> tuple[Path, Path]:
    sealed, answers = folder / "truth.json", folder / "answers.json"
    truth = {
        "set_id": "set-0001",
        "tier": "null",
        "unit_seed": 0,
        "seed": 1,
        "effects": [],
        "landed_count": 12,
    }
    sealed.write_text(json.dumps({"sets": [truth]}))
    said = {"verdict": "explained", "causes": [{"effects": [], "probability": 1.0, "name": "none"}]}
    answers.write_text(
        json.dumps(
            {
                "schema_version": 1,
                "method": "diagnose",
                "sealed_sha256": hashlib.sha256(sealed.read_bytes()).hexdigest(),
                "sets": {"set-0001": {"seconds": 2.0, "said": said}},
            }
        )
    )
    return sealed, answers


def test_score_prints_a_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sealed, answers = sealed_and_answers(tmp_path)
    numbers = tmp_path / "numbers.json"
    more = ["--sealed", str(sealed), "--mistakes", "--json", str(numbers)]
    assert main(["challenge", "score", str(answers), *more]) == 0
    alarms = json.loads(numbers.read_text())["diagnose"]["false alarms on null"]
    assert alarms["value"] == 1.0
    assert alarms["count"] == 1
    out = capsys.readouterr().out
    assert "false alarms on null" in out
    assert "100.0 % [21, 100] (n 1)" in out
    assert "set-0001 null" in out


def test_a_changed_truth_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sealed, answers = sealed_and_answers(tmp_path)
    sealed.write_text(sealed.read_text() + "\n")
    assert main(["challenge", "score", str(answers), "--sealed", str(sealed)]) == 1
    assert "was changed" in capsys.readouterr().err


REFUSED = (
    (["make", "--seed", "-1", "--out", "{0}/d", "--sealed", "{0}/s.json"], "at least 0"),
    (["make", "--seed", "1", "--out", "{0}/d", "--sealed", "{0}/d/s.json"], "inside"),
    (["run", "{0}", "--json", "{0}/a.json"], "no challenge"),
    (["run", "{0}", "--json", "{0}/a.json", "--jobs", "0"], "at least 1"),
    (["score", "{0}/none.json", "--sealed", "{0}/s.json"], "no answers"),
)
"""Arguments that cannot work, and what the message says; {0} is the folder."""


def test_what_cannot_work_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for arguments, reason in REFUSED:
        assert main(["challenge", *(text.format(tmp_path) for text in arguments)]) == 1, arguments
        assert reason in capsys.readouterr().err, arguments
