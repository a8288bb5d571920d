"""Arm, flight and landing region against exclusion zones, by the guard's own arithmetic; batched, pure.

Arm and gripper are points along the axes of their collision shapes, each with a radius. Distances are signed,
in metres, negative inside. The server checks the same with another library (sim_twin/throws/zone_check.py).
"""

import math
from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from machine.conventions import GRAVITY_M_PER_S2, Array, BoolArray
from machine.messages import LandingEllipse, Target
from machine.site.zones import Zone
from machine.spec import MachineSpec
from runtime.guard.release_window import predicted_release

STOP_DELAY_S = 0.10
"""From closing a valve until the joint begins to slow: dead time of the arm's valves, with reserve."""
SPACING_M = 0.20
"""Of points on the axes: between two points the shape is at most 25 mm thinner than its radius."""
FLIGHT_POINT_COUNT = 32
"""Points on a flight of about a second: 0.2 m apart, less than a load's diameter."""
OUTLINE_POINT_COUNT = 180
REGION_RATIO = 0.999
"""Share of the loads that come down in the landing region."""
TURN_STEP_RAD = math.radians(2.0)
PATH_MARGIN_M = 0.10
"""Kept from a planned path: half of what a preview keeps, for motion between its poses and beside them."""
PATH_STEP_COUNT = 3
"""Poses that are looked at for each pose of a path: at 3 m/s the tool moves 0.1 m from one to the next."""
LINKS: tuple[tuple[str, str, tuple[float, float], tuple[float, float], float], ...] = (
    ("boom_obstacle", "boom", (0.2, 0.05), (2.75, 0.08), 0.20),
    ("dipper_obstacle", "dipper", (0.30, 0.1), (0.366, -1.40), 0.18),
    ("telescope_obstacle", "telescope", (0.0, 0.4), (0.0, -0.50), 0.13),
    ("gripper_body_collision", "gripper", (0.0, -0.25), (0.0, -0.50), 0.20),
    ("gripper_claw_collision", "gripper", (0.0, -0.85), (0.0, -0.85), 0.40),
)
"""Shape of machine/m545.xml, its body, ends of its axis in the body's x and z, radius; metres."""


class Prisms(NamedTuple):
    """K zones as arrays; polygons are padded to E edges by edges of no length."""

    names: tuple[str, ...]
    starts_m: Array
    """(K, E, 2) of the edges."""
    ends_m: Array
    """(K, E, 2)"""
    bottom_m: Array
    """(K,)"""
    top_m: Array
    """(K,)"""

    def one(self, index: int) -> "Prisms":
        """One of the zones."""
        at = slice(index, index + 1)
        return Prisms(
            self.names[at],
            self.starts_m[at],
            self.ends_m[at],
            self.bottom_m[at],
            self.top_m[at],
        )


class ZoneEntry(NamedTuple):
    """How far something reaches into a zone."""

    name: str
    depth_m: float
    top_m: float


class LinkPoints(NamedTuple):
    """Points on arm and gripper."""

    position_m: Array
    """(N, P, 3) frame `machine`."""
    radius_m: Array
    """(P,)"""


def prisms_of(zones: Sequence[Zone]) -> Prisms:
    """Zones as arrays."""
    longest = max((len(zone.corners_m) for zone in zones), default=3)
    starts = np.zeros((len(zones), longest, 2))
    for index, zone in enumerate(zones):
        count = len(zone.corners_m)
        starts[index, :count] = zone.corners_m
        starts[index, count:] = zone.corners_m[0]
    return Prisms(
        names=tuple(zone.name for zone in zones),
        starts_m=starts,
        ends_m=np.roll(starts, -1, axis=1),
        bottom_m=np.array([zone.bottom_m for zone in zones]),
        top_m=np.array([zone.top_m for zone in zones]),
    )


def distances_m(prisms: Prisms, points_m: Array) -> Array:
    """Signed distances (..., K) of points (..., 3) from the zones."""
    x, y = points_m[..., None, None, 0], points_m[..., None, None, 1]
    start, edge = prisms.starts_m, prisms.ends_m - prisms.starts_m
    dx, dy = x - start[..., 0], y - start[..., 1]
    length2 = (edge**2).sum(axis=-1)
    along = (dx * edge[..., 0] + dy * edge[..., 1]) / np.where(length2 > 0.0, length2, 1.0)
    along = np.clip(along, 0.0, 1.0)
    gap2 = (dx - along * edge[..., 0]) ** 2 + (dy - along * edge[..., 1]) ** 2
    # A ray in direction +x crosses an odd number of edges from inside.
    spans = (dy < 0.0) != (y - prisms.ends_m[..., 1] < 0.0)
    rise = np.where(spans, edge[..., 1], 1.0)
    crosses = spans & (dx < dy * edge[..., 0] / rise)
    inside = np.count_nonzero(crosses, axis=-1) % 2 == 1
    level = np.sqrt(gap2.min(axis=-1)) * np.where(inside, -1.0, 1.0)
    z = points_m[..., None, 2]
    upright = np.maximum(prisms.bottom_m - z, z - prisms.top_m)
    outside = np.hypot(np.maximum(level, 0.0), np.maximum(upright, 0.0))
    return outside + np.minimum(np.maximum(level, upright), 0.0)


def arm_points(spec: MachineSpec, position_rad_m: Array) -> LinkPoints:
    """Points on the axes of arm and gripper for joints (N, 6).

    Complex numbers x + i z in the arm plane: each body turns its points and hangs on the one before.
    """
    q, g = position_rad_m, spec.geometry
    boom = np.exp(1j * q[:, 1])
    tube = np.exp(1j * (q[:, 1] + q[:, 2]))
    hang = np.exp(1j * (q[:, 1] + q[:, 2] + q[:, 4]))
    pivot = complex(g.boom_pivot_m[0], g.slew_frame_height_m + g.boom_pivot_m[2])
    dipper = pivot + g.boom_length_m * boom
    telescope = (
        dipper + (g.telescope_axis_offset_m - 1j * (g.dipper_to_telescope_m + q[:, 3])) * tube
    )
    gripper = telescope - 1j * g.telescope_to_pin_m * tube - 1j * g.pitch_to_roll_m * hang
    bodies = {
        "boom": (np.broadcast_to(pivot, boom.shape), boom),
        "dipper": (dipper, tube),
        "telescope": (telescope, tube),
        "gripper": (gripper, hang),
    }
    in_plane: list[Any] = []
    across: list[Array] = []
    for body, local in _axis_points().places.items():
        origin, turn = bodies[body]
        down = local.imag if body != "gripper" else local.imag * np.cos(q[:, 5:6])
        in_plane.append(origin[:, None] + (local.real + 1j * down) * turn[:, None])
        tilt = -local.imag * np.sin(q[:, 5:6]) if body == "gripper" else np.zeros(down.shape)
        across.append(np.broadcast_to(g.boom_pivot_m[1] + tilt, in_plane[-1].shape))
    point: Any = np.concatenate(in_plane, axis=1)
    side = np.concatenate(across, axis=1)
    place: Any = (point.real + 1j * side) * np.exp(1j * q[:, 0:1])
    position = np.stack([place.real, place.imag, point.imag], axis=-1)
    return LinkPoints(position, _axis_points().radius_m)


class _AxisPoints(NamedTuple):
    places: dict[str, Any]
    """Body -> points x + i z in its frame; in the order of `LINKS`."""
    radius_m: Array


@cache
def _axis_points() -> _AxisPoints:
    places: dict[str, list[Any]] = {}
    radii: list[float] = []
    for _, body, start, end, radius_m in LINKS:
        count = 1 + math.ceil(math.dist(start, end) / SPACING_M)
        ratio = np.linspace(0.0, 1.0, count)
        axis = complex(*start) + ratio * (complex(*end) - complex(*start))
        places.setdefault(body, []).append(axis)
        radii += [radius_m] * count
    return _AxisPoints({b: np.concatenate(a) for b, a in places.items()}, np.array(radii))


def arm_entries_m(spec: MachineSpec, prisms: Prisms, position_rad_m: Array) -> Array:
    """Depths (N, K) to which arm and gripper at joints (N, 6) reach into the zones; negative = clear."""
    arm = arm_points(spec, position_rad_m)
    gap = distances_m(prisms, arm.position_m) - arm.radius_m[:, None]
    return -gap.min(axis=1)


def rest_position(spec: MachineSpec, position_rad_m: Array, velocity_rad_m_per_s: Array) -> Array:
    """Joints (N, 6) where the arm would stand if its valves closed now; the gripper as it hangs by then."""
    rest = position_rad_m + STOP_DELAY_S * velocity_rad_m_per_s
    speed = velocity_rad_m_per_s[:, :4]
    slowing = 0.5 / np.asarray(spec.limits.acceleration_rad_m_per_s2)
    rest[:, :4] += slowing * speed * np.abs(speed)
    # The gripper keeps its angle in space while boom and dipper go on.
    rest[:, 4] -= (slowing * speed * np.abs(speed))[:, 1:3].sum(axis=1)
    return rest


def arm_enters(
    spec: MachineSpec, prisms: Prisms, position_rad_m: Array, velocity_rad_m_per_s: Array
) -> BoolArray:
    """Whether arms (N,) are in a zone, or would come to rest in one if their valves closed now."""
    rest = rest_position(spec, position_rad_m, velocity_rad_m_per_s)
    middle = 0.5 * (position_rad_m + rest)
    poses = np.concatenate([position_rad_m, middle, rest])
    with np.errstate(invalid="ignore"):
        entered = (arm_entries_m(spec, prisms, poses) > 0.0).any(axis=1)
    return np.logical_or.reduce(entered.reshape(3, -1))


def flight_enters(
    spec: MachineSpec,
    prisms: Prisms,
    position_rad_m: Array,
    velocity_rad_m_per_s: Array,
    height_m: Array,
) -> BoolArray:
    """Whether loads (N,) released now would fly through a zone or come down in one.

    Args:
        spec: machine type.
        prisms: the zones.
        position_rad_m: (N, 6)
        velocity_rad_m_per_s: (N, 6)
        height_m: (N,) of the surface.
    """
    tool = predicted_release(spec, position_rad_m, velocity_rad_m_per_s)
    radius_m = spec.ball.radius_m
    up = tool.velocity_m_per_s[:, 2]
    fall_m = tool.position_m[:, 2] - height_m - radius_m
    with np.errstate(invalid="ignore"):
        end_s = (up + np.sqrt(up * up + 2.0 * GRAVITY_M_PER_S2 * fall_m)) / GRAVITY_M_PER_S2
        time_s = (end_s[:, None] * np.linspace(0.0, 1.0, FLIGHT_POINT_COUNT))[..., None]
        path = tool.position_m[:, None] + time_s * tool.velocity_m_per_s[:, None]
        path[..., 2] -= 0.5 * GRAVITY_M_PER_S2 * time_s[..., 0] ** 2
        gap = distances_m(prisms, path).min(axis=(1, 2))
        # A flight that is no number lands nowhere: the release window refuses it.
        return gap < radius_m


def region_ratio(landed_count: int) -> float:
    """Half axes of the region in which the next load comes down, in standard deviations of `landed_count`.

    Of a normal distribution whose mean and covariance are estimated from so many throws (Hotelling's T2).
    """
    if landed_count < 4:
        return math.inf
    n, free = landed_count, landed_count - 2
    # The quantile of F(2, free) has a closed form.
    quantile = 0.5 * free * ((1.0 - REGION_RATIO) ** (-2.0 / free) - 1.0)
    return math.sqrt(2.0 * (n - 1) * (n + 1) / (n * free) * quantile)


def region_outline_m(ellipse: LandingEllipse, target: Target) -> Array:
    """Points (M, 3) on and in the 99.9 % landing region, frame `machine`."""
    sx, sy = ellipse.sd_downrange_m, ellipse.sd_crossrange_m
    shared = ellipse.correlation_ratio * sx * sy
    size, axes = np.linalg.eigh(np.array([[sx * sx, shared], [shared, sy * sy]]))
    half = region_ratio(ellipse.landed_count) * np.sqrt(np.maximum(size, 0.0))
    angle = np.linspace(0.0, 2.0 * np.pi, OUTLINE_POINT_COUNT, endpoint=False)
    rim = np.stack([np.cos(angle), np.sin(angle)], axis=-1) * half @ axes.T
    local = np.concatenate([share * rim for share in (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)])
    local += (ellipse.mean_downrange_error_m, ellipse.mean_crossrange_error_m)
    bearing = math.atan2(target.y_m, target.x_m)
    place = (local[:, 0] + 1j * local[:, 1]) * np.exp(1j * bearing) + complex(
        target.x_m, target.y_m
    )
    return np.stack([place.real, place.imag, np.full(len(local), target.z_m)], axis=-1)


def region_entry(
    spec: MachineSpec, prisms: Prisms, ellipse: LandingEllipse, target: Target
) -> ZoneEntry | None:
    """The zone that the landing region, with the load's size, reaches deepest into; None = clear."""
    radius_m = spec.ball.radius_m
    if math.isinf(region_ratio(ellipse.landed_count)):
        return ZoneEntry(prisms.names[0], math.inf, float(prisms.top_m[0]))
    lifted = region_outline_m(ellipse, target)
    lifted[:, 2] += radius_m
    return deepest(prisms, radius_m - distances_m(prisms, lifted).min(axis=0))


def turn_entry(
    spec: MachineSpec, prisms: Prisms, position_rad_m: Array, target: Target, *, turns: bool
) -> ZoneEntry | None:
    """The zone that the arm reaches deepest into, where it stands and while the cabin turns to the target.

    Args:
        spec: machine type.
        prisms: the zones.
        position_rad_m: (6,) where the arm stands.
        target: to be turned to.
        turns: whether the throw begins by a turn to the target, as in mode 2D.
    """
    poses = position_rad_m[None]
    if turns:
        reach_m = max(math.hypot(target.x_m, target.y_m), 1e-6)
        aside = math.asin(min(max(spec.geometry.boom_pivot_m[1] / reach_m, -1.0), 1.0))
        away = math.atan2(target.y_m, target.x_m) - aside - float(position_rad_m[0])
        away = math.remainder(away, 2.0 * math.pi)
        poses = np.repeat(poses, 2 + int(abs(away) / TURN_STEP_RAD), axis=0)
        poses[:, 0] += np.linspace(0.0, away, len(poses))
    return deepest(prisms, arm_entries_m(spec, prisms, poses).max(axis=0))


def path_entry(spec: MachineSpec, prisms: Prisms, path_rad_m: Array) -> ZoneEntry | None:
    """The zone that arm and gripper come deepest into, or nearer than `PATH_MARGIN_M`, on a path (T, 6)."""
    at = np.linspace(0.0, len(path_rad_m) - 1.0, PATH_STEP_COUNT * (len(path_rad_m) - 1) + 1)
    first = np.minimum(at.astype(np.int64), max(len(path_rad_m) - 2, 0))
    following = np.minimum(first + 1, len(path_rad_m) - 1)
    share = (at - first)[:, None]
    arm = arm_points(spec, (1.0 - share) * path_rad_m[first] + share * path_rad_m[following])
    points = arm.position_m.reshape(-1, 3)
    reach = np.tile(arm.radius_m, len(at)) + PATH_MARGIN_M
    depths = np.full(len(prisms.names), -np.inf)
    for index in range(len(depths)):
        # Few points are near a zone: sixteen zones of 24 corners would take longer than a tick for all.
        zone = prisms.one(index)
        low = zone.starts_m.min(axis=(0, 1)) - reach.max()
        high = zone.starts_m.max(axis=(0, 1)) + reach.max()
        near = ((points[:, :2] > low) & (points[:, :2] < high)).all(axis=1)
        if near.any():
            depths[index] = (reach[near] - distances_m(zone, points[near])[:, 0]).max()
    return deepest(prisms, depths)


def deepest(prisms: Prisms, depths_m: Array) -> ZoneEntry | None:
    """The largest of depths (K,) with its zone; None where none is above zero."""
    index = int(np.argmax(depths_m))
    if depths_m[index] <= 0.0:
        return None
    return ZoneEntry(prisms.names[index], float(depths_m[index]), float(prisms.top_m[index]))
