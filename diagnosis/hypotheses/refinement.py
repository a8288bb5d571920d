"""Refinement of candidates: line search, iteration of sizes, linearisation at the machine's scatter."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from diagnosis.hypotheses.candidates import (
    CURVED_EFFECTS,
    FREQUENCY_EFFECTS,
    JUMPING_EFFECTS,
    StartingPoint,
    evaluate,
    widely_varying_parameters,
)
from diagnosis.hypotheses.comparison import (
    CandidateSet,
    best_of_each,
    better,
    by_member,
    comparable_on_all,
    evidence_at_simulated,
)
from diagnosis.hypotheses.gap_problem import GapProblem
from diagnosis.inference.evidence import (
    Set,
    mean_with,
    members_index,
    screen,
    total,
    weigh,
    without_effect,
)
from diagnosis.inference.model_selection import NORMAL_90
from diagnosis.linearisation.parameters import index_of
from diagnosis.tuning import (
    CLOSE_LOG_ODDS,
    COARSE_STEP_RATIO,
    FINE_STEP_RATIO,
    LEAST_OVER_SCATTER_RATIO,
    MOST_STEPS_COUNT,
    RIVAL_LOG_ODDS,
    SLAB_SCALES_RATIO,
)
from machine.conventions import ACTIVE_JOINTS, Array, BoolArray
from sim_twin.effects.effect import Effect
from sim_twin.effects.table import EFFECTS, effects_where

LINE_SEARCHED_EFFECTS = effects_where(lambda effect: effect.growth not in ("linear", "threshold"))
"""Effects whose slopes are no guide to other sizes."""


def preview(problem: GapProblem, points: Sequence[StartingPoint]) -> list[CandidateSet]:
    """Previews of sets, each at the best of its sizes."""
    return best_of_each(evaluate(problem, points, is_preview=True))


def coarse_line_search(
    problem: GapProblem, previews: Sequence[CandidateSet]
) -> list[StartingPoint]:
    """Starting points at the previews, and where the coarse line search found higher evidence."""
    found = list(previews)
    for ratio in COARSE_STEP_RATIO:
        found = best_of_each(
            [*found, *preview(problem, _beside(problem, found, LINE_SEARCHED_EFFECTS, ratio))]
        )
    moved = [t for t in found if t not in previews]
    return [(t.members, t.at) for t in (*previews, *moved)]


def fine_line_search(problem: GapProblem, candidates: Sequence[CandidateSet]) -> list[CandidateSet]:
    """Candidates after a fine line search over effects with jumps or curves."""
    found = list(candidates)
    for ratio in FINE_STEP_RATIO:
        beside = evaluate(
            problem, _beside(problem, found, (*JUMPING_EFFECTS, *CURVED_EFFECTS), ratio)
        )
        found = best_of_each([*found, *beside])
    return found


def _beside(
    problem: GapProblem, candidates: Sequence[CandidateSet], effects: Sequence[str], ratio: float
) -> list[StartingPoint]:
    """Starting points with some effects larger and smaller by a factor."""
    groups = problem.layout.groups
    points: list[StartingPoint] = []
    for candidate in candidates:
        parts = by_member(candidate.plain, candidate.members, candidate.at)
        searched = [m for m in parts if groups[m][0] in effects]
        for times in (ratio, 1.0 / ratio) if searched else ():
            sizes = [part * (times if m in searched else 1.0) for m, part in parts.items()]
            points.append((candidate.members, np.concatenate(sizes)))
    return points


def large_enough(problem: GapProblem, candidates: Sequence[CandidateSet]) -> list[CandidateSet]:
    """Candidates all of whose effects are large enough to be a cause."""
    return [
        t
        for t in candidates
        if are_large_enough(problem, t.members, t.sizes).all()
        and not _is_marginally_faster(problem, t)
        and not _is_stiff(problem, t)
    ]


def _is_stiff(problem: GapProblem, candidate: CandidateSet) -> bool:
    """Whether a candidate's compliance is zero within its uncertainty."""
    frequency_members = [
        m for m in candidate.members if problem.layout.groups[m][0] in FREQUENCY_EFFECTS
    ]
    if not frequency_members:
        return False
    covariance = weigh(candidate.base, candidate.priors, candidate.members).covariance
    least = by_member(candidate.plain, candidate.members, NORMAL_90 * np.sqrt(np.diag(covariance)))
    sizes = by_member(candidate.plain, candidate.members, candidate.sizes)
    return any(bool((sizes[m] < least[m]).all()) for m in frequency_members)


def _is_marginally_faster(problem: GapProblem, candidate: CandidateSet) -> bool:
    """Whether a joint responds sooner than its twin by less than the error of a measured response."""
    response = zip(
        problem.profile.damping_ratio, problem.profile.natural_frequency_rad_per_s, strict=True
    )
    mean_lag_s = {j: 2.0 * z / w for j, (z, w) in zip(ACTIVE_JOINTS, response, strict=True)}
    sizes = by_member(candidate.plain, candidate.members, candidate.sizes)
    groups = [(*problem.layout.groups[m], float(size[0])) for m, size in sizes.items()]
    return any(
        -_shortening_ratio(effect) * mean_lag_s.get(str(joint), 0.0) < size < 0.0
        for effect, joint, size in groups
    )


def are_large_enough(problem: GapProblem, members: Set, sizes: Array) -> BoolArray:
    """(members,) whether any size of each group is large enough, within its bounds."""
    priors = problem.layout.priors
    index = members_index(priors, members)
    size = np.abs(np.clip(sizes, priors.low[index], priors.high[index]))
    parts = by_member(priors, members, size).items()
    return np.array(
        [(part > _least_sizes(problem, m, len(members))).any() for m, part in parts],
        dtype=np.bool_,
    )


def _least_sizes(problem: GapProblem, group: int, member_count: int) -> Array:
    """Least sizes of a group's parameters in a set of this many effects.

    Deviations within the scatter of healthy machines need no cause. Beside another effect, a small effect
    with a threshold is that effect's model error.
    """
    priors, effect = problem.layout.priors, problem.layout.groups[group][0]
    index = priors.groups[group]
    scatter_sd = np.sqrt(np.diag(priors.scatter)[index])
    least = np.maximum(
        SLAB_SCALES_RATIO[-1] * priors.slab_sd[index], LEAST_OVER_SCATTER_RATIO * scatter_sd
    )
    if member_count > 1:
        least = np.maximum(least, _beside_ratio(effect) * priors.slab_sd[index])
    return least


def _beside_ratio(effect: str) -> float:
    """`least_beside_ratio` of a group's effect; 0 for drifts and shapes."""
    return EFFECTS[effect].least_beside_ratio if effect in EFFECTS else 0.0


def _shortening_ratio(effect: str) -> float:
    """`least_shortening_ratio` of a group's effect; 0 for drifts and shapes."""
    return EFFECTS[effect].least_shortening_ratio if effect in EFFECTS else 0.0


def relinearise_near_best(
    problem: GapProblem, candidates: Sequence[CandidateSet]
) -> list[CandidateSet]:
    """Relinearise the hypotheses near the best at the posterior mean of the machine's scatter.

    Keep a result if the evidence rises. Scatter is nonlinear as effects are; the best set and its rivals,
    "no effect" among them, are relinearised a second time.
    """
    close = _within(candidates, CLOSE_LOG_ODDS)
    found = {t.members: t for t in relinearise_if_better(problem, close)}
    rivals = _within(list(found.values()), RIVAL_LOG_ODDS)
    for new in _relinearise(problem, rivals, [t.sizes for t in rivals]):
        found[new.members] = better(found[new.members], new, evidence_at_simulated)
    return [found.get(t.members, t) for t in candidates]


def _within(candidates: Sequence[CandidateSet], log_odds: float) -> list[CandidateSet]:
    """Candidates within these log odds of the best one."""
    fair = comparable_on_all(candidates)
    return [t for t, own in zip(candidates, fair, strict=True) if own > max(fair) - log_odds]


def relinearise_if_better(
    problem: GapProblem, candidates: Sequence[CandidateSet]
) -> list[CandidateSet]:
    """Candidates relinearised at the posterior mean of the machine's scatter, where the evidence rises."""
    there = _relinearise(problem, candidates, [t.at for t in candidates])
    return [
        better(old, new, evidence_at_simulated) for old, new in zip(candidates, there, strict=True)
    ]


def _relinearise(
    problem: GapProblem, candidates: Sequence[CandidateSet], sizes: Sequence[Array]
) -> list[CandidateSet]:
    """Candidates of these sets at some sizes, linearised at their estimate of the machine's scatter."""
    points = [(t.members, size) for t, size in zip(candidates, sizes, strict=True)]
    return [
        with_consistent_residual(t)
        for t in evaluate(problem, points, [_scatter(problem, t) for t in candidates])
    ]


def with_consistent_residual(candidate: CandidateSet) -> CandidateSet:
    """A candidate whose residual without effect is the extrapolated one if that is less favourable.

    The residual without effect belongs to another linearisation point than the slopes; no effect must not
    gain from that.
    """
    data = total(candidate.information)
    extrapolated = screen(data, candidate.plain).log_evidence
    if screen(without_effect(data), candidate.plain).log_evidence <= extrapolated:
        return candidate
    own = [
        i._replace(none_gradient=i.gradient, none_square=i.square) for i in candidate.information
    ]
    return replace(candidate, information=own)


def _scatter(problem: GapProblem, candidate: CandidateSet) -> tuple[Effect, ...]:
    """Posterior mean of the machine's own scatter beside a candidate's set, for widely varying parameters."""
    data = total(candidate.information)
    base = screen(data, candidate.plain)
    own = weigh(base, candidate.plain, candidate.members)
    mean = mean_with(base, data, candidate.plain, own).copy()
    mean[members_index(candidate.plain, candidate.members)] -= own.mean
    middle = problem.model.healthy_mean
    return tuple(
        p.at(p.clip(middle.get(p.key, 0.0) + float(mean[index_of()[p.key]])))
        for p in widely_varying_parameters()
    )


def refine(problem: GapProblem, points: Sequence[StartingPoint], rounds: int) -> list[CandidateSet]:
    """Evaluate and estimate repeatedly; of a set with several starting points the best."""
    return refine_until_close(problem, best_of_each(evaluate(problem, points)), rounds - 1)


def refine_once(problem: GapProblem, candidates: Sequence[CandidateSet]) -> list[CandidateSet]:
    """Evaluated once more at the estimates; the better candidate of every set is kept."""
    found = evaluate(problem, {t.members: t.sizes for t in candidates})
    return [
        better(new, old, evidence_at_simulated) for old, new in zip(candidates, found, strict=True)
    ]


def refine_until_close(
    problem: GapProblem, candidates: Sequence[CandidateSet], steps: int = MOST_STEPS_COUNT
) -> list[CandidateSet]:
    """Candidates, iterated while the estimate differs from the simulated size by more than its uncertainty.

    Iteration stops when the evidence does not rise. Effects with jumps are always iterated, since their
    slopes are no guide.
    """
    found = {t.members: t for t in candidates}
    moved = [t for t in candidates if t.jumping or not _is_converged(t)]
    for _ in range(steps):
        tried = refine_once(problem, moved)
        improved = [t for t, old in zip(tried, moved, strict=True) if t is not old]
        moved = [t for t in improved if t.jumping or not _is_converged(t)]
        found |= {t.members: t for t in tried}
        if not moved:
            break
    return [found[t.members] for t in candidates]


def _is_converged(candidate: CandidateSet) -> bool:
    variance = np.diag(weigh(candidate.base, candidate.priors, candidate.members).covariance)
    return bool(np.all(np.square(candidate.sizes - candidate.at) <= variance))
