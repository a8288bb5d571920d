"""Tells whether a machine's misses have changed, throw by throw.

Each direction's miss is replaced by its sequential normal score: the normal quantile of its rank among the
misses before it (Conover, Tercero-Gomez and Cordero-Franco 2017). While nothing changes these scores are
independent and standard normal for any distribution of the misses, and so is the false-alarm rate.
Sums watch the mean both ways and the spread; their thresholds share the stated rate.
"""

import math
from bisect import bisect_left, bisect_right, insort
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from statistics import NormalDist, fmean, stdev
from typing import Final, NamedTuple

from server.drift.cusum import (
    Cusum,
    mean_evidence,
    mean_threshold,
    spread_evidence,
    spread_threshold,
)

FALSE_ALARM_THROWS: Final = 2000.0
"""Throws of a machine in one mode to a false alarm, on average."""
REFERENCE_COUNT: Final = 30
"""Throws before the test begins: fewer ranks are too coarse."""
BIAS_M: Final = 0.05
"""Change of the mean miss that is found soonest."""
SPREAD_RATIO: Final = 1.5
"""Change of the spread that is found soonest."""
ALLOWANCES: Final = (0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5)
"""Half a change of mean in units of the spread; the nearest to half of `BIAS_M` is used."""
MEAN_SUMS_COUNT: Final = 4
SPREAD_SUMS_COUNT: Final = 2
MOVED_SIGMAS: Final = 3.0
"""Mean of the scores since the change point, in its standard errors, that names a move and not a spread."""
_NORMAL: Final = NormalDist()


class Change(StrEnum):
    """What has changed."""

    LONG = "long"
    SHORT = "short"
    LEFT = "left"
    RIGHT = "right"
    SPREAD_ALONG = "spread_along"
    SPREAD_ACROSS = "spread_across"


class ThrowMiss(NamedTuple):
    """Measured minus predicted miss of a throw."""

    along: float
    """In units of the predicted spread, so that range and height of the target do not change it."""
    across: float
    along_m: float
    across_m: float


@dataclass(frozen=True, slots=True)
class Drift:
    """A change that was found and still lasts."""

    change: Change
    change_count: int
    """Throws before the change, by its estimate."""
    alarm_count: int
    """Throws up to the alarm."""


class Reference:
    """Misses of before in one direction, in order of size."""

    def __init__(self) -> None:
        self._sorted: list[float] = []

    def score(self, value: float) -> float:
        """Standard normal score of a value by its rank among those of before and itself."""
        below, upto = bisect_left(self._sorted, value), bisect_right(self._sorted, value)
        # Equal values share the middle of their ranks.
        rank = 0.5 * (below + upto) + 0.5
        return _NORMAL.inv_cdf(rank / (len(self._sorted) + 1))

    def add(self, value: float) -> None:
        """Take a value in."""
        insort(self._sorted, value)

    def remove(self, values: Iterable[float]) -> None:
        """Take values out again that were of after a change."""
        for value in values:
            del self._sorted[bisect_left(self._sorted, value)]


class _Axis:
    """Reference and sums of one direction."""

    def __init__(self, more: Change, less: Change, spread: Change, allowance: float) -> None:
        mean = mean_threshold(allowance, 2.0 * MEAN_SUMS_COUNT * FALSE_ALARM_THROWS)
        wide = spread_threshold(SPREAD_RATIO, 2.0 * SPREAD_SUMS_COUNT * FALSE_ALARM_THROWS)
        self._allowance = allowance
        self._more, self._less, self._spread = more, less, spread
        self.sums = {more: Cusum(mean), less: Cusum(mean), spread: Cusum(wide)}

    def add(self, score: float, count: int) -> list[Change]:
        """Changes whose sums have reached their thresholds with this score."""
        evidence = {
            self._more: mean_evidence(score, self._allowance),
            self._less: mean_evidence(-score, self._allowance),
            self._spread: spread_evidence(score, SPREAD_RATIO),
        }
        return [change for change, sum_ in self.sums.items() if sum_.add(evidence[change], count)]


class DriftTest:
    """The test of one machine, mode and version; `add` takes its throws in their order."""

    def __init__(self) -> None:
        self.drift: Drift | None = None
        self._count = 0
        self._along, self._across = Reference(), Reference()
        self._first: list[ThrowMiss] = []
        self._since_zero: list[tuple[ThrowMiss, float, float]] = []
        """Throws since the earliest change point that may still be claimed, with their scores."""
        self._alarm: Cusum | None = None
        self._axes: tuple[_Axis, _Axis] | None = None

    def add(self, miss: ThrowMiss) -> Drift | None:
        """Take a throw in; the change that was found, if it still lasts.

        After an alarm the reference stays as it was before the change, and the alarm ends when its sum has
        fallen back to zero: the machine throws again as it did.
        """
        self._count += 1
        if self._axes is None:
            self._first.append(miss)
            self._take(miss)
            if self._count == REFERENCE_COUNT:
                self._begin()
            return None
        scores = (self._along.score(miss.along), self._across.score(miss.across))
        found = [
            change
            for axis, score in zip(self._axes, scores, strict=True)
            for change in axis.add(score, self._count)
        ]
        if self.drift is not None:
            if self._alarm is None or self._alarm.value == 0.0:
                self.drift = self._alarm = None
            return self.drift
        self._take(miss)
        self._since_zero.append((miss, *scores))
        if found:
            self._raise(found[0])
        else:
            self._forget_before_zeros()
        return self.drift

    def _begin(self) -> None:
        self._axes = (
            _Axis(
                Change.LONG,
                Change.SHORT,
                Change.SPREAD_ALONG,
                allowance([miss.along_m for miss in self._first]),
            ),
            _Axis(
                Change.LEFT,
                Change.RIGHT,
                Change.SPREAD_ACROSS,
                allowance([miss.across_m for miss in self._first]),
            ),
        )
        for sum_ in self._sums():
            sum_.zero_count = self._count

    def _take(self, miss: ThrowMiss) -> None:
        self._along.add(miss.along)
        self._across.add(miss.across)

    def _sums(self) -> list[Cusum]:
        assert self._axes is not None
        return [sum_ for axis in self._axes for sum_ in axis.sums.values()]

    def _sum(self, change: Change) -> Cusum:
        assert self._axes is not None
        return next(axis.sums[change] for axis in self._axes if change in axis.sums)

    def _raise(self, change: Change) -> None:
        alarm = self._sum(change)
        after = self._since_zero[len(self._since_zero) - (self._count - alarm.zero_count) :]
        self._along.remove(miss.along for miss, _, _ in after)
        self._across.remove(miss.across for miss, _, _ in after)
        self._since_zero.clear()
        if change is Change.SPREAD_ALONG:
            change = _moved([score for _, score, _ in after], Change.LONG, Change.SHORT) or change
        elif change is Change.SPREAD_ACROSS:
            change = _moved([score for _, _, score in after], Change.LEFT, Change.RIGHT) or change
        self._alarm = alarm
        self.drift = Drift(change, alarm.zero_count, self._count)

    def _forget_before_zeros(self) -> None:
        """Throws before the earliest change point that may still be claimed need not be kept apart."""
        kept = self._count - min(sum_.zero_count for sum_ in self._sums())
        if len(self._since_zero) > kept:
            del self._since_zero[: len(self._since_zero) - kept]


def _moved(scores: Sequence[float], more: Change, less: Change) -> Change | None:
    """The way in which the mean has moved, where a wider spread is only what a large move looks like."""
    mean = fmean(scores)
    if abs(mean) * math.sqrt(len(scores)) < MOVED_SIGMAS:
        return None
    return more if mean > 0.0 else less


def allowance(misses_m: Sequence[float]) -> float:
    """Half of `BIAS_M` in units of the spread of these misses (m), as the nearest of `ALLOWANCES`."""
    spread_m = stdev(misses_m)
    wanted = min(0.5 * BIAS_M / max(spread_m, 1e-9), ALLOWANCES[-1])
    return min(ALLOWANCES, key=lambda one: abs(one - wanted))
