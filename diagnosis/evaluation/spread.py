"""What a spread is made of: the part that hangs on the start pose, and what differs from throw to throw."""

from collections.abc import Sequence

import numpy as np
from pydantic import BaseModel, ConfigDict

from machine.conventions import Array
from sim_twin.throws.campaign import Outcome, ThrowResult


class SpreadParts(BaseModel):
    """Standard deviations at one target, m, frame `throw`: the squares of the two parts add up."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)
    range_m: float
    start_count: int
    """Starts from which at least two throws landed."""
    throw_count: int
    between_starts_downrange_m: float
    within_start_downrange_m: float
    between_starts_crossrange_m: float
    within_start_crossrange_m: float


def spread_parts(range_m: float, by_start: Sequence[Sequence[ThrowResult]]) -> SpreadParts | None:
    """Split the spread of throws that were repeated from the same starts (one way analysis of variance).

    Args:
        range_m: of the target.
        by_start: throws from each start.

    Returns:
        None where fewer than two starts have two throws that landed.
    """
    groups = [[r for r in part if r.outcome is Outcome.LANDED] for part in by_start]
    groups = [part for part in groups if len(part) >= 2]
    if len(groups) < 2:
        return None
    down = _parts([np.array([r.downrange_error_m for r in part]) for part in groups])
    cross = _parts([np.array([r.crossrange_error_m for r in part]) for part in groups])
    return SpreadParts(
        range_m=range_m,
        start_count=len(groups),
        throw_count=sum(map(len, groups)),
        between_starts_downrange_m=down[0],
        within_start_downrange_m=down[1],
        between_starts_crossrange_m=cross[0],
        within_start_crossrange_m=cross[1],
    )


def _parts(groups: Sequence[Array]) -> tuple[float, float]:
    """Standard deviations between and within groups, without bias in their squares."""
    sizes = np.array([g.size for g in groups], dtype=np.float64)
    total, count = float(sizes.sum()), len(groups)
    within = sum(float(((g - g.mean()) ** 2).sum()) for g in groups) / (total - count)
    middle = float(np.concatenate(groups).mean())
    means = np.array([g.mean() for g in groups])
    between = float(sizes @ (means - middle) ** 2) / (count - 1)
    # Throws a start, as unequal groups count (Searle, Linear Models, 1971, ch. 9).
    each = (total - float((sizes**2).sum()) / total) / (count - 1)
    return float(np.sqrt(max((between - within) / each, 0.0))), float(np.sqrt(within))
