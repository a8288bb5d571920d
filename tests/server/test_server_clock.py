from datetime import UTC, datetime, timedelta
from uuid import UUID

from hypothesis import given
from hypothesis import strategies as st

from server import clock

MOMENTS = st.datetimes(
    # Hypothesis wants bounds without a zone and adds it itself.
    min_value=datetime.fromisoformat("2000-01-01"),
    max_value=datetime.fromisoformat("2200-01-01"),
    timezones=st.just(UTC),
)


def test_ids_are_version_7_unique_and_ordered():
    ids = [clock.new_id() for _ in range(20_000)]
    assert len(set(ids)) == len(ids)
    assert ids == sorted(ids)
    assert {UUID(item).version for item in ids} == {7}


def test_ids_stay_ordered_when_the_clock_goes_back(monkeypatch):
    before = clock.new_id()
    now_ns = clock.time.time_ns()
    monkeypatch.setattr(clock.time, "time_ns", lambda: now_ns - 3_600_000_000_000)
    ids = [before, *(clock.new_id() for _ in range(5000))]
    assert ids == sorted(ids)


@given(MOMENTS, st.timedeltas(min_value=timedelta(milliseconds=1), max_value=timedelta(days=9)))
def test_bounds_of_time_are_bounds_of_ids(moment, later):
    assert clock.first_id_at(moment) <= clock.id_at(moment)
    assert clock.id_at(moment) < clock.first_id_at(moment + later + timedelta(milliseconds=1))
