from pathlib import Path
from types import SimpleNamespace

import pytest

from cli import reference_choice
from cli.reference_choice import choose_reference
from diagnosis.loading.kept_reference import (
    WITHOUT_REFERENCE,
    advice,
    kept_reference,
    with_reference_stated,
    words_of_days,
)
from diagnosis.verdict import Diagnosis, VerdictKind
from machine.errors import UsageError


@pytest.fixture(autouse=True)
def logs_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    """Logs are told by their names: what is in them is not read."""

    def load(paths: list[Path]) -> SimpleNamespace:
        files = [f for p in paths for f in (sorted(p.rglob("*.mcap")) if p.is_dir() else [p])]
        throws = [SimpleNamespace(throw_id=f.stem, machine_id="yard-1") for f in files]
        return SimpleNamespace(throws=throws, refused=[])

    monkeypatch.setattr(reference_choice, "load_throws", load)


def keep(machines: Path, day: str, count: int) -> None:
    folder = kept_reference(machines, "yard-1").folder / day
    folder.mkdir(parents=True)
    for number in range(count):
        (folder / f"{day}-{number:02d}.mcap").touch()


def diagnosed(*throw_ids: str) -> SimpleNamespace:
    throws = [SimpleNamespace(throw_id=i, machine_id="yard-1") for i in throw_ids or ("today-1",)]
    return SimpleNamespace(throws=throws)


def test_kept_throws_are_taken_without_asking_and_named_by_day(tmp_path: Path) -> None:
    keep(tmp_path, "2026-05-01", 12)
    keep(tmp_path, "2026-05-02", 12)
    found = choose_reference((), diagnosed(), (tmp_path / "nothing", tmp_path))
    assert found.throws is not None
    assert len(found.throws.throws) == 24
    assert found.days == {"2026-05-01": 12, "2026-05-02": 12}
    assert "24 reference throws of 2026-05-01 and 2026-05-02" in found.words
    assert "recommended" not in found.words


def test_throws_that_are_diagnosed_are_no_reference_of_themselves(tmp_path: Path) -> None:
    keep(tmp_path, "2026-05-01", 13)
    found = choose_reference((), diagnosed("2026-05-01-03"), (tmp_path,))
    assert found.throws is not None
    assert "2026-05-01-03" not in [t.throw_id for t in found.throws.throws]
    assert found.days == {"2026-05-01": 12}
    assert "24 over two days are recommended" in found.words


def test_six_kept_throws_are_too_few(tmp_path: Path) -> None:
    keep(tmp_path, "2026-05-01", 6)
    found = choose_reference((), diagnosed(), (tmp_path,))
    assert found.throws is None
    assert "6 reference throws are too few, at least 12" in found.words


def test_none_turns_kept_throws_off(tmp_path: Path) -> None:
    keep(tmp_path, "2026-05-01", 24)
    assert choose_reference(("none",), diagnosed(), (tmp_path,)).throws is None
    with pytest.raises(UsageError, match="stands alone"):
        choose_reference(("none", "logs"), diagnosed(), (tmp_path,))


def test_too_few_given_throws_are_refused(tmp_path: Path) -> None:
    keep(tmp_path, "2026-05-01", 6)
    with pytest.raises(UsageError, match="6 usable reference throws, at least 8"):
        choose_reference((str(tmp_path),), diagnosed(), ())
    keep(tmp_path, "2026-05-02", 4)
    found = choose_reference((str(tmp_path),), diagnosed(), ())
    assert found.throws is not None
    assert found.words == "compared with 10 reference throws; 12 or more are better"


def test_where_nothing_is_kept_the_remedy_is_named(tmp_path: Path) -> None:
    found = choose_reference((), diagnosed(), (tmp_path,))
    assert found.throws is None
    assert "none of yard-1 are kept; `downrange commission`" in found.words


def test_an_answer_without_reference_throws_says_so_first() -> None:
    found = Diagnosis(verdict=VerdictKind.NONE, sentence="Nothing.", evidence={"reference": None})
    assert with_reference_stated(found, {}).sentence == f"{WITHOUT_REFERENCE} Nothing."
    bad = Diagnosis(verdict=VerdictKind.BAD_DATA, sentence="Too few.")
    assert with_reference_stated(bad, {}) is bad
    known = found.model_copy(update={"evidence": {"reference": {"throws_count": 24}}})
    stated = with_reference_stated(known, {"2026-05-01": 24})
    assert stated.sentence == "Nothing."
    assert stated.evidence["reference"]["days"] == {"2026-05-01": 24}


def test_words() -> None:
    assert words_of_days({}) == "no reference throws"
    three = {"2026-05-01": 8, "2026-05-02": 8, "2026-05-03": 8}
    assert words_of_days(three) == "24 reference throws of 2026-05-01, 2026-05-02 and 2026-05-03"
    assert advice(three) == ""
    assert "another day" in advice({"2026-05-01": 30})
