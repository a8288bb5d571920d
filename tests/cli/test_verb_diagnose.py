"""`downrange diagnose throws` with healthy throws to compare with: options, JSON, report, refusals."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from cli import diagnose as verb
from cli import reference_choice
from cli.main import main
from diagnosis.loading.throw_data import LoadedSet
from diagnosis.reference_throws import reference_evidence
from diagnosis.verdict import Diagnosis, VerdictKind
from sim_twin.twin.profile import TwinProfile
from tests.diagnosis.twin_throws import throws


def load(paths: Sequence[Path]) -> LoadedSet:
    """Four throws of the twin for each folder, named after it."""
    found = throws((), 4)
    named = [
        replace(throw, throw_id=f"{path.name}-{throw.throw_id}")
        for path in paths
        for throw in found.throws
    ]
    return replace(found, throws=tuple(named))


def compared(
    loaded: LoadedSet, twin: TwinProfile, progress: object, *, reference: LoadedSet, **_: object
) -> Diagnosis:
    """Takes a minute in truth; here it says only what it was given."""
    used = [throw.throw_id for throw in loaded.throws]
    evidence = {"throws_used": used, "reference": reference_evidence(reference)}
    return Diagnosis(verdict=VerdictKind.NONE, sentence="No effect.", evidence=evidence)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(verb, "load_throws", load)
    monkeypatch.setattr(reference_choice, "load_throws", load)


def test_reference_throws_come_from_all_folders_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(verb, "diagnose_throws", compared)
    result, page = tmp_path / "gap.json", tmp_path / "gap.html"
    asked = ["--reference", "week1", "today", "--reference", "week2"]
    code = main(["diagnose", "throws", *asked, "--json", str(result), "--html", str(page)])
    assert code == 0
    evidence = json.loads(result.read_text())["evidence"]
    assert evidence["throws_used"] == [f"today-twin-{i:04d}" for i in range(4)]
    assert evidence["reference"] == {
        "throws_count": 8,
        "throw_ids": [f"{week}-twin-{i:04d}" for week in ("week1", "week2") for i in range(4)],
        "refused": [],
        "kept_utc": None,
    }
    assert "<dt>Compared with</dt><dd>8 healthy throws of this machine</dd>" in page.read_text()


def test_a_throw_in_both_sets_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        main(["diagnose", "throws", "today", "--reference", "today", "--reference", "week1"]) == 1
    )
    assert "4 throws are to be diagnosed and are reference throws" in capsys.readouterr().err
