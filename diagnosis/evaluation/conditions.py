"""Throws by what was asked of them: pace and height of the target, one row a condition."""

from collections.abc import Sequence

import numpy as np
from pydantic import BaseModel, ConfigDict

from sim_twin.throws.accuracy import landing_errors
from sim_twin.throws.campaign import Outcome, ThrowResult


class ConditionRow(BaseModel):
    """Landings under one condition, m, frame `throw`; None where fewer than two throws landed."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)
    range_m: float
    height_m: float
    pace_ratio: float
    throw_count: int
    landed_count: int
    mean_downrange_error_m: float | None
    sd_downrange_m: float | None
    mean_crossrange_error_m: float | None
    sd_crossrange_m: float | None
    start_to_release_s: float | None
    """Mean of the throws that landed."""
    release_speed_m_per_s: float | None
    """Mean of the throws that landed."""


def condition_row(
    range_m: float, height_m: float, pace_ratio: float, results: Sequence[ThrowResult]
) -> ConditionRow:
    """What came of the throws at one target at one pace."""
    down, cross = landing_errors(results)
    landed = [r for r in results if r.outcome is Outcome.LANDED]
    numbers: dict[str, float] = {}
    if len(landed) >= 2:
        numbers = {
            "mean_downrange_error_m": float(down.mean()),
            "sd_downrange_m": float(down.std(ddof=1)),
            "mean_crossrange_error_m": float(cross.mean()),
            "sd_crossrange_m": float(cross.std(ddof=1)),
            "start_to_release_s": float(np.mean([r.throw_duration_s for r in landed])),
            "release_speed_m_per_s": float(np.mean([r.release_speed_m_per_s for r in landed])),
        }
    empty = dict.fromkeys(ConditionRow.model_fields)
    known = {
        "range_m": range_m,
        "height_m": height_m,
        "pace_ratio": pace_ratio,
        "throw_count": len(results),
        "landed_count": len(landed),
    }
    return ConditionRow.model_validate({**empty, **known, **numbers})


def pooled(rows: Sequence[ConditionRow], name: str) -> float | None:
    """Root mean square of a number over rows that have it: the spread over several targets."""
    values = [v for v in (getattr(row, name) for row in rows) if v is not None]
    return float(np.sqrt(np.mean(np.square(values)))) if values else None
