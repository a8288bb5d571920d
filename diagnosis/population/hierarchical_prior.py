"""Hierarchical prior: a healthy machine deviates from its twin, and each set of its throws deviates further.

Parameters of a set, theta = mean + m + d: m ~ N(0, M) belongs to the machine and is the same in all its
sets, d ~ N(0, D) belongs to the set. The log likelihood of theta is quadratic (`SetLikelihood`), so both
levels are in closed form. They are learned from many machines by expectation maximisation (`learn`). Throws
of a machine that was healthy then give the posterior of its m (`of_machine`), so that an effect has to
exceed D alone.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from diagnosis.linearisation.information import Information
from diagnosis.linearisation.parameters import ParameterLayout
from machine.conventions import Array, BoolArray

ROUND_COUNT = 60
"""Rounds of expectation maximisation; directions that few throws determine converge slowly."""
MACHINE_SHRINKING_COUNT = 1.0
SET_SHRINKING_COUNT = 1.0
"""Numbers of uncorrelated pseudo-machines and pseudo-sets that are added to those seen."""
LEAST_RATIO = 1e-4
"""Least standard deviation as a share of the initial one."""


class SetLikelihood(NamedTuple):
    """Log likelihood of theta for one set, up to a constant: theta'b - theta'A theta / 2."""

    precision: Array
    """A (p, p)"""
    gradient: Array
    """b (p,)"""


class Levels(NamedTuple):
    """Mean and covariances of theta."""

    mean: Array
    """(p,)"""
    machine: Array
    """M (p, p)"""
    within: Array
    """D (p, p)"""


def set_likelihood(information: Information, plan: ParameterLayout) -> SetLikelihood:
    """Log likelihood of constants and nuisances in the order of `scatter_names`; drifts are marginalised."""
    count = plan.parameter_count
    fixed = np.r_[:count, count + plan.drift_count : plan.size_count]
    drifts = slice(count, count + plan.drift_count)
    precision, gradient = information.precision, information.gradient
    inner = precision[drifts, drifts] + _inverse(plan.priors.scatter[drifts, drifts])
    across = precision[fixed][:, drifts]
    taken = np.linalg.solve(inner, across.T)
    return SetLikelihood(
        precision[np.ix_(fixed, fixed)] - across @ taken,
        gradient[fixed] - taken.T @ gradient[drifts],
    )


def of_machine(sets: Sequence[SetLikelihood], levels: Levels) -> tuple[Array, Array]:
    """Posterior of a machine's own deviation m from sets of its throws: mean (p,), covariance (p, p)."""
    within = _inverse(levels.within)
    own = [_inverse(one.precision + within) for one in sets]
    return _of_machine(sets, own, levels.mean, _inverse(levels.machine))


def _of_machine(
    sets: Sequence[SetLikelihood], own: Sequence[Array], mean: Array, precision: Array
) -> tuple[Array, Array]:
    """As `of_machine`, from the covariances of every set's d given m and the prior precision of m."""
    gradient = np.zeros(mean.size)
    for one, covariance in zip(sets, own, strict=True):
        beyond = one.gradient - one.precision @ mean
        precision = precision + one.precision - one.precision @ covariance @ one.precision
        gradient = gradient + beyond - one.precision @ (covariance @ beyond)
    found = _inverse(precision)
    return found @ gradient, found


def _inverse(matrix: Array) -> Array:
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)


def learn(
    machines: Sequence[Sequence[SetLikelihood]],
    first: Levels,
    *,
    has_mean: BoolArray,
    rounds: int = ROUND_COUNT,
) -> Levels:
    """The covariances under which the sets of these machines are most probable.

    Args:
        machines: sets of each machine.
        first: initial values.
        has_mean: (p,) which of theta have a mean; the others keep that of `first`.
        rounds: of expectation maximisation.
    """
    levels = first
    least_machine, least_set = (np.diag(LEAST_RATIO**2 * np.diag(m)) for m in first[1:])
    for _ in range(rounds):
        levels = _improved(machines, levels, has_mean)
        levels = levels._replace(
            machine=levels.machine + least_machine, within=levels.within + least_set
        )
    return levels


def _improved(
    machines: Sequence[Sequence[SetLikelihood]], levels: Levels, has_mean: BoolArray
) -> Levels:
    middles: list[Array] = []
    machine, within = np.zeros_like(levels.machine), np.zeros_like(levels.within)
    of_set, of_machines = _inverse(levels.within), _inverse(levels.machine)
    for sets in machines:
        own = [_inverse(one.precision + of_set) for one in sets]
        middle, covariance = _of_machine(sets, own, levels.mean, of_machines)
        middles.append(middle)
        machine += covariance
        for one, alone in zip(sets, own, strict=True):
            off = alone @ (one.gradient - one.precision @ (levels.mean + middle))
            shared = alone @ one.precision
            within += np.outer(off, off) + alone + shared @ covariance @ shared.T
    count = sum(len(sets) for sets in machines)
    moved = np.where(has_mean, np.mean(middles, axis=0), 0.0)
    left = np.stack(middles) - moved
    machine = (machine + left.T @ left) / len(machines)
    return Levels(
        levels.mean + moved,
        shrink_covariance(machine, len(machines), MACHINE_SHRINKING_COUNT),
        shrink_covariance(within / count, count, SET_SHRINKING_COUNT),
    )


def shrink_covariance(covariance: Array, count: int, shrinking_count: float) -> Array:
    """The covariance shrunk towards its diagonal by this number of uncorrelated pseudo-draws."""
    share = shrinking_count / (count + shrinking_count)
    both = 0.5 * (covariance + covariance.T)
    return (1.0 - share) * both + share * np.diag(np.diag(both))
