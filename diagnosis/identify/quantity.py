"""An identified number with its interval, or the reason why these logs cannot give it."""

import numpy as np
from pydantic import BaseModel, ConfigDict

from diagnosis.intervals import mean_interval
from machine.conventions import Array

CONFIDENCE_RATIO = 0.90


class Quantity(BaseModel):
    """One identified quantity. `value` is None where it cannot be known from the logs; `why` says why."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)
    unit: str
    value: float | None = None
    ci90: tuple[float, float] | None = None
    spread: float | None = None
    """Standard deviation from throw to throw (or segment to segment), where it was estimated."""
    at_least: float | None = None
    """What was reached without the quantity showing."""
    count: int = 0
    """Throws or segments behind it."""
    why: str = ""


def unknown(unit: str, why: str, at_least: float | None = None, count: int = 0) -> Quantity:
    """A quantity that cannot be known from these logs."""
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
