"""Bayesian evidence for sets of effects: a spike-and-slab prior over the library, in information form.

Model of one throw, whitened to unit noise: r = J theta + N eta + e, with parameters theta, nuisances of the
throw eta ~ N(0, 1) (N is scaled) and e ~ N(0, 1). Marginalising eta (Woodbury) leaves the log likelihood of
theta: a precision A, a gradient b and a square c. The throws of a set add up.

Every parameter always has the scatter of healthy machines, N(0, S) with all its correlations (the spike),
because deviations of the twin move many parameters together and must not become a cause. A hypothesis is a
set of effects whose sizes z are added with a wide prior (the slab). Its evidence against "no effect" is in
closed form (`weigh`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import comb
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve, solve_triangular
from scipy.special import log_ndtr, logsumexp

from diagnosis.tuning import (
    MIN_SLAB_OVER_SPIKE_RATIO,
    MOST_SIDE_RATIO,
    PARTNER_LOG_PRIOR,
    SLAB_SCALES_RATIO,
)
from machine.conventions import Array, IntArray

Set = tuple[int, ...]
"""A hypothesis: group indices in increasing order; () is "no effect"."""


class Information(NamedTuple):
    """Log likelihood of the parameters: -(c - 2 b'theta + theta'A theta) / 2 - v."""

    precision: Array
    """A (p, p)"""
    gradient: Array
    """b (p,)"""
    square: float
    """c"""
    log_volume: float
    """v: half the log determinant of the noise, nuisances included; it can differ between hypotheses."""


class Priors(NamedTuple):
    """Priors of p parameters in g groups; a group is one effect at one joint."""

    scatter: Array
    """(p, p) covariance of the deviations of healthy machines."""
    slab_sd: Array
    """(p,)"""
    low: Array
    """(p,)"""
    high: Array
    """(p,)"""
    groups: tuple[IntArray, ...]
    """Parameter indices of each group."""
    log_prior: Array
    """(g,) prior log odds of each group's presence."""


class SetEvidence(NamedTuple):
    """Evidence of a hypothesis against "no effect"."""

    members: Set
    log_odds: float
    """Log evidence minus that of "no effect", prior odds included."""
    mean: Array
    """Posterior mean of the members' sizes beyond the scatter, group after group."""
    covariance: Array


@dataclass(frozen=True)
class Screen:
    """Posterior under "no effect", from which every hypothesis is a small update."""

    data_precision: Array
    """A (p, p)"""
    root: Array
    """R (p, p): the scatter is R R'."""
    lower: Array
    """L (p, p): I + R'A R = L L'."""
    mean: Array
    """m = C b"""
    gradient: Array
    """g = b - A m"""
    log_evidence: float
    """Log evidence of "no effect", up to a constant of the data."""

    @cached_property
    def covariance(self) -> Array:
        """C = (A + S^-1)^-1: posterior covariance of the scatter."""
        return _squared(self.lower, self.root.T)

    @cached_property
    def precision(self) -> Array:
        """P = A - A C A: information about sizes beyond the scatter."""
        return self.data_precision - _squared(self.lower, self.root.T @ self.data_precision)


def inform_gram(gram: Array, parameter_count: int, log_volume: float = 0.0) -> Information:
    """Marginalise a throw's nuisances, from the products of all whitened columns.

    Args:
        gram: (1 + p + q, 1 + p + q) of residual, jacobian and nuisance, side by side; each nuisance times its
            standard deviation.
        parameter_count: p.
        log_volume: half the log determinant of the noise.
    """
    data, noise = slice(0, 1 + parameter_count), slice(1 + parameter_count, None)
    inner = gram[noise, noise] + np.eye(gram.shape[0] - 1 - parameter_count)
    across = gram[noise, data]
    left = gram[data, data] - across.T @ np.linalg.solve(inner, across)
    volume = log_volume + 0.5 * float(np.linalg.slogdet(inner)[1])
    return Information(left[1:, 1:], left[1:, 0], float(left[0, 0]), volume)


def total(informations: Sequence[Information], weights: Array | None = None) -> Information:
    """Sum over throws, each with a weight (throws,)."""
    weight = np.ones(len(informations)) if weights is None else weights
    parts = list(zip(weight, informations, strict=True))
    return Information(
        precision=np.sum([w * i.precision for w, i in parts], axis=0),
        gradient=np.sum([w * i.gradient for w, i in parts], axis=0),
        square=float(sum(w * i.square for w, i in parts)),
        log_volume=float(sum(w * i.log_volume for w, i in parts)),
    )


def log_likelihood(information: Information, theta: Array) -> float:
    """Log likelihood of parameters theta (p,)."""
    fit = theta @ (information.precision @ theta - 2.0 * information.gradient)
    return -0.5 * (information.square + float(fit)) - information.log_volume


def screen(information: Information, priors: Priors) -> Screen:
    """Posterior under "no effect": scatter alone."""
    precision, gradient = information.precision, information.gradient
    root = _lower(priors.scatter)
    lower = _lower(np.eye(root.shape[0]) + root.T @ precision @ root)
    mean = root @ cho_solve((lower, True), root.T @ gradient, check_finite=False)
    fit = information.square - float(gradient @ mean)
    log_volume = 2.0 * float(np.log(np.diag(lower)).sum())
    return Screen(
        precision,
        root,
        lower,
        mean,
        gradient - precision @ mean,
        -0.5 * (fit + log_volume) - information.log_volume,
    )


def _lower(covariance: Array) -> Array:
    return np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)


def _squared(lower: Array, right: Array) -> Array:
    """B' (L L')^-1 B of `lower` L and `right` B."""
    half = solve_triangular(lower, right, lower=True, check_finite=False)
    return half.T @ half


def members_index(priors: Priors, members: Set) -> IntArray:
    """Parameter indices of a hypothesis, group after group."""
    parts = [priors.groups[group] for group in members]
    return np.concatenate(parts) if parts else np.zeros(0, dtype=np.int64)


def weigh(base: Screen, priors: Priors, members: Set) -> SetEvidence:
    """Evidence of a hypothesis.

    With P and g of the screen restricted to the members' parameters and V = slab^2: 2 log odds = g'(P +
    V^-1)^-1 g - log|I + V P|. Bounds enter as the posterior's mass within them over the prior's, parameter
    by parameter.
    """
    index = members_index(priors, members)
    if index.size == 0:
        return SetEvidence((), 0.0, np.zeros(0), np.zeros((0, 0)))
    precision, gradient = base.precision[np.ix_(index, index)], base.gradient[index]
    low, high = priors.low[index], priors.high[index]
    slabs = _slabs(priors, index, precision, gradient)
    found = [_weigh_slab(precision, gradient, slab, low, high) for slab in slabs]
    logs = np.array([entry[0] for entry in found])
    best = found[int(np.argmax(logs))]
    log_odds = float(logsumexp(logs) - np.log(len(found)))
    return SetEvidence(members, log_odds + set_log_prior(priors, members), best[1], best[2])


def set_log_prior(priors: Priors, members: Set) -> float:
    """Prior log odds of a set against "no effect"."""
    alone = float(sum(priors.log_prior[group] for group in members))
    return alone + PARTNER_LOG_PRIOR * comb(len(members), 2)


def _slabs(priors: Priors, index: IntArray, precision: Array, gradient: Array) -> list[Array]:
    """Slab widths on the side of each size."""
    widest = priors.slab_sd[index]
    size = np.linalg.solve(precision + np.diag(widest**-2), gradient)
    bound = np.where(size < 0.0, -priors.low[index], priors.high[index])
    # Where a side has no room at all, the mass within the bounds decides.
    widest = np.where(bound > 0.0, np.minimum(widest, MOST_SIDE_RATIO * bound), widest)
    spike_sd = np.sqrt(np.diag(priors.scatter)[index])
    least = np.minimum(MIN_SLAB_OVER_SPIKE_RATIO * spike_sd, widest)
    return [np.maximum(scale * widest, least) for scale in SLAB_SCALES_RATIO]


def _weigh_slab(
    precision: Array, gradient: Array, slab: Array, low: Array, high: Array
) -> tuple[float, Array, Array]:
    """Log odds of sizes with prior N(0, slab^2) over none, and their posterior."""
    scaled = np.eye(slab.size) + slab[:, None] * precision * slab
    covariance = slab[:, None] * np.linalg.inv(scaled) * slab
    mean = covariance @ gradient
    log_odds = 0.5 * (float(gradient @ mean) - float(np.linalg.slogdet(scaled)[1]))
    sd = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    inside = _log_mass(mean, sd, low, high) - _log_mass(np.zeros_like(slab), slab, low, high)
    return log_odds + float(np.sum(inside)), mean, covariance


def _log_mass(mean: Array, sd: Array, low: Array, high: Array) -> Array:
    """Log of a normal's mass between bounds; the smaller tail decides when both are far."""
    above = np.asarray(log_ndtr((mean - low) / sd))
    below = np.asarray(log_ndtr((high - mean) / sd))
    return np.minimum(above, 0.0) + np.minimum(below, 0.0)
