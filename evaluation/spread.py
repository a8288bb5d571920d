"""Parts of a landing spread: between start poses, and between throws from one start."""

from collections.abc import Sequence

import numpy as np
from pydantic import BaseModel, ConfigDict

from evaluation.campaigns import Campaign, campaign_starts
from machine.conventions import Array
from sim_twin.throws.campaign import ThrowOutcome, ThrowResult, run_throws

START_COUNT, REPEAT_COUNT = 25, 4
"""Start poses, and throws from each of them."""


class SpreadParts(BaseModel):
    """Standard deviations at one target, m, frame `throw`; the squares of the two parts add up."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)
    range_m: float
    start_count: int
    """Starts from which at least two throws landed."""
    throw_count: int
    between_starts_downrange_m: float
    within_start_downrange_m: float
    between_starts_crossrange_m: float
    within_start_crossrange_m: float


def measure_spread_parts(campaign: Campaign, range_m: float, seed: int) -> SpreadParts | None:
    """Throw repeatedly from the same starts at one range and split the spread."""
    target_m, starts = campaign_starts(
        campaign._replace(ranges_m=(range_m,), heights_m=(0.0,)), START_COUNT, seed
    )
    plant = campaign.make(START_COUNT * REPEAT_COUNT)
    try:
        results = run_throws(
            plant,
            campaign.params,
            np.repeat(target_m, REPEAT_COUNT, axis=0),
            np.repeat(starts, REPEAT_COUNT, axis=0),
            seed,
            pace_ratio=campaign.pace_ratio,
        )
    finally:
        plant.close()
    groups = [results[i : i + REPEAT_COUNT] for i in range(0, len(results), REPEAT_COUNT)]
    return spread_parts(range_m, groups)


def spread_parts(range_m: float, by_start: Sequence[Sequence[ThrowResult]]) -> SpreadParts | None:
    """Split the spread of repeated throws by one-way analysis of variance.

    Args:
        range_m: of the target.
        by_start: throws from each start.

    Returns:
        None where fewer than two starts have two throws that landed.
    """
    groups = [[r for r in part if r.outcome is ThrowOutcome.LANDED] for part in by_start]
    groups = [part for part in groups if len(part) >= 2]
    if len(groups) < 2:
        return None
    down = _variance_components([np.array([r.downrange_error_m for r in part]) for part in groups])
    cross = _variance_components(
        [np.array([r.crossrange_error_m for r in part]) for part in groups]
    )
    return SpreadParts(
        range_m=range_m,
        start_count=len(groups),
        throw_count=sum(map(len, groups)),
        between_starts_downrange_m=down[0],
        within_start_downrange_m=down[1],
        between_starts_crossrange_m=cross[0],
        within_start_crossrange_m=cross[1],
    )


def _variance_components(groups: Sequence[Array]) -> tuple[float, float]:
    """Standard deviations between and within groups; their squares are unbiased."""
    sizes = np.array([g.size for g in groups], dtype=np.float64)
    total, count = float(sizes.sum()), len(groups)
    within = sum(float(((g - g.mean()) ** 2).sum()) for g in groups) / (total - count)
    middle = float(np.concatenate(groups).mean())
    means = np.array([g.mean() for g in groups])
    between = float(sizes @ (means - middle) ** 2) / (count - 1)
    # Effective group size of unequal groups (Searle, Linear Models, 1971, ch. 9).
    each = (total - float((sizes**2).sum()) / total) / (count - 1)
    return float(np.sqrt(max((between - within) / each, 0.0))), float(np.sqrt(within))
