"""Search for the sets of effects that explain a set of throws.

Every single effect is simulated at several sizes in each direction, since a large one is no multiple of a
small one. The best are refined by Gauss and Newton's method. Sets grow by one effect at a time about the best
smaller sets.
"""

from collections.abc import Callable, Sequence
from itertools import combinations

import numpy as np

from diagnosis.hypotheses.candidate import (
    CandidateSet,
    StartingPoint,
    Throws,
    about_healthy_mean,
    evaluate,
    no_effect,
    refined,
    sizes_by_member,
    with_jumps_at_no_size,
    without_absent_jumps,
)
from diagnosis.hypotheses.gap_problem import GapProblem
from diagnosis.hypotheses.marginal_likelihood import MarginalLikelihood, stage_of
from diagnosis.hypotheses.unknown_check import left_by
from diagnosis.linearisation.information import NORMAL_90, Priors, Set
from diagnosis.linearisation.parameters import library
from diagnosis.tuning import (
    BEAM,
    EXTENSION_COUNT,
    FINAL_COUNT,
    GRID_RATIO,
    SINGLE_COUNT,
)
from machine.conventions import Array
from sim_twin.effects.schema import DRIFT
from sim_twin.effects.table import EFFECTS

HEALTHY_ROUNDS = 2
"""Rounds in which healthy deviations are simulated at their posterior mean."""
REFINE_ROUNDS = 3
"""Rounds of Gauss and Newton's method."""


def search(throws: Throws, tick: Callable[[float], None]) -> list[CandidateSet]:
    """Sets of effects with their evidence, no effect among them; best first.

    Args:
        throws: of the set.
        tick: called with the share done.
    """
    problem = throws.likelihood.problem
    groups = [g for g in range(len(problem.layout.groups)) if not problem.layout.is_unmodelled(g)]
    singles = _best_of_each(evaluate(throws, _grid(throws.preview, groups), is_preview=True))
    singles = refined(throws, _promising(singles)[: 2 * SINGLE_COUNT], 1, is_preview=True)
    tick(0.4)
    found = [no_effect(throws.likelihood), *_refined(throws, _best(singles)[:SINGLE_COUNT])]
    for size, (behind, kept) in enumerate(BEAM, start=2):
        smaller = [c for c in _best(found) if len(c.members) == size - 1][:behind]
        points = [p for c in smaller for p in _extensions(throws.likelihood, c, groups)]
        extended = _best_of_each(evaluate(throws, points, is_preview=True))
        found += _refined(throws, _best(extended)[:kept])
        tick(0.4 + 0.25 * (size - 1))
    missing = evaluate(throws, _missing_subsets(problem.layout.priors, found, _best(found)[:2]))
    found += refined(throws, missing, REFINE_ROUNDS)
    found = _best(_best_of_each([c for c in found if _has_all(problem.layout.priors, c)]))
    simpler = {one for c in found[:2] for one in _subsets(c.members)}
    final = found[:FINAL_COUNT] + [c for c in found[FINAL_COUNT:] if c.members in simpler]
    final += with_jumps_at_no_size(throws, final)
    for _ in range(HEALTHY_ROUNDS):
        final = about_healthy_mean(throws, final)
    final = [without_absent_jumps(throws.likelihood, c) for c in final]
    return _best(_best_of_each([c for c in final if _has_all(problem.layout.priors, c)]))


def _subsets(members: Set) -> list[Set]:
    """All sets of fewer of these effects."""
    return [part for n in range(len(members)) for part in combinations(members, n)]


def _has_all(priors: Priors, candidate: CandidateSet) -> bool:
    """Whether the 90 % interval of some size of every effect of a candidate excludes no effect."""
    sd = np.sqrt(np.diag(candidate.covariance))
    beyond = np.abs(candidate.sizes) - NORMAL_90 * sd
    parts = sizes_by_member(priors, candidate.members, beyond)
    return all(bool((part > 0.0).any()) for part in parts.values())


def _best(candidates: Sequence[CandidateSet]) -> list[CandidateSet]:
    return sorted(candidates, key=lambda c: -c.log_evidence)


def _promising(candidates: Sequence[CandidateSet]) -> list[CandidateSet]:
    """Candidates by what they may reach, best first."""
    return sorted(candidates, key=lambda c: -(c.log_evidence + c.expected_gain))


def _best_of_each(candidates: Sequence[CandidateSet]) -> list[CandidateSet]:
    """The best candidate of every set."""
    found: dict[Set, CandidateSet] = {}
    for one in candidates:
        if one.members not in found or one.log_evidence > found[one.members].log_evidence:
            found[one.members] = one
    return list(found.values())


def _refined(throws: Throws, previews: Sequence[CandidateSet]) -> list[CandidateSet]:
    """Previews, simulated on all throws and refined."""
    points = [(c.members, c.sizes + c.step) for c in previews]
    return refined(throws, evaluate(throws, points), REFINE_ROUNDS)


def _grid(likelihood: MarginalLikelihood, groups: Sequence[int]) -> list[StartingPoint]:
    """Single effects at several sizes, as far as they gain along their slopes or move a part that deviates.

    Neither alone is enough: slopes do not show effects with jumps, and of two effects that look alike the
    part of one may not deviate. A drift that gains starts at its size along the slopes of no effect.
    """
    problem, points = likelihood.problem, list[StartingPoint]()
    priors = problem.layout.priors
    linear = linear_gains(likelihood, no_effect(likelihood), groups)
    for group in groups:
        index = priors.groups[group]
        gain, along = linear[group]
        if int(index[0]) >= problem.layout.parameter_count:
            if gain > 0.0:
                points.append(((group,), along))
            continue
        if gain <= 0.0 and not _can_matter(problem, group):
            continue
        is_linear = EFFECTS[problem.layout.groups[group][0]].growth == "linear"
        for way in _ways(index.size):
            for ratio in GRID_RATIO[:1] if is_linear else GRID_RATIO:
                size = ratio * way * priors.slab_sd[index]
                if np.any(np.clip(size, priors.low[index], priors.high[index])):
                    points.append(((group,), size))
    return points


def _ways(count: int) -> list[Array]:
    """Directions of the sizes of an effect with this many parameters."""
    one = np.eye(count)
    together = [np.ones(count)] if count == 2 else []
    return [sign * way for way in [*one, *together] for sign in (1.0, -1.0)]


def _can_matter(problem: GapProblem, group: int) -> bool:
    """Whether a part of the chain that an effect moves deviates by more than on another day.

    A driven joint's effect must show in its own channel. What healthy deviations absorb counts as well.
    """
    effect, joint = problem.layout.groups[group]
    first = library()[int(problem.layout.priors.groups[group][0])]
    moved = {str(view) for view in first.views} | {first.stage}
    deviating = {part for part, shift in problem.none_shift.items() if shift.excess_sd > 1.0}
    for name, level in problem.none_levels.items():
        middle, sd = problem.model.unknown_level.get(name, (0.0, 0.3))
        if level > middle + sd:
            deviating.add(stage_of(name))
    stages = {
        part
        for part in deviating
        if joint is None or part in (stage_of(part), f"actuation.{joint}")
    }
    return effect == "release_delay" or not moved.isdisjoint(p.partition(".")[0] for p in stages)


def linear_gains(
    likelihood: MarginalLikelihood, about: CandidateSet, groups: Sequence[int]
) -> dict[int, tuple[float, Array]]:
    """Gain in log evidence by another effect along the slopes of no effect, and its size, by group."""
    problem = likelihood.problem
    priors = problem.layout.priors
    across = np.sum([p.with_healthy[:, 0] for p in about.products], axis=0)
    found: dict[int, tuple[float, Array]] = {}
    reduced = likelihood.healthy_gradient(across)
    for group in groups:
        index = priors.groups[group]
        precision = likelihood.healthy_precision[np.ix_(index, index)]
        gradient = reduced[index]
        covariance = np.linalg.inv(precision + np.diag(priors.slab_sd[index] ** -2))
        size = covariance @ gradient
        gain = 0.5 * float(gradient @ size) + 0.5 * float(
            np.linalg.slogdet(covariance)[1] - 2.0 * np.log(priors.slab_sd[index]).sum()
        )
        found[group] = gain + float(priors.log_prior[group]), size
    return found


def _extensions(
    likelihood: MarginalLikelihood, about: CandidateSet, groups: Sequence[int]
) -> list[StartingPoint]:
    """Sets of one more effect: the best along the slopes, and all at the joint that still deviates most.

    Slopes do not show effects with jumps.
    """
    problem = likelihood.problem
    priors = problem.layout.priors
    linear = linear_gains(likelihood, about, groups)
    others = [g for g in sorted(linear, key=lambda g: -linear[g][0]) if g not in about.members]
    points = [_with(priors, about, g, linear[g][1]) for g in others[:EXTENSION_COUNT]]
    left = left_by(likelihood, about.change, about.healthy_mean)
    stage = max(left, key=lambda name: left[name].excess_ratio)
    for group in others:
        effect, joint = problem.layout.groups[group]
        if stage == f"actuation.{joint}" and not effect.startswith(DRIFT):
            typical = priors.slab_sd[priors.groups[group]]
            points.append(_with(priors, about, group, typical))
    return points


def _with(priors: Priors, about: CandidateSet, group: int, size: Array) -> StartingPoint:
    """A candidate's set with one more effect at this size."""
    sizes = {
        group: size,
        **sizes_by_member(priors, about.members, about.sizes),
    }
    members = tuple(sorted(sizes))
    return members, np.concatenate([sizes[m] for m in members])


def _missing_subsets(
    priors: Priors, found: Sequence[CandidateSet], leading: Sequence[CandidateSet]
) -> list[StartingPoint]:
    """The leading sets without one of their effects, where they were not evaluated."""
    known = {c.members for c in found}
    points: dict[Set, Array] = {}
    for one in leading:
        sizes = sizes_by_member(priors, one.members, one.sizes)
        for left_out in one.members if len(one.members) > 1 else ():
            rest = tuple(m for m in one.members if m != left_out)
            if rest not in known:
                points.setdefault(rest, np.concatenate([sizes[m] for m in rest]))
    return list(points.items())
