import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from machine.conventions import Mode
from server.clock import id_at, new_id, utc_now
from server.errors import NotFoundError
from server.fleet.machine_summaries import BASELINE_COUNT, RECENT_COUNT, TREND_COUNT, figures
from server.store.models import MachinePolicy, Throw
from tests.server.server_bench import wait_for

AT = utc_now()


def add_throws(parts, count: int, error_m: float, *, policy="a" * 64, machine_id="m001", **changes):
    with parts.database.write() as database:
        for _ in range(count):
            values = {
                "throw_id": new_id(),
                "machine_id": machine_id,
                "plan_id": "p",
                "session_id": "s",
                "created_utc": utc_now(),
                "operator": "ada",
                "epoch_count": 1,
                "mode": "2d",
                "target_x_m": 9.0,
                "target_y_m": 0.0,
                "target_z_m": 0.0,
                "range_m": 9.0,
                "policy_id": policy[:4],
                "policy_sha256": policy,
                "phase": "ended",
                "outcome": "landed",
                "measured_downrange_error_m": error_m,
                "measured_crossrange_error_m": 0.0,
                "throw_duration_s": 2.0,
            }
            database.add(Throw(**(values | changes)))


def aboard(parts, policy: str = "a" * 64, machine_id="m001"):
    with parts.database.write() as database:
        database.add(
            MachinePolicy(
                machine_id=machine_id, mode="2d", policy_sha256=policy, since_utc=utc_now()
            )
        )


def row(parts, machine_id="m001"):
    parts.registry.get(machine_id).is_listed = True
    return next(row for row in parts.summaries.fleet() if row.machine_id == machine_id)


def planar(found):
    return next(mode for mode in found.modes if mode.mode is Mode.PLANAR)


def test_a_new_machine_has_nothing(assembled):
    found = row(assembled.parts)
    assert (found.throw_count, found.last_throw) == (0, None)
    assert planar(found).policy_sha256 is None
    assert planar(found).recent is None


def test_recent_throws_stand_beside_the_first_ones_of_the_version_on_board(assembled):
    parts = assembled.parts
    aboard(parts)
    add_throws(parts, 10, 9.0, policy="b" * 64)  # of an earlier version
    add_throws(parts, BASELINE_COUNT + 5, 0.1)
    add_throws(parts, 3, 9.0, mode="3d")
    add_throws(parts, 3, 9.0, machine_id="m002")
    add_throws(parts, RECENT_COUNT, 0.3)
    add_throws(parts, 1, 0.0, measured_downrange_error_m=None, measured_crossrange_error_m=None)
    found = row(parts)
    mode = planar(found)
    assert mode.recent is not None and mode.baseline is not None
    assert (mode.recent.throw_count, mode.baseline.throw_count) == (RECENT_COUNT, BASELINE_COUNT)
    assert mode.recent.mean_downrange_error_m == pytest.approx(0.3)
    assert mode.baseline.mean_downrange_error_m == pytest.approx(0.1)
    assert found.last_throw is not None
    assert found.last_throw.measured_downrange_error_m is None


def test_no_throw_is_in_both(assembled):
    parts = assembled.parts
    aboard(parts)
    add_throws(parts, RECENT_COUNT - 1, 0.3)
    assert planar(row(parts)).baseline is None
    add_throws(parts, RECENT_COUNT, 0.3)
    assert planar(row(parts)).baseline is None
    add_throws(parts, 1, 0.3)
    baseline = planar(row(parts)).baseline
    assert baseline is not None and baseline.throw_count == RECENT_COUNT


def test_the_life_of_a_machine(assembled):
    parts = assembled.parts
    aboard(parts, "b" * 64)
    aboard(parts)
    add_throws(parts, 3, 0.1)
    add_throws(parts, 2, 0.1, outcome="aborted", measured_downrange_error_m=None)
    life = parts.summaries.life("m001")
    assert (life.counts.throw_count, life.counts.landed_count) == (5, 3)
    assert life.counts.aborted_count == 2
    assert life.counts.throwing_s == pytest.approx(10.0)
    assert [change.policy_sha256 for change in life.versions] == ["a" * 64, "b" * 64]
    ids = [point.throw_id for point in life.trend]
    assert len(ids) == 3
    assert ids == sorted(ids)
    assert not life.is_trend_cut
    with pytest.raises(NotFoundError):
        parts.summaries.life("m099")


def test_a_long_life_is_cut_to_its_newest_throws(assembled):
    parts = assembled.parts
    add_throws(parts, 1, 9.0, throw_id=id_at(AT.replace(year=2020)))
    add_throws(parts, TREND_COUNT, 0.1)
    life = parts.summaries.life("m001")
    assert life.is_trend_cut
    assert {point.downrange_error_m for point in life.trend} == {0.1}


@given(st.lists(st.tuples(st.floats(-5, 5), st.floats(-5, 5)), min_size=1, max_size=30))
def test_figures_are_those_of_a_plain_sum(misses):
    found = figures(misses)
    assert found is not None
    n = len(misses)
    mean = sum(along for along, _ in misses) / n
    assert found.mean_downrange_error_m == pytest.approx(mean, abs=1e-9)
    assert found.mean_miss_m == pytest.approx(sum(math.hypot(*m) for m in misses) / n, abs=1e-9)
    if n == 1:
        assert found.sd_downrange_m is None
    else:
        square = sum((along - mean) ** 2 for along, _ in misses) / (n - 1)
        assert found.sd_downrange_m == pytest.approx(math.sqrt(square), abs=1e-9)


def test_no_throws_have_no_figures():
    assert figures([]) is None


def test_a_machine_is_renamed_and_tagged(running, ada, machine):
    with running.client("sue") as sue:
        before = sue.get("/machines/m001").json()
        body = {"name": " Big one ", "tags": ["north", "north", " pit "]}
        shown = sue.patch("/machines/m001", json=body).json()
        assert (shown["name"], shown["machine_id"]) == ("Big one", "m001")
        found = next(r for r in sue.get("/fleet").json() if r["machine_id"] == "m001")
        assert found["tags"] == ["north", "pit"]
        assert sue.patch("/machines/m001", json={"tags": []}).json()["name"] == "Big one"
        assert sue.get("/machines/m001/life").json()["tags"] == []
        assert sue.patch("/machines/m001", json={"name": before["name"]}).status_code == 200
        assert sue.patch("/machines/m099", json={"name": "x"}).status_code == 404
        assert sue.patch("/machines/m001", json={"tags": ["x" * 25]}).status_code == 422
        rows = sue.get("/audit", params={"action": "machine.edit"}).json()["rows"]
        assert {"name": "Big one", "tags": ["north", "pit"]} in [row["detail"] for row in rows]
    wait_for(lambda: running.parts.registry.is_connected("m001"))
