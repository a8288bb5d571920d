"""A click in the 3D view becomes a point on the ground; a ray that grazes it is refused with a reason.

Pure arithmetic, frame `machine`. It says nothing about reach: that is the plan's matter.
"""

import math
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from machine.conventions import Array
from machine.errors import DownrangeError

MIN_GRAZING_RAD = math.radians(5.0)
"""Below this angle one pixel covers metres of ground (design C2)."""
MAX_PICK_RANGE_M = 60.0
"""Bound of machine.messages.Target."""


class PickReason(StrEnum):
    """Why a click gave no target."""

    GRAZING = "grazing"
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


def pick_ground(ray: Ray, height_m: float = 0.0) -> tuple[float, float, float]:
    """Return where a ray meets the horizontal plane of the target surface, m, frame `machine`.

    Args:
        ray: origin and direction (any length) of the click.
        height_m: height of the target plane above ground.

    Raises:
        PickRefusedError: the ray is malformed, misses the plane, grazes it or meets it too far away.
    """
    origin = np.asarray(ray.origin_m, dtype=np.float64)
    direction = np.asarray(ray.direction, dtype=np.float64)
    length = float(np.linalg.norm(direction))
    if not (np.isfinite(origin).all() and np.isfinite(direction).all() and length > 1e-9):
        raise PickRefusedError(
            PickReason.MALFORMED, "The click carried no usable ray. Click again."
        )
    drop = height_m - float(origin[2])
    slope = float(direction[2]) / length
    if drop * slope <= 0.0:
        raise PickRefusedError(
            PickReason.SKY, "No ground there. Click on the ground, or tilt the view downward."
        )
    grazing = math.asin(min(1.0, abs(slope)))
    if grazing < MIN_GRAZING_RAD:
        raise PickRefusedError(
            PickReason.GRAZING,
            f"Line of sight meets the ground at {math.degrees(grazing):.1f} deg, "
            f"{math.degrees(MIN_GRAZING_RAD):.0f} deg needed. Raise the view, or type the target.",
        )
    point = origin + direction / length * (drop / slope)
    range_m = math.hypot(float(point[0]), float(point[1]))
    if max(abs(float(point[0])), abs(float(point[1]))) > MAX_PICK_RANGE_M:
        raise PickRefusedError(
            PickReason.TOO_FAR,
            f"The point lies {range_m:.0f} m away, {MAX_PICK_RANGE_M:.0f} m is the edge of the yard.",
        )
    return float(point[0]), float(point[1]), height_m
