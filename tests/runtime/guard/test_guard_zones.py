"""The guard's geometry of zones against shapely and MuJoCo, which it does not use."""

import math

import mujoco
import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.stats import f as f_distribution
from shapely.geometry import Point, Polygon

from machine.messages import LandingEllipse, Target
from machine.site.zones import Zone
from machine.spec import load_spec
from machine.starts import safe_pose
from runtime.guard import zones
from runtime.guard.release_window import predicted_landing_m, predicted_release
from sim_twin.rigid_body.model import twin_model
from tests.machine.site.test_zones import zone

SPEC = load_spec()
RING = tuple(
    (round(5.0 + r * math.cos(a), 3), round(1.0 + r * math.sin(a), 3))
    for a, r in zip(np.linspace(0.0, 5.6, 9), (1, 2, 1, 2.5, 1, 2, 1.2, 2, 1), strict=True)
)
"""A star: not convex."""
ELLIPSE = LandingEllipse(
    mean_downrange_error_m=0.1,
    mean_crossrange_error_m=-0.05,
    sd_downrange_m=0.2,
    sd_crossrange_m=0.1,
    correlation_ratio=0.3,
    rollout_count=200,
    landed_count=200,
)


def box(x_m, y_m, half_m=0.5, **changes):
    corners = (
        (x_m - half_m, y_m - half_m),
        (x_m + half_m, y_m - half_m),
        (x_m + half_m, y_m + half_m),
        (x_m - half_m, y_m + half_m),
    )
    return zone(corners, **changes)


def states(count, seed):
    rng = np.random.default_rng(seed)
    q = np.zeros((count, 6))
    q[:, 0] = rng.uniform(-math.pi, math.pi, count)
    q[:, 1] = rng.uniform(-0.3, 1.0, count)
    q[:, 2] = rng.uniform(-1.0, 0.9, count)
    q[:, 3] = rng.uniform(0.0, 1.7, count)
    q[:, 4] = rng.uniform(-1.2, 1.2, count)
    q[:, 5] = rng.uniform(-0.6, 0.6, count)
    return q, rng.uniform(-0.4, 0.4, (count, 6))


@given(st.floats(2.0, 8.0), st.floats(-2.0, 4.0), st.floats(-1.0, 5.0))
def test_distances_are_those_of_another_library(x, y, z):
    prisms = zones.prisms_of((zone(RING, bottom_m=0.5), zone(name="b", corners=RING[:3])))
    found = zones.distances_m(prisms, np.array([x, y, z]))
    for index, (corners, low) in enumerate(((RING, 0.5), (RING[:3], 0.0))):
        shape = Polygon(corners)
        level = shape.exterior.distance(Point(x, y)) * (-1 if shape.contains(Point(x, y)) else 1)
        upright = max(low - z, z - 3.0)
        known = math.hypot(max(level, 0), max(upright, 0)) + min(max(level, upright), 0)
        assert math.isclose(found[index], known, abs_tol=1e-9)


def test_points_of_the_arm_lie_on_the_axes_of_its_collision_shapes():
    q, _ = states(20, 3)
    model, _ = twin_model()
    data = mujoco.MjData(model)
    arm = zones.arm_points(SPEC, q)
    for row, pose in enumerate(q):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        first = 0
        for name, _, start, end, radius_m in zones.LINKS:
            geom = model.geom(name)
            assert geom.size[0] == radius_m
            count = 1 + math.ceil(math.dist(start, end) / zones.SPACING_M)
            half = float(geom.size[1]) if count > 1 else 0.0
            axis = data.geom_xmat[geom.id].reshape(3, 3)[:, 2]
            ends = [data.geom_xpos[geom.id] + side * half * axis for side in (-1.0, 1.0)]
            mine = arm.position_m[row, first : first + count]
            first += count
            off = min(
                max(np.linalg.norm(mine[0] - a), np.linalg.norm(mine[-1] - b))
                for a, b in (ends, ends[::-1])
            )
            assert off < 1e-3, name
            assert np.linalg.norm(np.diff(mine, axis=0), axis=1).max(initial=0) <= 0.2 + 1e-9
        assert first == arm.position_m.shape[1]


def test_an_arm_is_stopped_before_it_enters():
    """Joints that brake as the spec says, from the moment at which the guard first objects."""
    q, v = states(400, 5)
    q[:, 4] = -(q[:, 1] + q[:, 2])
    v[:, 4], v[:, 5] = -(v[:, 1] + v[:, 2]), 0.0
    prisms = zones.prisms_of((box(4.0, 0.0, 0.8, top_m=6.0), box(-3.0, 4.0, 1.0, top_m=5.0)))
    objects = zones.arm_enters(SPEC, prisms, q, v)
    limit = np.asarray(SPEC.limits.acceleration_rad_m_per_s2)
    deepest = np.full(400, -np.inf)
    for _ in range(400):
        deepest = np.maximum(deepest, zones.arm_entries_m(SPEC, prisms, q).max(axis=1))
        slower = np.sign(v[:, :4]) * np.maximum(np.abs(v[:, :4]) - 0.01 * limit, 0.0)
        v[:, :4], v[:, 4] = slower, -(slower[:, 1] + slower[:, 2])
        q = q + 0.01 * v
    assert objects.any() and not objects.all()
    assert (deepest[~objects] < 0.02).all()


def test_a_flight_over_a_low_zone_is_free_and_through_a_high_one_is_not():
    q, v = safe_pose()[None].copy(), np.zeros((1, 6))
    v[0, :2], v[0, 4] = (0.2, 0.3), 1.5
    tool = predicted_release(SPEC, q, v)
    end = predicted_landing_m(SPEC, q, v, np.zeros(1))[0]
    middle = 0.5 * (tool.position_m[0, :2] + end)
    height = np.zeros(1)
    for item, enters in (
        (box(*middle, half_m=0.1, top_m=0.3), False),
        (box(*middle, half_m=0.1, top_m=6.0), True),
        (box(*middle, half_m=0.1, bottom_m=8.0, top_m=9.0), False),
        (box(*end, half_m=0.1, top_m=0.2), True),
        (box(*(end + 1.0), half_m=0.1), False),
    ):
        found = zones.flight_enters(SPEC, zones.prisms_of((item,)), q, v, height)
        assert found[0] == enters, item


@given(st.integers(4, 2000))
def test_the_region_holds_999_of_1000_loads(count):
    known = f_distribution.ppf(0.999, 2, count - 2)
    ratio = math.sqrt(2.0 * (count - 1) * (count + 1) / (count * (count - 2)) * known)
    assert math.isclose(zones.region_ratio(count), ratio, rel_tol=1e-6)


def test_too_few_loads_are_everywhere():
    assert zones.region_ratio(3) == math.inf
    far = zones.prisms_of((box(50.0, 50.0),))
    few = ELLIPSE.model_copy(update={"landed_count": 3})
    assert zones.region_entry(SPEC, far, few, Target(x_m=8.0, y_m=0.0)).depth_m == math.inf


def test_the_region_is_where_loads_are_found():
    target = Target(x_m=6.0, y_m=5.0)
    sx, sy, r = 0.2, 0.1, 0.3
    rng = np.random.default_rng(1)
    cov = [[sx * sx, r * sx * sy], [r * sx * sy, sy * sy]]
    local = rng.multivariate_normal((0.1, -0.05), cov, 200_000)
    bearing = math.atan2(5.0, 6.0)
    place = (local[:, 0] + 1j * local[:, 1]) * np.exp(1j * bearing) + complex(6.0, 5.0)
    rim = zones.region_outline_m(ELLIPSE, target)[-zones.OUTLINE_POINT_COUNT :, :2]
    loads = np.stack([place.real, place.imag, np.full(len(place), 0.5)], axis=-1)
    shape = Zone(
        name="r", reason="the region", corners_m=[tuple(p) for p in rim[:: 180 // 20]], top_m=1.0
    )
    inside = zones.distances_m(zones.prisms_of((shape,)), loads[:20_000])[:, 0] < 0.0
    # A polygon of 20 corners lies a little inside the ellipse.
    assert 0.997 < inside.mean() < 0.9999


@settings(max_examples=60)
@given(st.floats(5.0, 11.0), st.floats(-3.0, 3.0), st.floats(0.06, 1.5), st.floats(0.0, 2.0))
def test_the_region_meets_zones_as_another_library_says(x, y, half_m, z):
    target = Target(x_m=8.0, y_m=0.5, z_m=z)
    item = box(x, y, half_m, top_m=1.0)
    rim = zones.region_outline_m(ELLIPSE, target)[-zones.OUTLINE_POINT_COUNT :, :2]
    radius_m = SPEC.ball.radius_m
    level = Polygon(rim).distance(Polygon(item.corners_m))
    gap = math.hypot(level, max(z + radius_m - 1.0, 0.0)) - radius_m
    assume(abs(gap) > 0.01)
    found = zones.region_entry(SPEC, zones.prisms_of((item,)), ELLIPSE, target)
    assert (found is not None) == (gap < 0.0)


def test_the_turn_to_the_target_is_looked_at():
    pose = safe_pose(0.0)
    tip = zones.arm_points(SPEC, pose[None]).position_m[0, -1]
    reach, height = math.hypot(*tip[:2]), tip[2]
    aside = box(reach * math.cos(0.8), reach * math.sin(0.8), 0.3, top_m=height + 1.0)
    prisms = zones.prisms_of((aside,))
    left, right = Target(x_m=0.5, y_m=8.0), Target(x_m=0.5, y_m=-8.0)
    found = zones.turn_entry(SPEC, prisms, pose, left, turns=True)
    assert found is not None and found.name == "Office" and 0.3 < found.depth_m < 2.0
    assert zones.turn_entry(SPEC, prisms, pose, right, turns=True) is None
    assert zones.turn_entry(SPEC, prisms, pose, left, turns=False) is None
    there = safe_pose(0.8)
    assert zones.turn_entry(SPEC, prisms, there, right, turns=False) is not None


def test_a_path_is_looked_at_between_its_poses():
    """A narrow zone between two poses; distances as of poses all along, 5 cm apart at most."""
    path = np.repeat(safe_pose(0.0)[None], 12, axis=0)
    path[:, 0] = np.linspace(0.0, 0.6, 12)
    tip = zones.arm_points(SPEC, path).position_m[:, -1]
    reach = float(np.hypot(*tip[0, :2]))
    dense = np.repeat(path[:1], 400, axis=0)
    dense[:, 0] = np.linspace(0.0, 0.6, 400)
    for angle, gap_m in ((0.3, 0.0), (0.68, 0.05), (0.9, 0.0), (-0.4, 0.0)):
        item = box(reach * math.cos(angle), reach * math.sin(angle) + gap_m, 0.1, top_m=6.0)
        prisms = zones.prisms_of((box(0.0, -30.0, name="far"), item))
        nearest = float(zones.arm_entries_m(SPEC, prisms, dense)[:, 1].max()) + zones.PATH_MARGIN_M
        found = zones.path_entry(SPEC, prisms, path)
        assert (found is not None) == (nearest > 0.0)
        if found is not None:
            assert found.name == "Office" and abs(found.depth_m - nearest) < 0.05
