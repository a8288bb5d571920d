"""Previews against exclusion zones, and the check against the machine's own."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from machine.messages import RejectReason, Target
from machine.spec import load_spec
from runtime.guard import zones as guard
from sim_twin.throws.preview import PreviewRequest, ThrowPreview, preview
from sim_twin.throws.zone_check import ZoneCheck, region_m
from tests.machine.site.test_zones import zone
from tests.runtime.guard.test_guard_zones import ELLIPSE, box, states
from tests.sim_twin.throws.test_preview import request as plain_request

SPEC = load_spec()
RADIUS_M = SPEC.ball.radius_m


@pytest.fixture(scope="module")
def request_2d(swing_policies) -> PreviewRequest:
    return replace(plain_request(swing_policies), rollout_count=60)


@pytest.fixture(scope="module")
def free(request_2d) -> ThrowPreview:
    return preview(request_2d)


def reasons(shown: ThrowPreview) -> list[RejectReason]:
    return [item.reason for item in shown.refused]


def test_a_zone_far_away_changes_nothing(request_2d, free):
    far = preview(replace(request_2d, zones=(box(-20.0, 20.0),)))
    assert far.refused == free.refused == ()
    assert far.ellipse == free.ellipse
    near = {c.name: c.value_rad_m for c in far.clearances}["arm or gripper to zone Office"]
    assert 20.0 < near < 40.0


def test_a_target_in_a_zone_is_refused_with_its_name_and_numbers(request_2d):
    target = request_2d.target
    shown = preview(replace(request_2d, zones=(box(target.x_m, target.y_m, 1.0, top_m=3.0),)))
    assert reasons(shown) == [RejectReason.TARGET_IN_ZONE]
    assert shown.refused[0].detail == (
        "Refused: a load at the target reaches 1.12 m into zone 'Office', which is kept free up to 3.0 m. "
        "Choose another target."
    )
    assert shown.frames_rad_m.size == 0  # nothing was simulated for it
    over = preview(
        replace(request_2d, zones=(box(target.x_m, target.y_m, bottom_m=20.0, top_m=22.0),))
    )
    assert over.refused == ()


def test_a_landing_region_that_reaches_into_a_zone_is_refused(request_2d, free):
    assert free.ellipse is not None
    rim = region_m(free.ellipse, request_2d.target)
    edge_m = rim[:, 0].max() + RADIUS_M
    y_m = float(rim[rim[:, 0].argmax(), 1])
    inside = preview(replace(request_2d, zones=(box(edge_m + 0.9, y_m, 1.0, top_m=3.0),)))
    assert reasons(inside) == [RejectReason.TARGET_IN_ZONE]
    assert (
        "the landing region (99.9 %) reaches 0.10 m into zone 'Office'" in inside.refused[0].detail
    )
    assert preview(replace(request_2d, zones=(box(edge_m + 1.1, y_m, 1.0),))).refused == ()


def flight(item, ellipse=None):
    time_s = np.linspace(0.0, 1.0, 51)
    path = np.stack([4.0 + 5.0 * time_s, 0.0 * time_s, 2.0 + 3.0 * time_s - 5.0 * time_s**2], -1)
    path[:, 2] += RADIUS_M
    target = Target(x_m=9.0, y_m=0.0)
    return ZoneCheck((item,), RADIUS_M).flight_refusals(path, target, (9.0, 0.0, 0.0), ellipse)


def test_a_flight_over_a_zone_is_free_and_through_it_is_refused():
    assert flight(box(6.5, 0.0, 0.2, top_m=2.0)) == ()
    (refusal,) = flight(box(6.5, 0.0, 0.2, top_m=3.0))
    assert refusal.reason is RejectReason.TARGET_IN_ZONE
    assert "the load flies" in refusal.detail and "above ground" in refusal.detail
    assert flight(box(6.5, 0.0, 0.2, bottom_m=3.5, top_m=9.0)) == ()


def test_flights_scatter_more_and_more_on_their_way():
    wide = ELLIPSE.model_copy(update={"mean_downrange_error_m": 0.0, "sd_crossrange_m": 0.3})
    beside = {"half_m": 0.2, "top_m": 9.0}
    assert flight(box(8.5, 1.0, **beside)) == ()
    assert flight(box(8.5, 1.0, **beside), wide)
    assert flight(box(4.5, 1.0, **beside), wide) == ()


def test_landings_that_are_too_few_to_tell_are_refused():
    few = ELLIPSE.model_copy(update={"landed_count": 3})
    (refusal,) = flight(box(40.0, 40.0), few)
    assert "3 predicted throws land, too few" in refusal.detail


def test_an_arm_near_a_zone_is_refused(request_2d, free):
    tip = guard.arm_points(SPEC, free.frames_rad_m[:1]).position_m[0, -1]
    behind = box(float(tip[0]), float(tip[1]) + 1.05, 0.5, top_m=6.0)
    shown = preview(replace(request_2d, zones=(behind,)))
    assert any("arm or gripper to zone Office" in item.detail for item in shown.refused)


def test_distances_are_those_of_the_machine_s_own_check():
    q, _ = states(40, 9)
    item = zone(((2.0, -1.0), (6.0, 0.5), (3.5, 1.0), (4.0, 3.0)), bottom_m=0.5, top_m=2.5)
    prisms = guard.prisms_of((item,))
    (found,) = ZoneCheck((item,), RADIUS_M).clearances(q, 0.02)
    assert found.value_rad_m == pytest.approx(-guard.arm_entries_m(SPEC, prisms, q).max(), abs=0.03)


@settings(max_examples=50, deadline=None)
@given(st.floats(6.0, 10.0), st.floats(-2.0, 3.0), st.floats(0.06, 1.5), st.floats(0.0, 2.0))
def test_server_and_machine_agree_on_landing_regions(x, y, half_m, z):
    target = Target(x_m=8.0, y_m=0.5, z_m=z)
    item = box(x, y, half_m, top_m=1.0)
    theirs = guard.region_entry(SPEC, guard.prisms_of((item,)), ELLIPSE, target)
    impact = (8.1, 0.45, z)
    path = np.array([[*impact[:2], z + RADIUS_M]])
    mine = ZoneCheck((item,), RADIUS_M).flight_refusals(
        np.repeat(path, 2, 0), target, impact, ELLIPSE
    )
    area = region_m(ELLIPSE, target)
    near = [math.dist(p, c) for p in area for c in item.corners_m]
    assume(abs(min(near) - RADIUS_M) > 0.02 and abs(z - 1.0) > 0.25)
    edge = abs(-theirs.depth_m if theirs else 1.0)
    assume(edge > 0.01)
    assert bool(mine) == (theirs is not None)
