"""Boxes, pits and piles around a machine: surfaces to throw at, and obstacles.

One kind of record for all objects, in frame `machine`. A wall is a thin box, a truck bed a box, a platform a
box with a base above the ground. The ground itself is not listed.
"""

import math
from enum import StrEnum
from typing import Annotated, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    model_validator,
)

from machine.conventions import NAME_PATTERN

GROUND = "ground"
"""Name of the ground."""
UNDESCRIBED = "surface at the target's height"
"""Name of ground whose height is known from a target on it only."""
SWING_CIRCLE_M = 2.7
"""Smallest distance of objects from the slew axis: the chassis' corner is at 2.65 m, the tail of the turning
carriage at 2.24 m (boxes `chassis_obstacle` and `upper_obstacle` of m545.xml)."""
MAX_COUNT = 32
MAX_PIT_DEPTH_M = 1.0
MAX_PILE_SLOPE_RAD = math.radians(45.0)
"""Largest slope of a pile: loose earth and gravel rest at 30 to 45 degrees. A steeper wall is a box."""


class SiteKind(StrEnum):
    """What an object is."""

    BOX = "box"
    PIT = "pit"
    PILE = "pile"


class SiteObject(BaseModel):
    """One thing at its place. Lengths are those of its footprint, which is turned about its centre."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    name: str = Field(min_length=1, max_length=40, pattern=NAME_PATTERN)
    kind: SiteKind
    x_m: float = Field(ge=-60.0, le=60.0)
    y_m: float = Field(ge=-60.0, le=60.0)
    turn_rad: float = Field(default=0.0, ge=-math.pi, le=math.pi)
    """Angle of its length from the machine's x axis, positive to the left."""
    length_m: float = Field(ge=0.2, le=30.0)
    width_m: float = Field(ge=0.2, le=30.0)
    height_m: float = Field(ge=0.1, le=5.0)
    """Height from base to top; depth of a pit."""
    base_height_m: float = Field(default=0.0, ge=0.0, le=5.0)
    """Height of the base of a box above ground."""
    top_ratio: float = Field(default=0.0, ge=0.0, le=0.95)
    """Flat top of a pile as a share of the foot's length and width; 0: a peak."""

    @model_validator(mode="after")
    def _check_shape(self) -> Self:
        if self.name.lower() == GROUND:
            raise ValueError(f"an object cannot be named '{GROUND}'")
        if self.kind is SiteKind.PIT and self.height_m > MAX_PIT_DEPTH_M:
            raise ValueError(
                f"{self.name}: a pit is at most {MAX_PIT_DEPTH_M:.2f} m deep, not {self.height_m:.2f} m"
            )
        if self.kind is not SiteKind.BOX and self.base_height_m != 0.0:
            raise ValueError(f"{self.name}: only a box can have its base above the ground")
        if self.kind is not SiteKind.PILE and self.top_ratio != 0.0:
            raise ValueError(f"{self.name}: only a pile has a top ratio")
        if self.kind is SiteKind.PILE and self.slope_rad > MAX_PILE_SLOPE_RAD + 1e-9:
            raise ValueError(
                f"{self.name}: a pile's slope of {math.degrees(self.slope_rad):.0f} deg is steeper than "
                f"{math.degrees(MAX_PILE_SLOPE_RAD):.0f} deg; make it wider or lower, or give it as a box"
            )
        if self.distance_m(0.0, 0.0) < SWING_CIRCLE_M:
            raise ValueError(
                f"{self.name} comes within {self.distance_m(0.0, 0.0):.2f} m of the slew axis, at least "
                f"{SWING_CIRCLE_M:.2f} m are needed: the machine turns there"
            )
        return self

    @property
    def slope_rad(self) -> float:
        """Angle of a pile's steepest side."""
        run_m = 0.5 * min(self.length_m, self.width_m) * (1.0 - self.top_ratio)
        return math.atan2(self.height_m, run_m)

    def local_m(self, x_m: float, y_m: float) -> tuple[float, float]:
        """A point in the object's own axes, from its centre."""
        dx, dy = x_m - self.x_m, y_m - self.y_m
        cos, sin = math.cos(self.turn_rad), math.sin(self.turn_rad)
        return cos * dx + sin * dy, cos * dy - sin * dx

    def distance_m(self, x_m: float, y_m: float) -> float:
        """Horizontal distance of a point from the footprint's rectangle; 0 inside."""
        along, across = self.local_m(x_m, y_m)
        out_x = max(abs(along) - 0.5 * self.length_m, 0.0)
        out_y = max(abs(across) - 0.5 * self.width_m, 0.0)
        return math.hypot(out_x, out_y)

    def surface_m(self, x_m: float, y_m: float) -> float | None:
        """Height of the upper surface at a point; None outside the footprint."""
        if self.kind is not SiteKind.PILE:
            if self.distance_m(x_m, y_m) > 0.0:
                return None
            down = self.kind is SiteKind.PIT
            return -self.height_m if down else self.base_height_m + self.height_m
        along, across = self.local_m(x_m, y_m)
        out_ratio = math.hypot(2.0 * along / self.length_m, 2.0 * across / self.width_m)
        if out_ratio > 1.0:
            return None
        return self.height_m * min(1.0, (1.0 - out_ratio) / (1.0 - self.top_ratio))


def _with_own_names(objects: tuple[SiteObject, ...]) -> tuple[SiteObject, ...]:
    names = [item.name.lower() for item in objects]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"two objects are named '{name}'; give each its own name")
    return objects


SiteObjects = Annotated[
    tuple[SiteObject, ...], Field(max_length=MAX_COUNT), AfterValidator(_with_own_names)
]
"""Everything around one machine; every name once."""
