"""Footprint of a released load of bulk material: where its grains land about the aimed point.

The gripper's jaws let the grains go during a window of time while the tool swings on. A grain leaves from
its place in the grab with the velocity of the grip at its moment, and with a random share of the jaws' speed;
then it flies with its own drag. Grains are taken as independent in the air: a dense load shields its inner
grains, so that the spread by drag is an upper bound.
"""

import math
from typing import NamedTuple

import numpy as np

from bulk.material import Material
from machine.ballistics import landing
from machine.conventions import GRAVITY_M_PER_S2, Array
from machine.spec import MachineSpec

LEAVING_RATIO = 0.5
"""Share of the release delay (command to free flight) during which grains leave: the jaws open steadily, and
material flows from half open on. Assumed."""
JAW_SPEED_M_PER_S = 0.25
"""Standard deviation of the velocity that the jaws give to grains, per axis: 0.3 m of opening in the delay of
0.26 s, shared between both sides and friction. Assumed."""
RELEASE_HEIGHT_M = 3.0
RELEASE_RANGE_M = 4.5
"""Typical place of the grip at the release (previews of the active policies)."""
RELEASE_ELEVATION_RAD = math.radians(35.0)
SWING_RADIUS_M = 5.0
"""Distance of the grip from the axis about which the arm swings at the release."""
GRAIN_COUNT = 200
POUR_COUNT = 24
"""Points of pouring that stand for a load's grains; spill counts in such parts, 4 % of a load each."""


class GripRelease(NamedTuple):
    """Motion of the grip at the middle of the release, in the plane through slew axis and target."""

    range_m: float
    height_m: float
    speed_range_m_per_s: float
    speed_up_m_per_s: float
    swing_rad_per_s: float
    """Angular rate of the velocity's direction, positive upward."""


class Footprint(NamedTuple):
    """Grains about the aimed point: frame `throw`, x downrange, y crossrange to the left."""

    covariance_m2: Array
    """(2, 2)."""
    grains_m: Array
    """(N, 2) landing points, mean 0: the aim takes the mean into account."""

    def scaled(self, ratio: Array) -> "Footprint":
        """Wider by ratios (2) downrange and crossrange."""
        return Footprint(self.covariance_m2 * np.outer(ratio, ratio), self.grains_m * ratio)


def release_towards(range_m: float, height_m: float) -> GripRelease:
    """GripRelease of a throw whose load lands at a range and height, without drag.

    The grip's place and elevation are typical; the speed follows from the flight.
    """
    run = range_m - RELEASE_RANGE_M
    fall = RELEASE_HEIGHT_M - height_m
    tangent = math.tan(RELEASE_ELEVATION_RAD)
    speed_x = math.sqrt(GRAVITY_M_PER_S2 * run**2 / (2.0 * max(fall + run * tangent, 0.1)))
    speed = speed_x / math.cos(RELEASE_ELEVATION_RAD)
    return GripRelease(
        RELEASE_RANGE_M, RELEASE_HEIGHT_M, speed_x, speed_x * tangent, speed / SWING_RADIUS_M
    )


def footprint(
    release: GripRelease,
    height_m: float,
    material: Material,
    grab_m3: float,
    spec: MachineSpec,
    rng: np.random.Generator,
    grain_count: int = GRAIN_COUNT,
) -> Footprint:
    """Simulate grains of a load up to a surface at a height; a grab is as wide as it is high."""
    leave_s = LEAVING_RATIO * spec.release.delay_s * rng.uniform(-0.5, 0.5, grain_count)
    turn = release.swing_rad_per_s * leave_s
    speed = math.hypot(release.speed_range_m_per_s, release.speed_up_m_per_s)
    elevation = math.atan2(release.speed_up_m_per_s, release.speed_range_m_per_s) + turn
    jaws = rng.normal(0.0, JAW_SPEED_M_PER_S, (grain_count, 3))
    still = np.zeros(grain_count)
    velocity = np.stack([speed * np.cos(elevation), still, speed * np.sin(elevation)], -1) + jaws
    position = np.stack(
        [
            release.range_m + release.speed_range_m_per_s * leave_s,
            still,
            release.height_m + release.speed_up_m_per_s * leave_s,
        ],
        -1,
    )
    position += np.cbrt(grab_m3) * rng.uniform(-0.5, 0.5, (grain_count, 3))
    size = np.exp(rng.normal(0.0, material.grain_spread_ratio, grain_count))
    end = landing(position, velocity, height_m, material.drag_per_m / size).position_m[:, :2]
    end = end[np.isfinite(end).all(-1)]
    grains = end - end.mean(axis=0)
    return Footprint(np.cov(grains.T), grains)


def pour_points(
    mark: Footprint,
    centre_m: tuple[float, float],
    rng: np.random.Generator,
    count: int = POUR_COUNT,
) -> Array:
    """Points (count, 2) that stand for a load's grains about a landing point, frame `machine`."""
    chosen = mark.grains_m[rng.choice(len(mark.grains_m), count)]
    bearing = math.atan2(centre_m[1], centre_m[0])
    return np.asarray(centre_m) + chosen @ turned(bearing).T


def turned(bearing_rad: float) -> Array:
    """(2, 2) rotation from frame `throw` to frame `machine`."""
    cos, sin = math.cos(bearing_rad), math.sin(bearing_rad)
    return np.array([[cos, -sin], [sin, cos]])
