"""A candidate: a set of effects simulated at some sizes, and its evidence there.

The evidence is Laplace's approximation about the simulated sizes: log likelihood of the simulated prediction,
prior density of the sizes, and the volume of their posterior. It needs no extrapolation, so that sets are
comparable whatever their effects do.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr, logsumexp

from diagnosis.hypotheses.marginal_likelihood import MarginalLikelihood, Products
from diagnosis.linearisation.information import Priors, Set, members_index
from diagnosis.linearisation.parameters import (
    NONSMOOTH_EFFECTS,
    Parameter,
    ParameterLayout,
    ReplayKind,
    effects_of,
    library,
)
from diagnosis.linearisation.sensitivities import LinearThrow, relinearise
from diagnosis.population.machine_baseline import SMOOTH_EFFECTS
from diagnosis.tuning import FURTHER_LOG_PRIOR, SLAB_SCALES_RATIO
from diagnosis.worker_process import WorkerProcess
from machine.conventions import Array, BoolArray, IntArray
from sim_twin.effects.effect import Effect

StartingPoint = tuple[Set, Array]
"""A set, and the sizes of its parameters, group after group."""
LEAST_GAIN = 0.3
"""Expected gain in log evidence below which sizes are not moved."""
STEP_SHARE = 0.35
"""Factor on a step that did not gain."""
LOG_TWO_PI = float(np.log(2.0 * np.pi))


@dataclass(frozen=True, slots=True, eq=False)
class CandidateSet:
    """A set of effects at simulated sizes."""

    members: Set
    sizes: Array
    """(k,) of the members' parameters, group after group."""
    log_likelihood: float
    log_evidence: float
    """With the prior odds of the set against no effect."""
    step: Array
    """(k,) from the sizes to the maximum, along the slopes."""
    covariance: Array
    """(k, k) posterior of the sizes."""
    healthy_mean: Array
    """(p,) of the healthy parameters, given the sizes."""
    products: Sequence[Products]
    """Of every throw."""
    change: Sequence[Array]
    """Change (n,) of every throw's prediction against no effect, in the channels' units."""

    @property
    def expected_gain(self) -> float:
        """Log evidence that the step promises."""
        return (
            0.5 * float(self.step @ np.linalg.solve(self.covariance, self.step))
            if self.step.size
            else 0.0
        )


def fitted_effects(layout: ParameterLayout, members: Set, sizes: Array) -> tuple[Effect, ...]:
    """A set with these sizes (group after group) as effects of the library."""
    parts = sizes_by_member(layout.priors, members, sizes)
    return tuple(effects_of(layout, member, part) for member, part in parts.items())


def sizes_by_member(priors: Priors, members: Set, sizes: Array) -> dict[int, Array]:
    """Sizes of every effect of a set."""
    ends = np.cumsum([priors.groups[m].size for m in members])[:-1]
    return dict(zip(members, np.split(sizes, ends), strict=True)) if members else {}


class Throws(NamedTuple):
    """The likelihood of all throws and of some of them, and a worker process that computes half."""

    likelihood: MarginalLikelihood
    preview: MarginalLikelihood
    worker: WorkerProcess | None = None

    def shared_with(self, worker: WorkerProcess | None) -> "Throws":
        """The same, with a worker process that holds both likelihoods."""
        if worker is not None:
            worker.hold(self)
        return self._replace(worker=worker)


def evaluate(
    throws: Throws, points: Sequence[StartingPoint], *, is_preview: bool = False
) -> list[CandidateSet]:
    """Simulate sets of effects at sizes; their evidence and the step to better sizes."""
    priors = throws.likelihood.problem.layout.priors
    points = [(members, clipped(priors, members, sizes)) for members, sizes in points]
    if throws.worker is None or len(points) < 2:
        return _evaluate(throws, points, is_preview)
    return throws.worker.split(_evaluate, throws, points, is_preview)


def _evaluate(
    throws: Throws, points: Sequence[StartingPoint], is_preview: bool
) -> list[CandidateSet]:
    likelihood = throws.preview if is_preview else throws.likelihood
    problem = likelihood.problem
    layout = problem.layout
    requests = [
        (fitted_effects(layout, m, s), [library()[i] for i in _constants(layout, m)])
        for m, s in points
    ]
    simulated = relinearise(
        problem.prepared,
        problem.profile,
        problem.calibration,
        problem.healthy,
        problem.linear,
        requests,
        followed=(),
    )
    return [
        _candidate(
            likelihood,
            members,
            sizes,
            [linear.change for linear in found],
            _slopes(likelihood, members, found),
        )
        for (members, sizes), found in zip(points, simulated, strict=True)
    ]


def about_healthy_mean(throws: Throws, candidates: Sequence[CandidateSet]) -> list[CandidateSet]:
    """Candidates whose healthy deviations are simulated as well, at their posterior mean.

    Effects are simulated and deviations follow slopes. Where the slopes are wrong, as those of a friction
    that stops a joint, an effect would gain by what a deviation of the same size explains as well.
    """
    if throws.worker is None or len(candidates) < 2:
        return _about_healthy_mean(throws, candidates)
    return throws.worker.split(_about_healthy_mean, throws, list(candidates))


def _about_healthy_mean(throws: Throws, candidates: Sequence[CandidateSet]) -> list[CandidateSet]:
    likelihood = throws.likelihood
    problem = likelihood.problem
    layout = problem.layout
    smooth = [i for i, p in enumerate(library()) if p.effect in SMOOTH_EFFECTS]
    deviations: list[Array] = []
    requests: list[tuple[tuple[Effect, ...], list[Parameter]]] = []
    for one in candidates:
        index = members_index(layout.priors, one.members)
        whole = clipped(layout.priors, one.members, one.sizes + one.healthy_mean[index])
        deviation = np.zeros(one.healthy_mean.size)
        for i in smooth:
            deviation[i] = library()[i].clip(float(one.healthy_mean[i]))
        deviation[index] = whole - one.sizes
        moved = [library()[i].at(float(deviation[i])) for i in smooth if i not in index]
        wanted = [library()[i] for i in _constants(layout, one.members)]
        requests.append(((*fitted_effects(layout, one.members, whole), *moved), wanted))
        deviations.append(deviation)
    simulated = relinearise(
        problem.prepared,
        problem.profile,
        problem.calibration,
        problem.healthy,
        problem.linear,
        requests,
        tuple(ReplayKind),
        followed=(),
    )
    found: list[CandidateSet] = []
    for one, deviation, at in zip(candidates, deviations, simulated, strict=True):
        index = members_index(layout.priors, one.members)
        others = np.setdiff1d(np.array(smooth), index)
        slopes = _slopes(likelihood, one.members, at)
        changes = [
            new.change
            - linear.jacobian[:, others] @ deviation[others]
            - slope[:, : index.size] @ deviation[index]
            for new, linear, slope in zip(at, problem.linear, slopes, strict=True)
        ]
        found.append(_candidate(likelihood, one.members, one.sizes, changes, slopes))
    return found


def with_jumps_at_no_size(throws: Throws, candidates: Sequence[CandidateSet]) -> list[CandidateSet]:
    """The candidates with nonsmooth effects, these at no size.

    A joint that may stick is replayed by rules of its own, which use where the recorded one rested. What
    these rules gain at no size is no evidence for the effect.
    """
    layout = throws.likelihood.problem.layout
    points: list[StartingPoint] = []
    for one in candidates:
        jumps = _is_nonsmooth(layout, one.members)
        if jumps.any():
            points.append((one.members, np.where(jumps, 0.0, one.sizes)))
    return evaluate(throws, points)


def without_absent_jumps(likelihood: MarginalLikelihood, one: CandidateSet) -> CandidateSet:
    """A candidate whose nonsmooth effects have no size (`with_jumps_at_no_size`) as the set without them."""
    layout = likelihood.problem.layout
    is_absent = _is_nonsmooth(layout, one.members) & (one.sizes == 0.0)
    if not is_absent.any():
        return one
    stay = ~is_absent
    sizes = sizes_by_member(layout.priors, one.members, stay.astype(np.float64))
    members = tuple(m for m, is_there in sizes.items() if is_there.any())
    covariance = np.linalg.inv(np.linalg.inv(one.covariance)[np.ix_(stay, stay)])
    volume = 0.5 * float(np.linalg.slogdet(covariance)[1]) + 0.5 * int(stay.sum()) * LOG_TWO_PI
    columns = np.concatenate([[True], stay, stay])
    prior = log_prior(layout.priors, members, one.sizes[stay])
    return replace(
        one,
        members=members,
        sizes=one.sizes[stay],
        log_evidence=one.log_likelihood + prior + volume,
        step=one.step[stay],
        covariance=covariance,
        products=[
            Products(p.own[np.ix_(columns, columns)], p.with_healthy[:, columns])
            for p in one.products
        ],
    )


def _is_nonsmooth(layout: ParameterLayout, members: Set) -> BoolArray:
    """Whether each size of a set (k,) is of a nonsmooth effect."""
    index = members_index(layout.priors, members)
    constants = library()
    return np.array(
        [i < len(constants) and constants[i].effect in NONSMOOTH_EFFECTS for i in index], dtype=bool
    )


def _constants(layout: ParameterLayout, members: Set) -> list[int]:
    """Parameters by which a set is simulated; for a drift, the drifting one."""
    index = members_index(layout.priors, members) % layout.parameter_count
    return sorted(set(index.tolist()))


def _slopes(likelihood: MarginalLikelihood, members: Set, at: Sequence[LinearThrow]) -> list[Array]:
    """Slopes (n, 2 k) of every throw by the members' sizes, then by what goes with them (`_replaced`)."""
    problem = likelihood.problem
    index = members_index(problem.layout.priors, members)
    is_drift = index >= problem.layout.parameter_count
    found: list[Array] = []
    for p, linear in zip(problem.prepared, at, strict=True):
        along = linear.jacobian[:, index % problem.layout.parameter_count]
        progress = p.input.progress_ratio
        acting, other = (
            np.where(is_drift, progress, 1.0),
            np.where(is_drift, 1.0, progress),
        )
        found.append(np.column_stack([along * acting, along * other]))
    return found


def _replaced(layout: ParameterLayout, members: Set) -> IntArray:
    """Healthy parameters whose slopes a set's simulation gives: its own, and their drifts (2 k,)."""
    index = members_index(layout.priors, members)
    count = layout.parameter_count
    return np.concatenate([index, (index + count) % (2 * count)])


def _candidate(
    likelihood: MarginalLikelihood,
    members: Set,
    sizes: Array,
    changes: Sequence[Array],
    slopes: Sequence[Array],
) -> CandidateSet:
    products = [
        likelihood.products(i, change, slope)
        for i, (change, slope) in enumerate(zip(changes, slopes, strict=True))
    ]
    return weighed(likelihood, members, sizes, products, changes)


def weighed(
    likelihood: MarginalLikelihood,
    members: Set,
    sizes: Array,
    products: Sequence[Products],
    change: Sequence[Array],
) -> CandidateSet:
    """The candidate with its evidence, from the products of its throws."""
    layout = likelihood.problem.layout
    priors = layout.priors
    found = likelihood.marginal(products, _replaced(layout, members))
    gradient, precision = found.gradient[: sizes.size], found.precision[: sizes.size, : sizes.size]
    wide = priors.slab_sd[members_index(priors, members)]
    covariance = np.asarray(np.linalg.inv(precision + np.diag(wide**-2)), dtype=np.float64)
    step = clipped(priors, members, sizes + covariance @ (gradient - sizes / wide**2)) - sizes
    volume = 0.5 * float(np.linalg.slogdet(covariance)[1]) + 0.5 * wide.size * LOG_TWO_PI
    evidence = found.log_likelihood + log_prior(priors, members, sizes) + volume
    return CandidateSet(
        members,
        sizes,
        found.log_likelihood,
        evidence,
        step,
        covariance,
        found.healthy_mean,
        products,
        change,
    )


def no_effect(likelihood: MarginalLikelihood) -> CandidateSet:
    """The candidate without effects."""
    throws = range(len(likelihood.throws))
    change = [np.zeros(likelihood.throws[i].residual.size) for i in throws]
    products = [likelihood.products(i, change[i], np.zeros((change[i].size, 0))) for i in throws]
    return weighed(likelihood, (), np.zeros(0), products, change)


def clipped(priors: Priors, members: Set, sizes: Array) -> Array:
    """Sizes within the bounds of the effect table."""
    index = members_index(priors, members)
    return np.clip(sizes, priors.low[index], priors.high[index])


def log_prior(priors: Priors, members: Set, sizes: Array) -> float:
    """Log prior density of a set at these sizes, against no effect.

    Sizes have a mixture of normal densities of several widths, cut at the bounds: effects come in all sizes.
    """
    if not members:
        return 0.0
    index = members_index(priors, members)
    logs: list[float] = []
    for scale in SLAB_SCALES_RATIO:
        sd = scale * priors.slab_sd[index]
        mass = np.log(
            np.maximum(
                np.exp(log_ndtr(priors.high[index] / sd))
                - np.exp(log_ndtr(priors.low[index] / sd)),
                1e-12,
            )
        )
        density = -0.5 * (sizes / sd) ** 2 - np.log(sd) - 0.5 * LOG_TWO_PI
        logs.append(float(np.sum(density - mass)))
    odds = float(sum(priors.log_prior[m] for m in members)) + FURTHER_LOG_PRIOR * (len(members) - 1)
    return float(logsumexp(logs)) - float(np.log(len(logs))) + odds


def refined(
    throws: Throws, candidates: Sequence[CandidateSet], rounds: int, *, is_preview: bool = False
) -> list[CandidateSet]:
    """Candidates after some rounds of Gauss and Newton's method; a step that does not gain is shortened."""
    found = list(candidates)
    share = np.ones(len(found))
    for _ in range(rounds):
        moving = [i for i, c in enumerate(found) if share[i] ** 2 * c.expected_gain > LEAST_GAIN]
        points = [(found[i].members, found[i].sizes + share[i] * found[i].step) for i in moving]
        for i, tried in zip(moving, evaluate(throws, points, is_preview=is_preview), strict=True):
            if tried.log_evidence > found[i].log_evidence:
                found[i], share[i] = tried, 1.0
            else:
                share[i] *= STEP_SHARE
    return found
