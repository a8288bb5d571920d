"""Registration from surveyed throws: mean miss over range, height and turn.

Gaussian process regression over the range: one process for ground level and one for each further term. The
prior mean is zero, so that the correction is small where there are few throws.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from machine.conventions import Array
from machine.registration import MAX_CORRECTION_M, Registration, Term, TermKind, features, too_much

KNOT_STEP_M = 0.25
"""Spacing of the tables."""
RANGE_PER_HEIGHT_RATIO = 0.4
"""Additional range at ground level per metre of height: loads descend at about 68 degrees. The likelihood is
flat between 0.3 and 0.5 (docs/decisions/0005-registration.md)."""
FIRST_NOISE_M = 0.1
"""Prior standard deviation of a throw at `NOISE_RANGE_M`."""
FIRST_NOISE_COUNT = 10.0
"""Weight of that prior, in throws."""
NOISE_RANGE_M = 9.0
"""Range at which the noise is stated."""
FAULTY_QUANTILE_RATIO = 0.9
"""Share of the throws whose mean miss must be correctable: beyond it the machine has a fault. The others
allow for the end of the reach."""


class _Smoothness(NamedTuple):
    """Prior of one table: standard deviation and length scale over the range, m."""

    sd_m: float
    length_m: float


class _DirectionPrior(NamedTuple):
    """Priors of one direction of the miss."""

    ground: _Smoothness
    terms: dict[TermKind, _Smoothness]
    noise_per_m: float
    """Growth of the logarithm of the noise over the range, 1/m."""


# Maximum likelihood over throws from the safe pose with five pairs of policy and machine, 260 throws each
# (docs/decisions/0005-registration.md).
DOWNRANGE = _DirectionPrior(
    _Smoothness(0.09, 0.65),
    {
        TermKind.NEAR: _Smoothness(0.08, 0.9),
        TermKind.TURN: _Smoothness(0.02, 0.6),
        TermKind.HEIGHT: _Smoothness(0.055, 0.7),
        TermKind.HEIGHT_SQUARED: _Smoothness(0.06, 0.9),
    },
    0.27,
)
CROSSRANGE = _DirectionPrior(
    _Smoothness(0.02, 0.95),
    {
        TermKind.NEAR: _Smoothness(0.067, 0.6),
        TermKind.TURN: _Smoothness(0.066, 1.3),
        TermKind.HEIGHT: _Smoothness(0.02, 0.9),
        TermKind.HEIGHT_SQUARED: _Smoothness(0.02, 1.0),
    },
    0.135,
)


class Surveyed(NamedTuple):
    """Landed throws: aim point and miss; all (N,)."""

    range_m: Array
    height_m: Array
    turn_rad: Array
    """Slew from the start of the throw to the target, positive to the left."""
    downrange_m: Array
    crossrange_m: Array


def register(policy_sha256: str, throws: Surveyed, kinds: Sequence[TermKind] = ()) -> Registration:
    """Tables of the mean miss and of its terms.

    Args:
        policy_sha256: of the policy that threw.
        throws: misses relative to the aim point.
        kinds: terms besides the range.

    Raises:
        ValueError: no throws, or a mean miss beyond the largest correction.
    """
    if throws.range_m.size == 0:
        raise ValueError("a registration needs at least one throw that landed")
    at = throws.range_m + RANGE_PER_HEIGHT_RATIO * throws.height_m
    knots = KNOT_STEP_M * np.arange(
        np.floor(at.min() / KNOT_STEP_M), np.ceil(at.max() / KNOT_STEP_M) + 1.0
    )
    weights = [np.ones_like(at), *features(kinds, throws.height_m, throws.turn_rad)]
    sides = (
        _tables(DOWNRANGE, kinds, knots, at, weights, throws.downrange_m),
        _tables(CROSSRANGE, kinds, knots, at, weights, throws.crossrange_m),
    )
    for tables in sides:
        fitted = sum(w * np.interp(at, knots, t) for w, t in zip(weights, tables, strict=True))
        worst = float(np.quantile(np.abs(fitted), FAULTY_QUANTILE_RATIO))
        if worst > MAX_CORRECTION_M:
            raise ValueError(too_much(worst))
    down, cross = ([_limited(table) for table in tables] for tables in sides)
    return Registration(
        policy_sha256=policy_sha256,
        throw_count=int(at.size),
        range_m=tuple(knots.tolist()),
        downrange_m=down[0],
        crossrange_m=cross[0],
        range_per_height_ratio=RANGE_PER_HEIGHT_RATIO,
        terms=tuple(
            Term(kind=kind, downrange_m=d, crossrange_m=c)
            for kind, d, c in zip(kinds, down[1:], cross[1:], strict=True)
        ),
    )


def _limited(table: Array) -> tuple[float, ...]:
    return tuple(np.clip(table, -MAX_CORRECTION_M, MAX_CORRECTION_M).tolist())


def _tables(
    prior: _DirectionPrior,
    kinds: Sequence[TermKind],
    knots: Array,
    at: Array,
    weights: list[Array],
    miss: Array,
) -> list[Array]:
    """Posterior mean tables (K,) of ground level and of each term, given misses (N,) at ranges `at` (N,)."""
    priors = [prior.ground, *(prior.terms[kind] for kind in kinds)]
    kernel = np.zeros((at.size, at.size))
    for smoothness, weight in zip(priors, weights, strict=True):
        kernel += np.outer(weight, weight) * _similar(smoothness, at, at)
    growth = np.exp(prior.noise_per_m * (at - NOISE_RANGE_M))
    noise_m = FIRST_NOISE_M
    solved = np.zeros_like(miss)
    # The noise is that of the residuals, which depend on it: iterate.
    for _ in range(4):
        variance = (noise_m * growth) ** 2
        solved = np.linalg.solve(kernel + np.diag(variance), miss)
        left = variance * solved / growth
        total = float(left @ left) + FIRST_NOISE_COUNT * FIRST_NOISE_M**2
        noise_m = float(np.sqrt(total / (at.size + FIRST_NOISE_COUNT)))
    return [
        _similar(smoothness, knots, at) @ (weight * solved)
        for smoothness, weight in zip(priors, weights, strict=True)
    ]


def _similar(smoothness: _Smoothness, a: Array, b: Array) -> Array:
    """Covariance (A, B) of a table's values at ranges (A,) and (B,), m^2."""
    return smoothness.sd_m**2 * np.exp(-0.5 * ((a[:, None] - b) / smoothness.length_m) ** 2)
