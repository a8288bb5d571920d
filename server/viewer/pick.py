"""A click in the 3D view becomes a point on an object's top or on the ground, or is refused with a reason.

Pure arithmetic, frame `machine`. It says nothing about reach: that is the plan's matter.
"""

import math
from collections.abc import Sequence
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from machine.conventions import Array
from machine.errors import DownrangeError
from machine.site.objects import GROUND, SiteObject
from machine.site.solids import Solids, touch_share

Point = tuple[float, float, float]

MIN_GRAZING_RAD = math.radians(5.0)
"""Below this angle one pixel covers metres of ground."""
MAX_PICK_RANGE_M = 60.0
"""Bound of machine.messages.Target."""
MARCH_STEP_M = 0.02
"""Objects are at least 0.1 m thick; a ray that cuts a corner shorter than this may pass it."""
MARCH_LENGTH_M = 200.0
"""Farther than any camera stands (server.viewer.theme) from what may be picked."""


class PickReason(StrEnum):
    """Why a click gave no target."""

    GRAZING = "grazing"
    SIDE = "side"
    SKY = "sky"
    TOO_FAR = "too_far"
    MALFORMED = "malformed"


class PickRefusedError(DownrangeError):
    """A click that gave no target; ``reason`` is stable, the text is for the operator."""

    code = "pick_refused"

    def __init__(self, reason: PickReason, text: str) -> None:
        super().__init__(text)
        self.reason = reason


class Ray(NamedTuple):
    """A click as the view sends it: origin (3,) m and direction (3,), frame `machine`."""

    origin_m: Array
    direction: Array


def pick_surface(ray: Ray, objects: Sequence[SiteObject]) -> Point:
    """Return where a ray first meets the top of an object, a pit's floor or the ground, frame `machine`.

    Args:
        ray: origin and direction (any length) of the click.
        objects: what stands around.

    Raises:
        PickRefusedError: the ray is malformed, meets nothing, a side, grazes or meets it too far away.
    """
    origin, direction = _checked(ray)
    if not objects:
        return pick_ground(ray)
    solids = Solids(objects)
    along = np.arange(0.0, MARCH_LENGTH_M, MARCH_STEP_M)
    path = origin + along[:, None] * direction
    is_open = solids.distance(path) > 0.0
    closing = np.flatnonzero(is_open[:-1] & ~is_open[1:])
    if closing.size == 0:
        return pick_ground(ray)
    start = along[closing[:1]]

    def gap(share: Array) -> Array:
        return solids.distance(origin + (start + share * MARCH_STEP_M)[:, None] * direction)

    at = start + touch_share(gap, 1) * MARCH_STEP_M
    contact = solids.contact(origin + at[:, None] * direction, 0.0)
    name = solids.names[int(contact.solid[0])]
    if name == GROUND:
        return pick_ground(ray)
    if contact.is_side[0]:
        raise PickRefusedError(
            PickReason.SIDE, f"That is the side of {name}. Click on a surface a load can lie on."
        )
    _check_grazing(float(direction[2]), name)
    x_m, y_m, z_m = (float(value) for value in contact.point_m[0])
    return _within_the_yard(x_m, y_m, round(z_m, 6))


def _checked(ray: Ray) -> tuple[Array, Array]:
    """Origin and unit direction of a ray."""
    origin = np.asarray(ray.origin_m, dtype=np.float64)
    direction = np.asarray(ray.direction, dtype=np.float64)
    length = float(np.linalg.norm(direction))
    if not (np.isfinite(origin).all() and np.isfinite(direction).all() and length > 1e-9):
        raise PickRefusedError(
            PickReason.MALFORMED, "The click carried no usable ray. Click again."
        )
    return origin, direction / length


def _check_grazing(slope: float, name: str) -> None:
    grazing = math.asin(min(1.0, abs(slope)))
    if grazing < MIN_GRAZING_RAD:
        raise PickRefusedError(
            PickReason.GRAZING,
            f"Line of sight meets the {name} at {math.degrees(grazing):.1f} deg, "
            f"{math.degrees(MIN_GRAZING_RAD):.0f} deg needed. Raise the view, or type the target.",
        )


def pick_ground(ray: Ray) -> Point:
    """Return where a ray meets the ground, m, frame `machine`.

    Raises:
        PickRefusedError: the ray is malformed, misses the ground, grazes it or meets it too far away.
    """
    origin, direction = _checked(ray)
    slope = float(direction[2])
    if float(origin[2]) * slope >= 0.0:
        raise PickRefusedError(
            PickReason.SKY, "No ground there. Click on the ground, or tilt the view downward."
        )
    _check_grazing(slope, GROUND)
    point = origin - direction * (float(origin[2]) / slope)
    return _within_the_yard(float(point[0]), float(point[1]), 0.0)


def _within_the_yard(x_m: float, y_m: float, z_m: float) -> Point:
    range_m = math.hypot(x_m, y_m)
    if max(abs(x_m), abs(y_m)) > MAX_PICK_RANGE_M:
        raise PickRefusedError(
            PickReason.TOO_FAR,
            f"The point lies {range_m:.0f} m away, {MAX_PICK_RANGE_M:.0f} m is the edge of the yard.",
        )
    return x_m, y_m, z_m
