"""What throws say about the parameters along the slopes of no effect, and the posterior of a healthy machine.

Model of one throw, whitened to unit noise: r = J theta + N eta + e, with parameters theta, nuisances of the
throw eta ~ N(0, 1) (N is scaled) and e ~ N(0, 1). Marginalising eta (Woodbury) leaves the log likelihood of
theta: a precision A and a gradient b. The throws of a set add up.

Every parameter always has the scatter of healthy machines, N(0, S) with all its correlations, because
deviations of the twin move many parameters together and must not become a cause.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve, solve_triangular

from machine.conventions import Array, IntArray

NORMAL_90 = 1.6449
"""Standard deviations to either side that hold 90 % of a normal distribution."""

Set = tuple[int, ...]
"""A hypothesis: group indices in increasing order; () is "no effect"."""


class Information(NamedTuple):
    """Log likelihood of the parameters, up to a constant: b'theta - theta'A theta / 2."""

    precision: Array
    """A (p, p)"""
    gradient: Array
    """b (p,)"""


class Priors(NamedTuple):
    """Priors of p parameters in g groups; a group is one effect at one joint."""

    scatter: Array
    """S (p, p) covariance of the deviations of healthy machines."""
    slab_sd: Array
    """(p,) widths of the sizes of effects."""
    low: Array
    """(p,)"""
    high: Array
    """(p,)"""
    groups: tuple[IntArray, ...]
    """Parameter indices of each group."""
    log_prior: Array
    """(g,) prior log odds of each group's presence."""


class HealthyPosterior(NamedTuple):
    """Posterior of the parameters under "no effect"."""

    mean: Array
    """(p,)"""
    covariance: Array
    """(p, p)"""


def inform_gram(gram: Array, parameter_count: int) -> Information:
    """Marginalise a throw's nuisances, from the products of all whitened columns.

    Args:
        gram: (1 + p + q, 1 + p + q) of residual, jacobian and nuisance, side by side; each nuisance times its
            standard deviation.
        parameter_count: p.
    """
    data, noise = slice(0, 1 + parameter_count), slice(1 + parameter_count, None)
    inner = gram[noise, noise] + np.eye(gram.shape[0] - 1 - parameter_count)
    across = gram[noise, data]
    left = gram[data, data] - across.T @ np.linalg.solve(inner, across)
    return Information(left[1:, 1:], left[1:, 0])


def total(informations: Sequence[Information]) -> Information:
    """Sum over throws."""
    return Information(
        np.sum([one.precision for one in informations], axis=0),
        np.sum([one.gradient for one in informations], axis=0),
    )


def healthy_posterior(information: Information, priors: Priors) -> HealthyPosterior:
    """Posterior of a healthy machine's deviations: mean C b, covariance C = (A + S^-1)^-1."""
    root = np.linalg.cholesky(priors.scatter)
    inner = np.eye(root.shape[0]) + root.T @ information.precision @ root
    lower = np.linalg.cholesky(inner)
    mean = root @ cho_solve((lower, True), root.T @ information.gradient, check_finite=False)
    half = solve_triangular(lower, root.T, lower=True, check_finite=False)
    return HealthyPosterior(mean, half.T @ half)


def members_index(priors: Priors, members: Set) -> IntArray:
    """Parameter indices of a hypothesis, group after group."""
    parts = [priors.groups[group] for group in members]
    return np.concatenate(parts) if parts else np.zeros(0, dtype=np.int64)
