"""Exclusion zones of one machine: what its checks, its safety gate and its answers to plans need of them."""

import math
from typing import Final

import numpy as np

from machine.conventions import Array, Mode
from machine.messages import ThrowPlan
from machine.site.zones import ZoneSet
from machine.spec import MachineSpec
from runtime.guard.zones import (
    PATH_MARGIN_M,
    ZoneEntry,
    arm_entries_m,
    deepest,
    path_entry,
    prisms_of,
    region_entry,
    region_ratio,
    turn_entry,
)

NO_ZONES: Final = ZoneSet(version_count=0)
MOVED_LIMIT_RAD_OR_M: Final = 0.05
"""Of a joint since the preview: its path is not the one that the arm will take."""


class MachineZones:
    """The zones on board; None where they cannot be read."""

    def __init__(self, spec: MachineSpec, zone_set: ZoneSet | None) -> None:
        self._spec = spec
        self.sha256 = None if zone_set is None else zone_set.sha256
        self.count = None if zone_set is None else len(zone_set.zones)
        self.prisms = prisms_of(zone_set.zones) if zone_set is not None and self.count else None

    def arm_entry(self, position_rad_m: Array) -> ZoneEntry | None:
        """The zone that the arm stands in, for joints (6,); None = none, or the joints are unknown."""
        if self.prisms is None or not np.isfinite(position_rad_m).all():
            return None
        return deepest(self.prisms, arm_entries_m(self._spec, self.prisms, position_rad_m[None])[0])

    def conflict(self, plan: ThrowPlan, position_rad_m: Array) -> str:
        """Why a plan conflicts with the zones, for people; empty = it does not.

        Args:
            plan: to be armed.
            position_rad_m: (6,) where the arm stands.
        """
        if self.prisms is None:
            return ""
        ellipse = plan.predicted_ellipse
        if ellipse is None or not math.isfinite(region_ratio(ellipse.landed_count)):
            return (
                "The plan does not say how its landings scatter, so they cannot be held against the "
                "exclusion zones. Preview again."
            )
        region = region_entry(self._spec, self.prisms, ellipse, plan.target)
        if region is not None:
            return (
                f"The landing region (99.9 %) reaches {region.depth_m:.2f} m into zone '{region.name}', "
                f"which is kept free up to {region.top_m:.1f} m. Choose another target."
            )
        return self._path_conflict(plan, position_rad_m) or self._turn_conflict(
            plan, position_rad_m
        )

    def _path_conflict(self, plan: ThrowPlan, position_rad_m: Array) -> str:
        """Whether the planned motion begins where the arm stands, and keeps out of the zones."""
        assert self.prisms is not None
        path = np.array(plan.swept_path_rad_m or ())
        if len(path) < 2:
            return (
                "The plan does not say how the arm moves, so that cannot be held against the exclusion "
                "zones. Preview again."
            )
        away = position_rad_m[:4] - path[0, :4]
        away[0] = math.remainder(away[0], 2.0 * math.pi)
        moved = float(np.abs(away).max())
        if moved > MOVED_LIMIT_RAD_OR_M:
            return (
                f"A joint stands {moved:.2f} rad or m from where it stood at the preview "
                f"({MOVED_LIMIT_RAD_OR_M:.2f} allowed): the arm would take another way past the exclusion "
                "zones. Preview again."
            )
        found = path_entry(self._spec, self.prisms, path)
        if found is None:
            return ""
        return (
            f"In the throw arm or gripper would come within {PATH_MARGIN_M:.2f} m of zone '{found.name}'. "
            "Choose another target, or change the zone."
        )

    def _turn_conflict(self, plan: ThrowPlan, position_rad_m: Array) -> str:
        """Whether the turn to the target, by the machine's own reckoning, keeps out of the zones."""
        assert self.prisms is not None
        turn = turn_entry(
            self._spec,
            self.prisms,
            position_rad_m,
            plan.target,
            turns=plan.mode is Mode.PLANAR,
        )
        if turn is not None:
            return (
                f"On the way to the target the arm would reach {turn.depth_m:.2f} m into zone "
                f"'{turn.name}'. Choose another target, or change the zone."
            )
        return ""
