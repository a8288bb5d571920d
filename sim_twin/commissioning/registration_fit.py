"""From surveyed throws to a registration: smooth over range, height and turn, small where little is known.

Regression with Gaussian processes over the range, one for the ground and one for each term, so that an odd
throw moves little, the ends of the range do not fly off, and heights without throws are taken as the ground.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from machine.conventions import Array
from machine.registration import MAX_CORRECTION_M, Registration, Term, TermKind, features, too_much

KNOT_STEP_M = 0.25
RANGE_PER_HEIGHT_RATIO = 0.4
"""How much farther on the ground a throw would have come down, a metre of height: loads come down at about
68 degrees. 0.3 to 0.5 explain the misses of m545-2d-v5 and m545-3d-v4 alike, 0 worse (decision 5)."""
FIRST_NOISE_M = 0.1
"""Standard deviation of a throw at 9 m before any was seen, as strong as `FIRST_NOISE_COUNT` throws."""
FIRST_NOISE_COUNT = 10.0
NOISE_RANGE_M = 9.0
FAULTY_QUANTILE_RATIO = 0.9
"""A machine of whose throws a tenth miss by more than aiming may correct has a fault; at the last of its
reach a few may."""


class _Smoothness(NamedTuple):
    """Prior of one table: standard deviation of the miss, and over which range it changes."""

    sd_m: float
    length_m: float


class _Way(NamedTuple):
    """Priors of one direction."""

    ground: _Smoothness
    terms: dict[TermKind, _Smoothness]
    noise_per_m: float
    """Growth of the logarithm of the scatter over the range."""


# Most probable values for throws from the safe pose, 260 of each of five maps of misses (m545-2d-v5,
# m545-3d-v3 and v4 on unit 0, m545-2d-v5 and m545-3d-v3 on unit 203), docs/decisions/0005-registration.md.
DOWNRANGE = _Way(
    _Smoothness(0.09, 0.65),
    {
        TermKind.NEAR: _Smoothness(0.08, 0.9),
        TermKind.TURN: _Smoothness(0.02, 0.6),
        TermKind.HEIGHT: _Smoothness(0.055, 0.7),
        TermKind.HEIGHT_SQUARED: _Smoothness(0.06, 0.9),
    },
    0.27,
)
CROSSRANGE = _Way(
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
    """Throws that landed: what they were aimed at, and by how much they missed; all (N,)."""

    range_m: Array
    height_m: Array
    turn_rad: Array
    """From where the cabin stood to the target, positive to the left."""
    downrange_m: Array
    crossrange_m: Array


def register(policy_sha256: str, throws: Surveyed, kinds: Sequence[TermKind] = ()) -> Registration:
    """The mean miss every quarter of a metre, and its terms.

    Args:
        policy_sha256: of the policy that threw.
        throws: misses from the point aimed at.
        kinds: what the miss may hang on besides the range.

    Raises:
        ValueError: no throws, or a mean miss that aiming must not correct.
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
    way: _Way, kinds: Sequence[TermKind], knots: Array, at: Array, weights: list[Array], miss: Array
) -> list[Array]:
    """Most probable tables (K,) of the ground and of each term, given misses (N,) at ranges `at` (N,)."""
    priors = [way.ground, *(way.terms[kind] for kind in kinds)]
    kernel = np.zeros((at.size, at.size))
    for prior, weight in zip(priors, weights, strict=True):
        kernel += np.outer(weight, weight) * _similar(prior, at, at)
    growth = np.exp(way.noise_per_m * (at - NOISE_RANGE_M))
    noise_m = FIRST_NOISE_M
    solved = np.zeros_like(miss)
    # The scatter is that of the residuals, which hang on it in turn: a few rounds settle it.
    for _ in range(4):
        variance = (noise_m * growth) ** 2
        solved = np.linalg.solve(kernel + np.diag(variance), miss)
        left = variance * solved / growth
        total = float(left @ left) + FIRST_NOISE_COUNT * FIRST_NOISE_M**2
        noise_m = float(np.sqrt(total / (at.size + FIRST_NOISE_COUNT)))
    return [
        _similar(prior, knots, at) @ (weight * solved)
        for prior, weight in zip(priors, weights, strict=True)
    ]


def _similar(prior: _Smoothness, a: Array, b: Array) -> Array:
    """Covariance (A, B) of a table's values at ranges (A,) and (B,), m^2."""
    return prior.sd_m**2 * np.exp(-0.5 * ((a[:, None] - b) / prior.length_m) ** 2)
