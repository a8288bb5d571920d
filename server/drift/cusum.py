"""Cumulative sums (Page 1954) on standard normal scores, with thresholds for a stated false-alarm rate.

The mean time to a false alarm follows from a Markov chain over the sum's range (Brook and Evans 1972), so no
threshold is tuned.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from statistics import NormalDist
from typing import Final

import numpy as np

from machine.conventions import Array

STATES_COUNT: Final = 120
"""Cells of the Markov chain; 60 give the same thresholds to 1 %."""
_NORMAL: Final = NormalDist()

Distribution = Callable[[float], float]


@dataclass(slots=True)
class Cusum:
    """One sum: it grows with evidence of a change and never falls below zero or rises above its threshold."""

    threshold: float
    value: float = 0.0
    zero_count: int = 0
    """Position of the score after which the sum was last zero: the estimate of the change point."""

    def add(self, evidence: float, count: int) -> bool:
        """Take in the evidence of the score at position `count`; whether the threshold is reached."""
        value = self.value + evidence
        if value <= 0.0:
            self.value, self.zero_count = 0.0, count
            return False
        self.value = min(value, self.threshold)
        return value >= self.threshold


def mean_evidence(score: float, allowance: float) -> float:
    """Evidence that the mean of scores has risen by twice the allowance."""
    return score - allowance


def spread_evidence(score: float, ratio: float) -> float:
    """Log likelihood ratio of scores whose spread is `ratio` against 1."""
    return 0.5 * score * score * (1.0 - 1.0 / ratio**2) - math.log(ratio)


@cache
def mean_threshold(allowance: float, run_length_count: float) -> float:
    """Threshold at which a sum of `mean_evidence` gives a false alarm in so many scores on average."""
    return _threshold(lambda x: _NORMAL.cdf(x + allowance), run_length_count)


@cache
def spread_threshold(ratio: float, run_length_count: float) -> float:
    """Threshold at which a sum of `spread_evidence` gives a false alarm in so many scores on average."""
    gain = 0.5 * (1.0 - 1.0 / ratio**2)

    def distribution(x: float) -> float:
        square = (x + math.log(ratio)) / gain
        return 2.0 * _NORMAL.cdf(math.sqrt(square)) - 1.0 if square > 0.0 else 0.0

    return _threshold(distribution, run_length_count)


def mean_run_length(distribution: Distribution, threshold: float) -> float:
    """Scores to the first alarm on average, for a sum that begins at zero.

    Args:
        distribution: cumulative distribution of the evidence of one score.
        threshold: of the sum.
    """
    width = threshold / (STATES_COUNT - 0.5)
    # State 0 is the sum at zero, with half a cell; the others are the middles of cells.
    bound = [distribution((step + 0.5) * width) for step in range(-STATES_COUNT, STATES_COUNT)]
    stay: Array = np.empty((STATES_COUNT, STATES_COUNT))
    for start in range(STATES_COUNT):
        upper = np.array(bound[STATES_COUNT - start : 2 * STATES_COUNT - start])
        stay[start, 0] = upper[0]
        stay[start, 1:] = np.diff(upper)
    lengths = np.linalg.solve(np.eye(STATES_COUNT) - stay, np.ones(STATES_COUNT))
    return float(lengths[0])


def _threshold(distribution: Distribution, run_length_count: float) -> float:
    low, high = 0.1, 60.0
    while high - low > 1e-3:
        middle = 0.5 * (low + high)
        if mean_run_length(distribution, middle) < run_length_count:
            low = middle
        else:
            high = middle
    return high
