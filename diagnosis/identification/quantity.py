"""An identified number with its interval, or the reason why the logs do not determine it."""

import numpy as np
from pydantic import BaseModel, ConfigDict

from machine.conventions import Array
from sim_twin.confidence_intervals import mean_interval

CONFIDENCE_RATIO = 0.90


class Quantity(BaseModel):
    """One identified quantity; where the logs do not determine it, `value` is None and `why` the reason."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)
    unit: str
    value: float | None = None
    ci90: tuple[float, float] | None = None
    spread: float | None = None
    """Standard deviation between throws or segments, where it was estimated."""
    at_least: float | None = None
    """Largest magnitude that was reached without the quantity showing."""
    count: int = 0
    """Number of throws or segments behind it."""
    why: str = ""


class AxisSwing(BaseModel):
    """Free swing of one passive joint."""

    model_config = ConfigDict(frozen=True)
    joint: str
    viscous_friction_per_s: Quantity
    coulomb_friction_rad_per_s2: Quantity
    length_m: Quantity
    residual_rad_per_s: float | None = None
    swing_count: int = 0
    plot: dict[str, list[float]] = {}
    """Time, measured and predicted angle of the longest swing."""


def unknown(unit: str, why: str, at_least: float | None = None, count: int = 0) -> Quantity:
    """A quantity that the logs do not determine."""
    words = f"cannot be known from these logs: {why}"
    return Quantity(unit=unit, why=words, at_least=at_least, count=count)


def mean_quantity(values: Array, unit: str) -> Quantity:
    """Mean of independent values (n,) with Student's interval.

    Raises:
        ValueError: fewer than two values.
    """
    ci90 = mean_interval(values, CONFIDENCE_RATIO)
    return Quantity(
        unit=unit,
        value=float(np.mean(values)),
        ci90=ci90,
        spread=float(np.std(values, ddof=1)),
        count=int(values.size),
    )
