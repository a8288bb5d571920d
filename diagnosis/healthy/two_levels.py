"""Scatter at two levels: a healthy machine is off its twin by its own, and every set of throws a bit more.

Parameters of a set, theta = mean + m + d: m ~ N(0, M) is the machine's, the same in all its sets, and
d ~ N(0, D) the set's. What a set of throws says about theta is quadratic (`Told`), so both levels are closed:
they are learned from many machines by expectation maximisation (`learn`), and throws of a machine that was
healthy then narrow its own m (`of_machine`), so that an effect shows above D alone.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from diagnosis.causes.evidence import Information
from diagnosis.causes.parameters import Layout
from machine.conventions import Array, BoolArray

ROUND_COUNT = 60
"""Directions that few throws tell are slow: after 6 rounds their scatter was up to 4 times too large."""
MACHINE_SHRINKING_COUNT = 1.0
SET_SHRINKING_COUNT = 1.0
"""So many machines (sets) without any correlation are added to those that were seen. Learned on 68 machines,
133 sets of the other 67 are likelier the fewer these are: by 130, 300, 377 and 406 in log likelihood with 10,
3, 1 and 0.1 instead of 30, which broke correlations of what is hardly told apart (gain, speed under load)."""
LEAST_RATIO = 1e-4
"""Of the first guess: no direction is without scatter."""


class Told(NamedTuple):
    """What a set says about theta, up to a constant: theta'b - theta'A theta / 2."""

    precision: Array
    """A (p, p)"""
    gradient: Array
    """b (p,)"""


class Levels(NamedTuple):
    """Middle and scatter of theta."""

    mean: Array
    """(p,)"""
    machine: Array
    """M (p, p)"""
    within: Array
    """D (p, p)"""


def told(information: Information, plan: Layout) -> Told:
    """What a set says about constants and nuisances, in the order of `scatter_names`, drifts marginalised."""
    count = plan.parameter_count
    fixed = np.r_[:count, count + plan.drift_count : plan.size_count]
    drifts = slice(count, count + plan.drift_count)
    precision, gradient = information.precision, information.gradient
    inner = precision[drifts, drifts] + _inverse(plan.priors.scatter[drifts, drifts])
    across = precision[fixed][:, drifts]
    taken = np.linalg.solve(inner, across.T)
    return Told(
        precision[np.ix_(fixed, fixed)] - across @ taken,
        gradient[fixed] - taken.T @ gradient[drifts],
    )


def of_machine(sets: Sequence[Told], levels: Levels) -> tuple[Array, Array]:
    """What a machine is off by itself, from sets of its throws: mean (p,) and covariance (p, p) of m."""
    within = _inverse(levels.within)
    own = [_inverse(one.precision + within) for one in sets]
    return _of_machine(sets, own, levels.mean, _inverse(levels.machine))


def _of_machine(
    sets: Sequence[Told], own: Sequence[Array], mean: Array, precision: Array
) -> tuple[Array, Array]:
    """As `of_machine`, from covariances of every set's d given m, and the precision of m before the data."""
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
    machines: Sequence[Sequence[Told]],
    first: Levels,
    *,
    has_mean: BoolArray,
    rounds: int = ROUND_COUNT,
) -> Levels:
    """The levels under which the sets of these machines are most probable.

    Args:
        machines: what the sets of each tell.
        first: where to begin.
        has_mean: (p,) which of theta have a mean of their own; the others keep that of `first`.
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


def _improved(machines: Sequence[Sequence[Told]], levels: Levels, has_mean: BoolArray) -> Levels:
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
        shrunk(machine, len(machines), MACHINE_SHRINKING_COUNT),
        shrunk(within / count, count, SET_SHRINKING_COUNT),
    )


def shrunk(covariance: Array, count: int, shrinking_count: float) -> Array:
    """Drawn towards its diagonal as if so many draws more had shown no correlation."""
    share = shrinking_count / (count + shrinking_count)
    both = 0.5 * (covariance + covariance.T)
    return (1.0 - share) * both + share * np.diag(np.diag(both))
