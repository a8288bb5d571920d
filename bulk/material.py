"""Kinds of bulk material, and the volume and mass of a grab.

Values are assumed, as is typical of loose, dry material. A site that weighs and surveys its own material
gives its own numbers in the job file.
"""

import math
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from machine.conventions import GRAVITY_M_PER_S2
from machine.errors import UsageError

AIR_DENSITY_KG_PER_M3 = 1.204
MAX_CUT_RAD = math.radians(85.0)
"""Steepest wall that a grab leaves in cohesive material."""

Positive = Annotated[float, Field(gt=0.0)]


class Material(BaseModel):
    """A loose material."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    name: str = Field(min_length=1, max_length=40)
    loose_density_kg_per_m3: Positive
    """Mass of a volume as poured, with its pores."""
    repose_rad: float = Field(ge=math.radians(10.0), le=math.radians(60.0))
    """Angle of repose: steepest slope of a poured pile."""
    grain_diameter_m: Positive
    """Median; diameters are log-normal."""
    grain_spread_ratio: float = Field(ge=0.0, le=1.5)
    """Standard deviation of the diameter's natural logarithm."""
    grain_density_kg_per_m3: Positive
    drag_coefficient_ratio: Positive
    """Of one grain, with its frontal area."""
    cohesion_pa: float = Field(ge=0.0)
    swell_ratio: float = Field(ge=0.0, le=1.0)
    """Growth of the volume when it is dug from its bed."""
    source: str = ""

    @property
    def slope_ratio(self) -> float:
        """Tangent of the angle of repose."""
        return math.tan(self.repose_rad)

    @property
    def drag_per_m(self) -> float:
        """Drag of `machine.ballistics` for the median grain: 3 rho Cd / (4 rho_grain d), 1/m."""
        grain = self.grain_density_kg_per_m3 * self.grain_diameter_m
        return 0.75 * AIR_DENSITY_KG_PER_M3 * self.drag_coefficient_ratio / grain

    def mass_kg(self, volume_m3: float) -> float:
        """Mass of a loose volume."""
        return volume_m3 * self.loose_density_kg_per_m3

    def loose_volume_m3(self, bed_volume_m3: float) -> float:
        """Volume in the grab and on the pile of what fills a volume undisturbed."""
        return bed_volume_m3 * (1.0 + self.swell_ratio)

    def cut_slope_ratio(self, depth_m: float) -> float:
        """Tangent of the wall that a cut of a depth leaves: the angle of repose without cohesion.

        With cohesion the steepest plane-failure angle b for which Culmann's critical height
        4 c sin b cos f / (g rho (1 - cos(b - f))) is at least the depth (Craig's Soil Mechanics, chapter 12).
        """
        angle, step = self.repose_rad, math.radians(0.5)
        weight = GRAVITY_M_PER_S2 * self.loose_density_kg_per_m3
        while angle + step <= MAX_CUT_RAD:
            steeper = angle + step
            loss = 1.0 - math.cos(steeper - self.repose_rad)
            strength = 4.0 * self.cohesion_pa * math.sin(steeper) * math.cos(self.repose_rad)
            if strength < weight * depth_m * loss:
                break
            angle = steeper
        return math.tan(angle)


def _material(
    name: str, density: float, repose_deg: float, grain: tuple[float, float, float, float],
    cohesion_pa: float, swell: float, source: str,
) -> Material:  # fmt: skip
    diameter_m, spread, grain_density, drag = grain
    return Material(
        name=name,
        loose_density_kg_per_m3=density,
        repose_rad=math.radians(repose_deg),
        grain_diameter_m=diameter_m,
        grain_spread_ratio=spread,
        grain_density_kg_per_m3=grain_density,
        drag_coefficient_ratio=drag,
        cohesion_pa=cohesion_pa,
        swell_ratio=swell,
        source=source,
    )


_ASSUMED = "assumed: typical of loose, dry material"

MATERIALS: dict[str, Material] = {
    item.name: item
    for item in (
        _material("basketball", 48.0, 25.0, (0.2436, 0.0, 80.5, 0.5), 0.0, 0.0,
                  "machine/spec.json; spheres packed at random fill 0.6 of their space"),
        _material("gravel", 1520.0, 38.0, (0.016, 0.4, 2650.0, 1.0), 0.0, 0.12,
                  _ASSUMED),
        _material("sand", 1500.0, 34.0, (0.0006, 0.4, 2650.0, 1.2), 0.0, 0.12,
                  _ASSUMED),
        _material("scrap", 1000.0, 40.0, (0.10, 0.5, 2500.0, 1.2), 0.0, 0.0,
                  _ASSUMED),
        _material("wood chips", 300.0, 45.0, (0.03, 0.4, 550.0, 1.1), 0.0, 0.0,
                  _ASSUMED),
        _material("soil", 1200.0, 37.0, (0.004, 0.6, 2600.0, 1.1), 2000.0, 0.25,
                  _ASSUMED),
    )
}  # fmt: skip
"""Known kinds by name."""


def material(name: str) -> Material:
    """A known kind.

    Raises:
        UsageError: no such kind, with those that there are.
    """
    if name not in MATERIALS:
        raise UsageError(f"material '{name}' is not known; there are {', '.join(MATERIALS)}")
    return MATERIALS[name]
