"""What makes the widest machine wide: the same throws with one property at a time as the drawing has it.

Every machine is measured and registered anew: what a registration takes away is no spread.
"""

from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict

from diagnosis.evaluation.sensitivity import CONFIDENCE_RATIO, paired_errors
from diagnosis.intervals import Interval
from machine.conventions import Array
from sim_twin.throws.campaign import ThrowResult

Way = Literal["downrange", "crossrange"]
BOOTSTRAP_COUNT = 4000


class Widest(NamedTuple):
    """One machine, one target and one way."""

    unit_seed: int
    range_m: float
    way: Way
    sd_m: float
    """In the throws that made it the widest."""
    nominal_sd_m: float
    """Of the nominal machine in its throws there."""


class PropertyShare(BaseModel):
    """The machine with one property as the drawing's machine has it."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)
    name: str
    sd_m: float
    share_ratio: float | None
    """What this takes off the variance, over what all as drawn take off; None where they take none."""
    share_ci95_ratio: Interval | None
    failed_count: int
    """Throws that landed as built and not so."""


class WideUnit(BaseModel):
    """The widest machine and what makes it so; standard deviations in m, frame `throw`, of paired throws."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)
    unit_seed: int
    range_m: float
    way: Way
    chosen_sd_m: float
    """In the throws that made it the widest: of many machines, that one had bad luck, too."""
    chosen_nominal_sd_m: float
    pair_count: int
    """Throws that landed in all runs."""
    sd_m: float
    """As built, other throws than those that it was chosen by."""
    drawn_sd_m: float
    """Everything as drawn, the same throws."""
    gain_m: float
    gain_ci95_m: Interval
    properties: tuple[PropertyShare, ...]
    """What takes away most first."""
    single_sum_ratio: float | None
    """Sum of the shares: 1 where each property acts by itself, more where several must meet (without any one
    of them the width is gone), less where one of several is enough."""
    single_sum_ci95_ratio: Interval | None


def wide_unit(
    chosen: Widest,
    built: Sequence[ThrowResult],
    drawn: Sequence[ThrowResult],
    single: Mapping[str, Sequence[ThrowResult]],
) -> WideUnit | None:
    """Compare runs of the same throws.

    Args:
        chosen: the machine, its target and the way in which it is wide.
        built: as the machine is.
        drawn: with all properties as drawn.
        single: with one, by its name.

    Returns:
        None where fewer than three throws landed in all runs.
    """
    runs = paired_errors((built, drawn, *single.values()))
    error_m = runs.crossrange_m if chosen.way == "crossrange" else runs.downrange_m
    pairs = error_m.shape[1]
    if pairs < 3:
        return None
    picks = np.random.default_rng(0).integers(pairs, size=(BOOTSTRAP_COUNT, pairs))
    variance_m2 = error_m.var(axis=1, ddof=1)
    resampled_m2 = np.stack([row[picks].var(axis=1, ddof=1) for row in error_m])
    sd_m, resampled_m = np.sqrt(variance_m2), np.sqrt(resampled_m2)
    gain_ci95_m = _interval(resampled_m[0] - resampled_m[1])
    # Over the whole as measured, not as resampled: a quotient of two uncertain numbers has no use.
    added_m2 = variance_m2[0] - variance_m2[1] if gain_ci95_m[0] > 0.0 else None
    share = None if added_m2 is None else (variance_m2[0] - variance_m2[2:]) / added_m2
    shares = None if added_m2 is None else (resampled_m2[0] - resampled_m2[2:]) / added_m2
    rows = [
        PropertyShare(
            name=name,
            sd_m=float(sd_m[2 + k]),
            share_ratio=None if share is None else float(share[k]),
            share_ci95_ratio=None if shares is None else _interval(shares[k]),
            failed_count=int(runs.failed_count[2 + k]),
        )
        for k, name in enumerate(single)
    ]
    return WideUnit(
        unit_seed=chosen.unit_seed,
        range_m=chosen.range_m,
        way=chosen.way,
        chosen_sd_m=chosen.sd_m,
        chosen_nominal_sd_m=chosen.nominal_sd_m,
        pair_count=pairs,
        sd_m=float(sd_m[0]),
        drawn_sd_m=float(sd_m[1]),
        gain_m=float(sd_m[0] - sd_m[1]),
        gain_ci95_m=gain_ci95_m,
        properties=tuple(sorted(rows, key=lambda row: row.sd_m)),
        single_sum_ratio=None if share is None else float(share.sum()),
        single_sum_ci95_ratio=None if shares is None else _interval(shares.sum(axis=0)),
    )


def _interval(values: Array) -> Interval:
    tail = 0.5 * (1.0 - CONFIDENCE_RATIO)
    low, high = np.quantile(values, [tail, 1.0 - tail])
    return float(low), float(high)
