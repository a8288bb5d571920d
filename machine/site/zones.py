"""Exclusion zones: spaces around a machine that its arm, its gripper and its loads stay out of.

A zone is an upright prism: a polygon on the ground and two heights, frame `machine`. A box is a polygon of
four corners. Zones keep things safe, not people: nothing here sees who walks into one.
"""

import hashlib
import json
from collections.abc import Sequence
from typing import Annotated, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from machine.conventions import FILLED_LINE_PATTERN, NAME_PATTERN

MAX_ZONE_COUNT = 16
MAX_CORNER_COUNT = 24
MIN_AREA_M2 = 0.01
MIN_HEIGHT_M = 0.1

Coordinate = Annotated[
    float, Field(ge=-60.0, le=60.0), AfterValidator(lambda value_m: round(value_m, 3))
]
"""Metres, to the millimetre: what is drawn is no more exact, and a set stays small on the link."""
Corner = tuple[Coordinate, Coordinate]


class Zone(BaseModel):
    """One space that is kept free, and why."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    name: str = Field(min_length=1, max_length=40, pattern=NAME_PATTERN)
    reason: str = Field(min_length=3, max_length=200, pattern=FILLED_LINE_PATTERN)
    """What is there, for whoever meets the zone later."""
    corners_m: tuple[Corner, ...] = Field(min_length=3, max_length=MAX_CORNER_COUNT)
    """(x, y) of the polygon's corners in order, in either direction; the last is joined to the first."""
    bottom_m: float = Field(default=0.0, ge=-5.0, le=30.0)
    """Lowest height that is kept free, above ground."""
    top_m: float = Field(ge=-5.0, le=40.0)
    """Highest height that is kept free."""

    @model_validator(mode="after")
    def _check_shape(self) -> Self:
        if self.top_m < self.bottom_m + MIN_HEIGHT_M:
            raise ValueError(
                f"{self.name}: its top ({self.top_m:.2f} m) must be at least {MIN_HEIGHT_M:.1f} m "
                f"above its bottom ({self.bottom_m:.2f} m)"
            )
        crossing = _crossing_edges(self.corners_m)
        if crossing is not None:
            first, second = crossing
            raise ValueError(
                f"{self.name}: the edge from corner {first + 1} crosses or touches the edge from corner "
                f"{second + 1}; put the corners in the order in which one walks around"
            )
        if abs(_area_m2(self.corners_m)) < MIN_AREA_M2:
            raise ValueError(f"{self.name}: its corners lie on a line; a zone needs an area")
        return self


def _area_m2(corners: Sequence[Corner]) -> float:
    """Signed area of a polygon; positive anticlockwise."""
    following = (*corners[1:], corners[0])
    return 0.5 * sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(corners, following, strict=True))


def _crossing_edges(corners: Sequence[Corner]) -> tuple[int, int] | None:
    """Numbers of two edges that meet where they should not; None for a simple polygon."""
    count = len(corners)
    for first in range(count):
        a, b = corners[first], corners[(first + 1) % count]
        if a == b:
            return first, (first + 1) % count
        for second in range(first + 1, count):
            c, d = corners[second], corners[(second + 1) % count]
            if second == first + 1:
                meets = _is_on(d, a, b) or _is_on(a, c, d)
            elif (second + 1) % count == first:
                meets = _is_on(c, a, b) or _is_on(b, c, d)
            else:
                meets = _meet(a, b, c, d)
            if meets:
                return first, second
    return None


def _turn(a: Corner, b: Corner, c: Corner) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _is_on(point: Corner, a: Corner, b: Corner) -> bool:
    """Whether a point lies on the segment from a to b."""
    inside = all(min(a[i], b[i]) <= point[i] <= max(a[i], b[i]) for i in (0, 1))
    return inside and _turn(a, b, point) == 0.0


def _meet(a: Corner, b: Corner, c: Corner, d: Corner) -> bool:
    """Whether two segments cross or touch."""
    if _turn(a, b, c) * _turn(a, b, d) < 0.0 and _turn(c, d, a) * _turn(c, d, b) < 0.0:
        return True
    return _is_on(c, a, b) or _is_on(d, a, b) or _is_on(a, c, d) or _is_on(b, c, d)


def _with_own_names(zones: tuple[Zone, ...]) -> tuple[Zone, ...]:
    names = [zone.name.lower() for zone in zones]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"two zones are named '{name}'; give each its own name")
    return zones


Zones = Annotated[
    tuple[Zone, ...], Field(max_length=MAX_ZONE_COUNT), AfterValidator(_with_own_names)
]
"""All zones around one machine; every name once."""


def zones_sha256(zones: Sequence[Zone]) -> str:
    """sha256 of a set's canonical JSON, as plans and states name it; empty for no zones."""
    if not zones:
        return ""
    content = [zone.model_dump(mode="json") for zone in zones]
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


class ZoneSet(BaseModel):
    """An approved set, as machines keep it."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    version_count: int = Field(ge=0)
    """Of the set on the server that sent it; 0 before the first."""
    approved_by: str = Field(default="", max_length=64)
    zones: Zones = ()

    @property
    def sha256(self) -> str:
        """`zones_sha256` of its zones."""
        return zones_sha256(self.zones)
