"""Models of healthy machines are estimated once, kept to the last bit, and never read damaged."""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from diagnosis import reference_throws
from diagnosis.healthy.health import Health
from diagnosis.healthy.health_store import KEPT_COUNT, HealthStore, health_key, health_store
from diagnosis.reference_throws import kept_or_estimated
from tests.diagnosis.twin_throws import health, profile, throws


@pytest.fixture(scope="module")
def own() -> Health:
    """The model of a machine, with numbers that have no short decimal form."""
    known = health()
    gap = {"2d": float(np.float64(1.0) / 3.0), "3d": 0.1 + 0.2}
    noise = known.noise.model_copy(update={"healthy_gap_m": gap})
    return known._replace(noise=noise, profile=profile(), replay_gap_m={"2d": 0.1 + 0.2})


def test_what_is_kept_comes_back_to_the_last_bit(tmp_path: Path, own: Health) -> None:
    store = HealthStore(tmp_path / "m001.health")
    assert store.find("a") is None
    store.keep("a", own)
    found = store.find("a")
    assert found is not None
    assert found.health == own
    assert found.estimated_utc.endswith("Z")


def test_a_damaged_file_counts_as_none(tmp_path: Path, own: Health) -> None:
    store = HealthStore(tmp_path)
    store.keep("a", own)
    path = tmp_path / "a.json"
    whole = path.read_text()
    for damaged in (whole[:-40], whole.replace("0.3", "0.4"), whole[70:], ""):
        path.write_text(damaged)
        assert store.find("a") is None
    store.keep("a", own)
    assert store.find("a") is not None


def test_a_model_that_a_file_would_change_is_not_kept(tmp_path: Path, own: Health) -> None:
    noise = own.noise.model_copy(update={"note": None})
    HealthStore(tmp_path).keep("a", own._replace(noise=noise))
    assert not list(tmp_path.iterdir())


def test_the_models_used_last_stay(tmp_path: Path, own: Health) -> None:
    store = HealthStore(tmp_path)
    for number in range(KEPT_COUNT):
        store.keep(str(number), own)
        os.utime(tmp_path / f"{number}.json", (number, number))
    assert store.find("0") is not None
    store.keep("new", own)
    assert {path.stem for path in tmp_path.iterdir()} == {"0", "2", "3", "new"}


def test_many_may_read_and_write_one_folder(tmp_path: Path, own: Health) -> None:
    def work(number: int) -> bool:
        store = HealthStore(tmp_path)
        store.keep(str(number % 3), own)
        found = store.find(str((number + 1) % 3))
        return found is None or found.health == own

    with ThreadPoolExecutor(8) as pool:
        assert all(pool.map(work, range(24)))
    assert {path.name for path in tmp_path.iterdir()} == {"0.json", "1.json", "2.json"}


def test_a_folder_that_cannot_be_written_keeps_nothing(tmp_path: Path, own: Health) -> None:
    (tmp_path / "file").touch()
    store = HealthStore(tmp_path / "file")
    store.keep("a", own)
    assert store.find("a") is None


def test_names_of_machines_stay_in_the_folder(tmp_path: Path, own: Health) -> None:
    health_store(tmp_path / "machines", "../../escape").keep("a", own)
    assert [path.name for path in tmp_path.iterdir()] == ["machines"]


def test_the_key_is_what_a_model_is_estimated_from() -> None:
    known, twin, reference = health(), profile(), throws(count=3).throws
    key = health_key(reference, twin, known)
    moved = tuple(replace(t, path=Path("elsewhere.mcap")) for t in reference)
    assert health_key(moved, twin, known) == key
    later = replace(reference[0], valve_ratio=np.nextafter(reference[0].valve_ratio, 2.0))
    others = {
        health_key((later, *reference[1:]), twin, known),
        health_key(reference[::-1], twin, known),
        health_key(reference[:2], twin, known),
        health_key(reference, twin.model_copy(update={"version_count": 7}), known),
        health_key(reference, twin, known._replace(noise=known.noise.with_jitter(0.01))),
    }
    assert key not in others
    assert len(others) == 5


def test_a_model_is_estimated_once(
    tmp_path: Path, own: Health, monkeypatch: pytest.MonkeyPatch
) -> None:
    estimate = Mock(return_value=own)
    monkeypatch.setattr(reference_throws, "health_from_reference", estimate)
    given = (throws(count=3), profile(), health())
    assert kept_or_estimated(*given, HealthStore(tmp_path)) == (own, None)
    found, kept_utc = kept_or_estimated(*given, HealthStore(tmp_path))
    assert (found, estimate.call_count) == (own, 1)
    assert kept_utc is not None
    kept_or_estimated(*given, None)
    assert estimate.call_count == 2
