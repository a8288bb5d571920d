"""The surface of a bulk job as an object of the site, for one throw at it."""

import math
from collections.abc import Sequence

from pydantic import ValidationError

from machine.site.files import SITE
from machine.site.objects import SiteKind, SiteObject
from machine.site.solids import SURFACE_TOLERANCE_M

JOB_SURFACE = "surface of the job"
"""Name of material on open ground."""
FLAT_RADIUS_M = 1.5
"""Radius around a target on open ground in which the material counts as level: more than loads scatter."""
SLOPE_RATIO = math.tan(math.radians(35.0))
"""Beyond it: a usual angle of repose."""
LEAST_M = 0.1
"""Smallest height of an object."""


def with_job_surface(
    objects: Sequence[SiteObject], x_m: float, y_m: float, surface_m: float
) -> tuple[SiteObject, ...]:
    """Objects of a site whose surface at a point is that of the material which lies there.

    A box under the point is raised as a whole, a pit filled; on open ground a flat pile is added. Where no
    object can stand for the material (too high, below open ground, too near to the machine) they stay as
    they are.

    Args:
        objects: of the site.
        x_m: of the point, frame `machine`.
        y_m: likewise.
        surface_m: height of the material there, to the centimetre.
    """
    surface_m = round(surface_m, 2)
    tops = [item.surface_m(x_m, y_m) for item in objects]
    known = [(top, number) for number, top in enumerate(tops) if top is not None]
    top_m, number = max(known, default=(0.0, -1))
    if abs(surface_m - top_m) <= SURFACE_TOLERANCE_M:
        return tuple(objects)
    try:
        if number < 0 or objects[number].kind is SiteKind.PILE:
            return SITE.validate_python((*objects, _flat_pile(x_m, y_m, surface_m)))
        changed = _with_surface(objects[number], surface_m)
    except ValidationError:
        return tuple(objects)
    return (*objects[:number], *changed, *objects[number + 1 :])


def _with_surface(item: SiteObject, surface_m: float) -> tuple[SiteObject, ...]:
    """A box or a pit with its surface elsewhere; nothing for a pit that is level with the ground."""
    change: dict[str, object] = {"height_m": surface_m - item.base_height_m}
    if item.kind is SiteKind.PIT:
        if abs(surface_m) <= SURFACE_TOLERANCE_M:
            return ()
        is_full = surface_m > 0.0
        change["kind"] = SiteKind.BOX if is_full else SiteKind.PIT
        change["height_m"] = max(abs(surface_m), LEAST_M)
    return (SiteObject.model_validate(item.model_dump() | change),)


def _flat_pile(x_m: float, y_m: float, surface_m: float) -> SiteObject:
    # Below open ground there is no pile: the negative height is refused.
    height_m = surface_m if surface_m < 0.0 else max(surface_m, LEAST_M)
    foot_m = 2.0 * (FLAT_RADIUS_M + abs(height_m) / SLOPE_RATIO)
    return SiteObject(
        name=JOB_SURFACE,
        kind=SiteKind.PILE,
        x_m=x_m,
        y_m=y_m,
        length_m=foot_m,
        width_m=foot_m,
        height_m=height_m,
        top_ratio=2.0 * FLAT_RADIUS_M / foot_m,
    )
