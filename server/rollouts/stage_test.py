"""Tells by a machine's first throws with a version whether it throws worse than before, or than the gates.

A group-sequential test: at half, three quarters and all of the throws it spends a part of the false alarms
(Lan and DeMets 1983, by Bonferroni). Exact tests of normal misses share it: F tests of the spread in both
directions against that of before, joined by Lancaster's method (1961); t tests of the mean; a chi-squared
test of the spread against its gate; a binomial test of throws that fail. Misses across are regressed on those
along: that makes the two F tests independent.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import Final, Literal, NamedTuple

import numpy as np
from scipy.special import bdtrc, chdtrc, chdtri, fdtrc, stdtr

from evaluation.validation.gates import Gates
from machine.conventions import Array

FALSE_ALARM_RATIO: Final = 0.01
"""Share of rollouts of a version that is no worse that their throws stop, at most; its machines share it."""
THROWS_COUNT: Final = 12
"""Throws of a machine until it has passed, where a person names no other number."""
REFERENCE_COUNT: Final = 10
"""Throws with the version before that a comparison needs at least: of fewer the spread is known to no better
than a quarter."""
LOOKS: Final = ((0.5, 0.03), (0.75, 0.07), (1.0, 0.9))
"""Share of the throws, and of the false alarms that are spent by then: few early, for power at the end."""


class Regression(StrEnum):
    """How a version is worse."""

    SPREAD = "spread"
    MEAN_ALONG = "mean_along"
    MEAN_ACROSS = "mean_across"
    GATE_SPREAD_ALONG = "gate_spread_along"
    GATE_SPREAD_ACROSS = "gate_spread_across"
    GATE_MEAN_ALONG = "gate_mean_along"
    GATE_MEAN_ACROSS = "gate_mean_across"
    FAILED = "failed"


SHARES: Final[Mapping[Regression, float]] = MappingProxyType(
    {
        Regression.SPREAD: 0.93,
        **{kind: 0.01 for kind in Regression if kind is not Regression.SPREAD},
    }
)
"""Shares of the false alarms: of what a dozen throws are to show, a doubled spread is the hardest to find."""


class StageThrow(NamedTuple):
    """Measured miss of a throw, m."""

    along_m: float
    across_m: float
    scale_along: float = 1.0
    """Expected spread at its target over that at the others, by the version before."""
    scale_across: float = 1.0


@dataclass(frozen=True, slots=True)
class StageFinding:
    """What a machine's throws since the switch say."""

    verdict: Literal["testing", "passed", "worse"]
    regression: Regression | None
    """How it is worse."""
    throw_count: int
    """Throws up to the last look or the alarm."""
    p_ratio: float | None
    """Probability of such throws, or worse ones, with a version that is no worse; None without an alarm."""


def looks(throws_count: int) -> tuple[tuple[int, float], ...]:
    """Numbers of throws at which the test looks, and the share of the false alarms that each spends."""
    return tuple((math.ceil(share * throws_count), spent) for share, spent in LOOKS)


def stage_test(
    reference: Sequence[StageThrow],
    throws: Sequence[StageThrow | None],
    gates: Gates,
    *,
    machine_count: int,
    throws_count: int = THROWS_COUNT,
) -> StageFinding:
    """Test a machine's throws since the switch, in their order.

    Args:
        reference: throws with the version before; fewer than `REFERENCE_COUNT` are not compared with.
        throws: with the version; None for one that failed.
        gates: in force for the mode.
        machine_count: machines of the rollout, which share the false alarms.
        throws_count: until the machine has passed.
    """
    seen = 0
    for count, spent in looks(throws_count):
        if len(throws) < count:
            break
        seen = count
        level = FALSE_ALARM_RATIO / machine_count * spent
        found = dict(_p_values(reference, throws[:count], gates))
        worst = min(found, key=lambda kind: found[kind] / SHARES[kind])
        if found[worst] < level * SHARES[worst]:
            return StageFinding("worse", worst, count, found[worst])
    is_passed = len(throws) >= throws_count
    return StageFinding("passed" if is_passed else "testing", None, seen, None)


def _p_values(
    reference: Sequence[StageThrow], throws: Sequence[StageThrow | None], gates: Gates
) -> Iterator[tuple[Regression, float]]:
    landed = [throw for throw in throws if throw is not None]
    failed_count = len(throws) - len(landed)
    yield (
        Regression.FAILED,
        _failing(failed_count, len(throws), 1.0 - gates.landed_ratio),
    )
    if len(landed) < 3:
        return
    new_m = np.array([throw[:2] for throw in landed])
    for column, spread, mean in (
        (0, Regression.GATE_SPREAD_ALONG, Regression.GATE_MEAN_ALONG),
        (1, Regression.GATE_SPREAD_ACROSS, Regression.GATE_MEAN_ACROSS),
    ):
        misses_m = new_m[:, column]
        squares = float(misses_m.var()) * len(misses_m) / gates.sd_m**2
        yield spread, float(chdtrc(len(misses_m) - 1, squares))
        yield mean, _beyond(misses_m, gates.mean_m)
    if len(reference) >= REFERENCE_COUNT:
        before, new = _scaled(reference), _scaled(landed)
        yield Regression.SPREAD, _wider(before, new)
        for column, kind in ((0, Regression.MEAN_ALONG), (1, Regression.MEAN_ACROSS)):
            yield kind, _moved(before[:, column], new[:, column])


def _failing(failed_count: int, count: int, allowed_ratio: float) -> float:
    """P value of so many failures or more."""
    return float(bdtrc(failed_count - 1, count, allowed_ratio)) if failed_count else 1.0


def _scaled(throws: Sequence[StageThrow]) -> Array:
    """Misses along and across over their expected spread, (N, 2)."""
    return np.array([(t.along_m / t.scale_along, t.across_m / t.scale_across) for t in throws])


def _wider(before: Array, new: Array) -> float:
    """P value of a spread along and across that is no wider than before."""
    p_along = float(
        fdtrc(len(new) - 1, len(before) - 1, new[:, 0].var(ddof=1) / before[:, 0].var(ddof=1))
    )
    # Each with a mean of its own and one slope: what that leaves beyond the residual of before alone.
    alone, alone_freedom = _residual([before])
    both, both_freedom = _residual([before, new])
    freedom = both_freedom - alone_freedom
    ratio = (both - alone) / freedom / (alone / alone_freedom)
    p_across = float(fdtrc(freedom, alone_freedom, ratio))
    # Lancaster's method: as chi-squared variables of the throws' degrees of freedom the two add up.
    joined = sum(float(chdtri(freedom, max(p, 1e-280))) for p in (p_along, p_across))
    return float(chdtrc(2 * freedom, joined))


def _residual(parts: Sequence[Array]) -> tuple[float, int]:
    """Sum of squares across about one slope on along and a mean of each part, and its degrees of freedom."""
    centred = np.concatenate([part - part.mean(axis=0) for part in parts])
    along, across = centred.T
    squares = float(across @ across - (along @ across) ** 2 / (along @ along))
    return squares, len(centred) - len(parts) - 1


def _moved(before: Array, new: Array) -> float:
    """P value of a mean that is no further from the target than before."""
    if abs(new.mean()) <= abs(before.mean()):
        return 1.0
    freedom = len(before) + len(new) - 2
    variance = float(before.var() * len(before) + new.var() * len(new)) / freedom
    error = math.sqrt(max(variance, 1e-12) * (1.0 / len(before) + 1.0 / len(new)))
    return float(2.0 * stdtr(freedom, -abs(float(new.mean() - before.mean())) / error))


def _beyond(misses_m: Array, gate_m: float) -> float:
    """P value of a mean within its gate, either way."""
    error_m = max(float(misses_m.std(ddof=1)), 1e-6) / math.sqrt(len(misses_m))
    beyond_m = abs(float(misses_m.mean())) - gate_m
    return min(1.0, float(2.0 * stdtr(len(misses_m) - 1, -beyond_m / error_m)))
