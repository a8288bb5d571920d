"""Objects of a site as solids: distances, names and slopes of surfaces, for many points at once.

Signed distances are exact for boxes, pits and ground, and of first order for piles: exact on the surface.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from machine.conventions import Array, BoolArray, IntArray
from machine.messages import Target
from machine.site.objects import GROUND, UNDESCRIBED, SiteKind, SiteObject

SURFACE_TOLERANCE_M = 0.05
"""Distance within which a target lies on a surface: half the accuracy of a tape measure."""
TOP_MIN_RATIO = 0.64
"""Smallest vertical component of a surface's normal (cosine of 50 degrees); steeper surfaces are sides. Piles
have slopes up to 45 degrees."""
BISECTIONS_COUNT = 24
"""Bisections of a step of 10 ms, to below a nanosecond."""
_NUDGE_M = 1e-4


class Contact(NamedTuple):
    """Contacts of N balls."""

    point_m: Array
    """(N, 3)"""
    solid: IntArray
    """(N,) index into `Solids.names`; -1: none."""
    is_side: BoolArray
    """(N,) whether the surface there is a side."""


class Solids:
    """Ground and objects of one site.

    Attributes:
        names: the ground first, then all objects in the order given.
        ground_m: height of the ground; not 0 if a target is off ground level and on no object: the ground
            is then assumed to be a plane at that height, without pits.
    """

    def __init__(self, objects: Sequence[SiteObject] = (), ground_m: float = 0.0) -> None:
        self.objects, self.ground_m = tuple(objects), ground_m
        ground = GROUND if ground_m == 0.0 else UNDESCRIBED
        self.names = (ground, *(item.name for item in objects))

    @classmethod
    def around(cls, objects: Sequence[SiteObject], target: Target) -> "Solids":
        """Solids of a site for a throw at a target."""
        plain = cls(objects)
        declared = plain.name_at(target) is not None
        return plain if declared else cls(objects, ground_m=target.z_m)

    def name_at(self, target: Target) -> str | None:
        """Name of the surface under a target; None if no surface has that height."""
        pits = [o for o in self.objects if o.kind is SiteKind.PIT]
        sunk = self.ground_m == 0.0 and any(o.distance_m(target.x_m, target.y_m) == 0 for o in pits)
        for item in self.objects:
            height_m = item.surface_m(target.x_m, target.y_m)
            if height_m is not None and abs(height_m - target.z_m) <= SURFACE_TOLERANCE_M:
                return item.name
        level = not sunk and abs(target.z_m - self.ground_m) <= SURFACE_TOLERANCE_M
        return self.names[0] if level else None

    @property
    def floor_m(self) -> float:
        """Height of the lowest surface."""
        depths = [o.height_m for o in self.objects if o.kind is SiteKind.PIT]
        return min(self.ground_m, 0.0) - max(depths, default=0.0)

    def distances(self, points_m: Array) -> Array:
        """Signed distances (..., 1 + K) of points (..., 3) from ground and objects.

        A pit is part of the ground; its column is infinite.
        """
        points = np.asarray(points_m, dtype=np.float64)
        columns = [points[..., 2] - self.ground_m]
        for item in self.objects:
            along, across = _local(item, points)
            if item.kind is SiteKind.BOX:
                columns.append(_box(item, along, across, points[..., 2]))
            elif item.kind is SiteKind.PILE:
                columns.append(_pile(item, along, across, points[..., 2]))
            else:
                columns.append(np.full(along.shape, np.inf))
                if self.ground_m == 0.0:
                    columns[0] = _with_pit(item, columns[0], along, across, points[..., 2])
        return np.stack(columns, axis=-1)

    def distance(self, points_m: Array) -> Array:
        """Signed distance (...) of points (..., 3) from the nearest solid."""
        return self.distances(points_m).min(axis=-1)

    def closes(self, before_m: Array, after_m: Array, radius_m: float) -> BoolArray:
        """Whether balls touch a surface between consecutive points (..., 3) of their flight.

        A ball that starts below raised ground passes it from below; it ends on the lowest surface if it
        never falls from above.
        """
        was_open = self.distance(before_m) > radius_m
        return (self.distance(after_m) <= radius_m) & (
            was_open | (after_m[..., 2] <= self.floor_m + radius_m)
        )

    def contact(self, centre_m: Array, radius_m: float) -> Contact:
        """Contacts of balls (N, 3) that touch a surface."""
        solid = self.distances(centre_m).argmin(axis=-1)
        slope = np.empty_like(centre_m)
        for axis in range(3):
            step = np.zeros(3)
            step[axis] = _NUDGE_M
            slope[:, axis] = self.distance(centre_m + step) - self.distance(centre_m - step)
        length = np.linalg.norm(slope, axis=-1, keepdims=True)
        normal = slope / np.where(length > 0.0, length, 1.0)
        point = centre_m - radius_m * normal
        # The height of a level surface must not depend on rounding of the normal.
        level = normal[:, 2] > 1.0 - 1e-6
        point[level, :2] = centre_m[level, :2]
        return Contact(point, self._named(solid, point), normal[:, 2] < TOP_MIN_RATIO)

    def _named(self, solid: IntArray, point_m: Array) -> IntArray:
        """Replace the ground's index by that of the pit for contacts inside a pit."""
        named = solid.copy()
        for index, item in enumerate(self.objects, 1):
            if item.kind is SiteKind.PIT and self.ground_m == 0.0:
                along, across = _local(item, point_m)
                over = (np.abs(along) <= 0.5 * item.length_m + _NUDGE_M) & (
                    np.abs(across) <= 0.5 * item.width_m + _NUDGE_M
                )
                named[(solid == 0) & over & (point_m[:, 2] < -_NUDGE_M)] = index
        return named


def touch_share(gap_at: Callable[[Array], Array], count: int) -> Array:
    """Share (N,) of a step at which a gap closes, by bisection.

    Args:
        gap_at: gaps (N,) at shares (N,); above zero before the touch.
        count: N.
    """
    low, high = np.zeros(count), np.ones(count)
    for _ in range(BISECTIONS_COUNT):
        middle = 0.5 * (low + high)
        is_open = gap_at(middle) > 0.0
        low, high = np.where(is_open, middle, low), np.where(is_open, high, middle)
    return high


def _local(item: SiteObject, points: Array) -> tuple[Array, Array]:
    dx, dy = points[..., 0] - item.x_m, points[..., 1] - item.y_m
    cos, sin = np.cos(item.turn_rad), np.sin(item.turn_rad)
    return cos * dx + sin * dy, cos * dy - sin * dx


def _box(item: SiteObject, along: Array, across: Array, z: Array) -> Array:
    middle = item.base_height_m + 0.5 * item.height_m
    out = np.stack(
        [
            np.abs(along) - 0.5 * item.length_m,
            np.abs(across) - 0.5 * item.width_m,
            np.abs(z - middle) - 0.5 * item.height_m,
        ],
        axis=-1,
    )
    outside = np.linalg.norm(np.maximum(out, 0.0), axis=-1)
    return outside + np.minimum(out.max(axis=-1), 0.0)


def _pile(item: SiteObject, along: Array, across: Array, z: Array) -> Array:
    a, b = 0.5 * item.length_m, 0.5 * item.width_m
    out = np.sqrt((along / a) ** 2 + (across / b) ** 2)
    fall = (1.0 - item.top_ratio) / item.height_m
    wide = np.maximum(out, 1e-9)
    steep = np.sqrt((along / (a * a * wide)) ** 2 + (across / (b * b * wide)) ** 2 + fall * fall)
    return np.maximum((out - 1.0 + fall * z) / steep, z - item.height_m)


def _with_pit(item: SiteObject, ground: Array, along: Array, across: Array, z: Array) -> Array:
    wall = np.minimum(0.5 * item.length_m - np.abs(along), 0.5 * item.width_m - np.abs(across))
    rim = np.where(z < 0.0, wall, np.hypot(wall, np.maximum(z, 0.0)))
    return np.where(wall > 0.0, np.minimum(z + item.height_m, rim), ground)
