"""Mean of measured minus predicted misses over the range, with shrinkage and intervals; and what it is worth.

Gaussian process over the range with a constant part. Its two prior standard deviations maximise the
marginal likelihood (empirical Bayes); where throws show no bias they are zero, and so is the map. The range
of a raised target is read as in a registration (machine.registration).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from machine.conventions import Array, IntArray
from machine.registration import MAX_CORRECTION_M, Registration
from sim_twin.commissioning.registration_fit import KNOT_STEP_M, RANGE_PER_HEIGHT_RATIO

LENGTH_M: Final = 1.0
"""Length scale of the map over the range: registrations have 0.65 m along and 0.95 m across
(sim_twin/commissioning/registration_fit.py)."""
PRIOR_SD_M: Final = (0.0, 0.02, 0.04, 0.08, 0.16, 0.32)
"""Prior standard deviations that are compared, of the constant part and of the part that varies."""
NOISE_PRIOR_COUNT: Final = 10.0
"""Weight of the predicted spread beside the measured one, in throws."""
CLIP_SIGMAS: Final = 3.0
"""A miss counts at most so far from the median, in robust standard deviations."""
FOLD_COUNT: Final = 5
INTERVAL_SIGMAS: Final = 1.645
"""Of 90 % intervals."""


class Misses(NamedTuple):
    """Landed throws, oldest first; all (N,), m, frame `throw`."""

    range_m: Array
    height_m: Array
    along_m: Array
    """Measured minus predicted, as it would have been without an aim correction."""
    across_m: Array
    sd_along_m: Array
    """Predicted."""
    sd_across_m: Array
    predicted_along_m: Array
    predicted_across_m: Array

    def take(self, rows: IntArray) -> "Misses":
        """Some of the throws."""
        return Misses(*(column[rows] for column in self))

    @property
    def at_m(self) -> Array:
        """Range at which the map is read."""
        return self.range_m + RANGE_PER_HEIGHT_RATIO * self.height_m


class BiasMap(NamedTuple):
    """Mean miss and its standard deviation at ranges; all (K,), m."""

    range_m: Array
    along_m: Array
    along_sd_m: Array
    across_m: Array
    across_sd_m: Array

    def registration(self, policy_sha256: str, throw_count: int) -> Registration:
        """The map as a table of the mean miss.

        Raises:
            ValueError: the mean miss is more than aiming may correct.
        """
        return Registration(
            policy_sha256=policy_sha256,
            throw_count=throw_count,
            range_m=tuple(self.range_m.tolist()),
            downrange_m=tuple(self.along_m.tolist()),
            crossrange_m=tuple(self.across_m.tolist()),
            range_per_height_ratio=RANGE_PER_HEIGHT_RATIO,
        )


@dataclass(frozen=True, slots=True)
class Gain:
    """Mean distance from the target on throws that the map was not made from, m."""

    before_m: float
    after_m: float
    gain_m: float
    low_m: float
    """Lower end of the 90 % interval of the gain."""
    high_m: float


def bias_map(misses: Misses) -> BiasMap:
    """The map of these throws, at least two."""
    at = misses.at_m
    knots = KNOT_STEP_M * np.arange(
        np.floor(at.min() / KNOT_STEP_M), np.ceil(at.max() / KNOT_STEP_M) + 1.0
    )
    along, along_sd = _posterior(knots, at, misses.along_m, misses.sd_along_m)
    across, across_sd = _posterior(knots, at, misses.across_m, misses.sd_across_m)
    return BiasMap(knots, along, along_sd, across, across_sd)


def correction_at(table: Registration | None, misses: Misses) -> tuple[Array, Array]:
    """Miss (N,) along and across that a table expects of throws; zero without one."""
    if table is None:
        return np.zeros_like(misses.range_m), np.zeros_like(misses.range_m)
    return table.miss(misses.range_m, misses.height_m, np.zeros_like(misses.range_m))


def expected_gain(misses: Misses, present: Registration | None) -> Gain:
    """What maps made from four fifths of the throws gain on the others, against the correction in force.

    Raises:
        ValueError: the mean miss is more than aiming may correct.
    """
    before, after = np.zeros_like(misses.range_m), np.zeros_like(misses.range_m)
    for kept, held_out in _folds(misses.range_m.size):
        test = misses.take(held_out)
        table = bias_map(misses.take(kept)).registration("", kept.size)
        before[held_out] = _distance(test, *correction_at(present, test))
        after[held_out] = _distance(test, *correction_at(table, test))
    gain = before - after
    mean, error = float(gain.mean()), float(gain.std(ddof=1)) / np.sqrt(gain.size)
    half = INTERVAL_SIGMAS * error
    return Gain(float(before.mean()), float(after.mean()), mean, mean - half, mean + half)


def _folds(count: int) -> Iterator[tuple[IntArray, IntArray]]:
    order = np.arange(count)
    for fold in range(FOLD_COUNT):
        yield order[order % FOLD_COUNT != fold], order[order % FOLD_COUNT == fold]


def _distance(misses: Misses, along_m: Array, across_m: Array) -> Array:
    """Distance (N,) of the impacts from the target with a correction, m."""
    return np.hypot(
        misses.predicted_along_m + misses.along_m - along_m,
        misses.predicted_across_m + misses.across_m - across_m,
    )


def _posterior(knots: Array, at: Array, miss_m: Array, sd_m: Array) -> tuple[Array, Array]:
    """Posterior mean and standard deviation (K,) of one direction at the knots."""
    where, inverse = np.unique(np.round(at / KNOT_STEP_M), return_inverse=True)
    centre_m = where * KNOT_STEP_M
    weight = 1.0 / sd_m**2
    clipped = _clipped(miss_m, sd_m)
    total = np.bincount(inverse, weight)
    mean = np.bincount(inverse, weight * clipped) / total
    rest = float(weight @ (clipped - mean[inverse]) ** 2)
    noise = (rest + NOISE_PRIOR_COUNT) / (at.size - where.size + NOISE_PRIOR_COUNT)
    variance = noise / total
    shape = _similar(centre_m, centre_m)
    best, found = -np.inf, (0.0, 0.0)
    for constant in PRIOR_SD_M:
        for varying in PRIOR_SD_M:
            covariance = constant**2 + varying**2 * shape + np.diag(variance)
            _, log_determinant = np.linalg.slogdet(covariance)
            evidence = -0.5 * (mean @ np.linalg.solve(covariance, mean) + log_determinant)
            if evidence > best:
                best, found = evidence, (constant, varying)
    constant, varying = found
    covariance = constant**2 + varying**2 * shape + np.diag(variance)
    cross = constant**2 + varying**2 * _similar(knots, centre_m)
    gain = np.linalg.solve(covariance, cross.T).T
    left = constant**2 + varying**2 - np.einsum("ij,ij->i", gain, cross)
    return gain @ mean, np.sqrt(np.maximum(left, 0.0))


def _clipped(miss_m: Array, sd_m: Array) -> Array:
    """Misses with what lies far from the median brought nearer: a stray load is no bias."""
    scaled = miss_m / sd_m
    middle = float(np.median(scaled))
    robust = 1.4826 * float(np.median(np.abs(scaled - middle)))
    far = CLIP_SIGMAS * max(robust, 1e-9)
    return np.clip(scaled, middle - far, middle + far) * sd_m


def _similar(a: Array, b: Array) -> Array:
    return np.exp(-0.5 * ((a[:, None] - b) / LENGTH_M) ** 2)


def is_correctable(table: BiasMap) -> bool:
    """Whether aiming may correct all of it: a larger mean miss is a fault of the machine."""
    return float(max(np.abs(table.along_m).max(), np.abs(table.across_m).max())) <= MAX_CORRECTION_M
