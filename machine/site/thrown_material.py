"""Bulk material of one load: what a plan says of it, and where it came to lie."""

import math
from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

Positive = Annotated[float, Field(gt=0.0)]


class ThrownMaterial(BaseModel):
    """A grab of bulk material as it is planned; what the grab really holds differs."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    name: str = Field(min_length=1, max_length=40)
    volume_m3: float = Field(gt=0.0, le=3.0)
    """Loose, with its pores."""
    mass_kg: Positive
    grain_diameter_m: Positive
    """Median; diameters are log-normal."""
    grain_spread_ratio: float = Field(ge=0.0, le=1.5)
    """Standard deviation of the diameter's natural logarithm."""
    grain_density_kg_per_m3: Positive
    drag_coefficient_ratio: Positive
    """Of one grain, with its frontal area."""


def load_kg(material: ThrownMaterial | None) -> float:
    """Mass of a plan's bulk material; 0: the ball."""
    return 0.0 if material is None else material.mass_kg


class MaterialFootprint(BaseModel):
    """How a load of bulk material came to lie about the point where it landed, as measured."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)
    volume_m3: Positive
    covariance_m2: tuple[float, float, float]
    """xx, xy and yy of the places of its volume, frame `machine`."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        xx, xy, yy = self.covariance_m2
        if min(xx, yy) < 0.0 or xy * xy > xx * yy * (1.0 + 1e-9) + 1e-12:
            raise ValueError(f"covariance_m2 {self.covariance_m2} is no covariance")
        return self

    @property
    def sd_m(self) -> tuple[float, float]:
        """Standard deviations along its longest axis and across."""
        xx, xy, yy = self.covariance_m2
        middle, turn = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
        return math.sqrt(middle + turn), math.sqrt(max(middle - turn, 0.0))
