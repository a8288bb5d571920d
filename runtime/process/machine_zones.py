"""Exclusion zones of one machine: what its checks, its safety gate and its answers to plans need of them."""

import math
from typing import Final

import numpy as np

from machine.conventions import Array, Mode
from machine.messages import ThrowPlan
from machine.site.zones import ZoneSet
from machine.spec import MachineSpec
from runtime.guard.zones import (
    ZoneEntry,
    arm_entries_m,
    deepest,
    prisms_of,
    region_entry,
    region_ratio,
    turn_entry,
)

NO_ZONES: Final = ZoneSet(version_count=0)


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
