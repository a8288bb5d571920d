"""How far a set of throws moves the healthy parameters of each part of the chain, against their prior.

What an effect does can be left over, or be absorbed by deviations that no healthy machine has. Only both
together say how much of a misfit there is to explain (prior-data conflict: Evans and Moshonov 2006, Bayesian
Analysis 1, 893).
"""

from functools import cache
from typing import NamedTuple

import numpy as np

from diagnosis.healthy.noise import part_of
from diagnosis.linearisation.parameters import SET_NUISANCES, library, set_names
from machine.conventions import Array, IntArray


class PriorShift(NamedTuple):
    """Posterior mean of a part's healthy parameters, squared in the metric of their prior."""

    square: float
    expected: float
    """Of a healthy machine."""

    @property
    def excess(self) -> float:
        """Square above its expectation."""
        return max(self.square - self.expected, 0.0)

    @property
    def excess_sd(self) -> float:
        """Standard deviations above the expectation; negative below."""
        return (self.square - self.expected) / float(np.sqrt(2.0 * max(self.expected, 0.5)))


def prior_shift(scatter: Array, covariance: Array, mean: Array) -> dict[str, PriorShift]:
    """The shift of every part of the chain.

    Args:
        scatter: (p, p) prior covariance of the healthy parameters.
        covariance: (p, p) of their posterior.
        mean: (p,) of their posterior.
    """
    learned = scatter - covariance
    found: dict[str, PriorShift] = {}
    for part, index in _parameters_by_part().items():
        inverse = np.linalg.inv(scatter[np.ix_(index, index)])
        expected = float(np.trace(inverse @ learned[np.ix_(index, index)]))
        found[part] = PriorShift(float(mean[index] @ inverse @ mean[index]), expected)
    return found


@cache
def _parameters_by_part() -> dict[str, IntArray]:
    """Indices of the healthy parameters of each part of the chain: a driven joint, or a stage."""
    keys = [p.key for p in library()]
    parts: dict[str, list[int]] = {}
    for place, name in enumerate((*keys, *keys, *set_names())):
        if name not in SET_NUISANCES:
            parts.setdefault(part_of(name), []).append(place)
    return {part: np.array(places) for part, places in parts.items()}
