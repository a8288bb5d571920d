import csv
import io
import random
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from machine.conventions import Mode
from server.clock import id_at
from server.schemas.history import GroupBy, Outcome
from server.store.models import Throw
from server.throws import throw_history as history_module
from server.throws import throw_statistics as statistics_module
from server.throws.throw_history import ThrowFilter, ThrowHistory
from server.throws.throw_statistics import ThrowStatistics
from tests.cases import each

START = datetime(2026, 1, 1, tzinfo=UTC)
OPERATORS = ("ada", "bob")


def make_throw(index: int, rng: random.Random) -> Throw:
    moment = START + timedelta(minutes=index)
    landed = rng.random() < 0.8
    range_m = rng.choice((7.5, 8.0, 9.0, 10.0))
    return Throw(
        throw_id=id_at(moment),
        machine_id=f"m00{rng.randint(1, 2)}",
        plan_id="p",
        session_id="s",
        created_utc=moment,
        operator=rng.choice(OPERATORS),
        epoch_count=1,
        mode=rng.choice(("2d", "3d")),
        target_x_m=range_m,
        target_y_m=0.0,
        target_z_m=0.0,
        range_m=range_m,
        policy_id=f"policy-{rng.randint(0, 1)}",
        policy_sha256=rng.choice(("a" * 64, "b" * 64)),
        phase="ended",
        outcome="landed" if landed else "aborted",
        detail="=1+1",
        measured_downrange_error_m=rng.gauss(0.1, 0.2) if landed else None,
        measured_crossrange_error_m=rng.gauss(0.0, 0.1) if landed else None,
        has_log=False,
    )


@pytest.fixture
def throws(assembled):
    rng = random.Random(7)
    rows = [make_throw(index, rng) for index in range(150)]
    with assembled.parts.database.write() as database:
        database.add_all(rows)
    return sorted(rows, key=lambda row: row.throw_id, reverse=True)


FILTERS = st.builds(
    ThrowFilter,
    machine_id=st.sampled_from([None, "m001", "m002", "m009"]),
    mode=st.sampled_from([None, *Mode]),
    policy_sha256=st.sampled_from([None, "a" * 64]),
    operator=st.sampled_from([None, *OPERATORS]),
    outcome=st.sampled_from([None, Outcome.LANDED, Outcome.FAULT]),
    min_range_m=st.sampled_from([None, 8.0, 11.0]),
    max_range_m=st.sampled_from([None, 9.0]),
    since=st.sampled_from([None, START + timedelta(minutes=40)]),
    until=st.sampled_from([None, START + timedelta(minutes=100)]),
)


def matches(row: Throw, wanted: ThrowFilter) -> bool:
    return all(
        (
            wanted.machine_id in (None, row.machine_id),
            wanted.mode is None or wanted.mode.value == row.mode,
            wanted.policy_sha256 in (None, row.policy_sha256),
            wanted.operator in (None, row.operator),
            wanted.outcome is None or wanted.outcome.value == row.outcome,
            wanted.min_range_m is None or row.range_m >= wanted.min_range_m,
            wanted.max_range_m is None or row.range_m <= wanted.max_range_m,
            wanted.since is None or row.created_utc >= wanted.since,
            wanted.until is None or row.created_utc < wanted.until,
        )
    )


def all_pages(history: ThrowHistory, wanted: ThrowFilter, limit: int) -> list[str]:
    found: list[str] = []
    cursor = None
    while True:
        page = history.page(wanted, cursor, limit)
        found += [row.throw_id for row in page.rows]
        cursor = page.next_cursor
        if cursor is None:
            return found


@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(FILTERS, st.sampled_from([7, 50, 500]), st.sampled_from([20, 10_000]), st.booleans())
def test_pages_and_statistics_are_of_the_filtered_list(
    assembled, throws, wanted, limit, probe, is_common
):
    # A small probe and a distance that counts as common make the search take its other steps.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(history_module, "PROBE_COUNT", probe)
        patch.setattr(statistics_module, "CONSIDERED_LIMIT", limit)
        if is_common:
            patch.setattr(history_module, "SORT_COUNT", 0)
            patch.setattr(history_module, "SORT_RATIO", 0)
        found = all_pages(ThrowHistory(assembled.parts.database), wanted, limit)
        stats = ThrowStatistics(assembled.parts.database).of(wanted, GroupBy.MACHINE)
    matching = [row for row in throws if matches(row, wanted)]
    measured = [row for row in matching if row.measured_downrange_error_m is not None]
    assert found == [row.throw_id for row in matching]
    assert [point.throw_id for point in stats.points] == [row.throw_id for row in measured[:limit]]
    assert stats.is_truncated == (len(measured) > limit)


def test_new_throws_do_not_disturb_a_cursor(assembled, throws):
    history = ThrowHistory(assembled.parts.database)
    first = history.page(ThrowFilter(), None, 50)
    newer = make_throw(1000, random.Random(1))
    newer_id = newer.throw_id
    with assembled.parts.database.write() as database:
        database.add(newer)
    rest = history.page(ThrowFilter(), first.next_cursor, 500)
    ids = [row.throw_id for row in (*first.rows, *rest.rows)]
    assert ids == [row.throw_id for row in throws]
    assert newer_id not in ids


def test_export_has_every_row_and_no_formulas(assembled, throws):
    text = "".join(ThrowHistory(assembled.parts.database).export(ThrowFilter(machine_id="m001")))
    rows = list(csv.DictReader(io.StringIO(text)))
    expected = [row for row in throws if row.machine_id == "m001"]
    assert [row["throw_id"] for row in rows] == [row.throw_id for row in expected]
    assert {row["detail"] for row in rows} == {"'=1+1"}
    for found, row in zip(rows, expected, strict=True):
        if row.measured_downrange_error_m is not None:
            assert float(found["measured_downrange_error_m"]) == row.measured_downrange_error_m


@each("group_by", list(GroupBy))
def test_statistics_are_those_of_numpy(assembled, throws, group_by):
    stats = ThrowStatistics(assembled.parts.database).of(ThrowFilter(), group_by)
    key = {
        GroupBy.POLICY: "policy_sha256",
        GroupBy.MODE: "mode",
        GroupBy.MACHINE: "machine_id",
        GroupBy.OPERATOR: "operator",
    }[group_by]
    landed = [row for row in throws if row.outcome == "landed"]
    assert (stats.considered_count, stats.is_truncated) == (len(landed), False)
    assert len(stats.points) == len(landed)
    for group in stats.groups:
        errors = np.array(
            [
                (row.measured_downrange_error_m, row.measured_crossrange_error_m)
                for row in landed
                if getattr(row, key) == group.group
            ]
        )
        assert group.throw_count == len(errors)
        assert group.mean_downrange_error_m == pytest.approx(errors[:, 0].mean())
        assert group.sd_crossrange_m == pytest.approx(errors[:, 1].std(ddof=1))
        covariance = np.cov(errors.T)
        angle = group.ellipse_angle_rad
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        axes = np.diag([group.ellipse_major_m**2, group.ellipse_minor_m**2])
        assert np.allclose(turn @ axes @ turn.T, covariance)
    for item in stats.by_range:
        along = [
            row.measured_downrange_error_m
            for row in landed
            if getattr(row, key) == item.group and row.range_m == pytest.approx(item.range_m)
        ]
        assert item.throw_count == len(along)
        assert item.mean_downrange_error_m == pytest.approx(np.mean(along))
        assert item.sd_downrange_m == pytest.approx(np.std(along, ddof=1))
    assert sum(item.throw_count for item in stats.by_range) == len(landed)
    assert {round(item.range_m, 6) for item in stats.by_range} == {7.5, 8.0, 9.0, 10.0}


def test_statistics_of_nothing_and_of_one(assembled, throws):
    statistics = ThrowStatistics(assembled.parts.database)
    nothing = statistics.of(ThrowFilter(machine_id="m009"), GroupBy.POLICY)
    assert (nothing.considered_count, nothing.groups, nothing.by_range) == (0, (), ())
    landed = next(row for row in throws if row.outcome == "landed")
    minute = timedelta(seconds=30)
    one = statistics.of(
        ThrowFilter(since=landed.created_utc - minute, until=landed.created_utc + minute),
        GroupBy.MODE,
    )
    assert one.groups[0].throw_count == 1
    assert one.groups[0].sd_downrange_m is None
