"""Generation of candidates: which sets of effects are worth a simulation, and from which sizes."""

from collections.abc import Collection, Sequence

import numpy as np

from diagnosis.hypotheses.candidates import StartingPoint, kept_at, sizes_in
from diagnosis.hypotheses.comparison import (
    CandidateSet,
    EvaluatedSet,
    beats_none,
    by_member,
    comparable_on_all,
    evidence_in,
    local_evidence,
)
from diagnosis.hypotheses.gap_problem import GapProblem
from diagnosis.hypotheses.refinement import (
    are_large_enough,
    coarse_line_search,
    fine_line_search,
    preview,
    refine,
)
from diagnosis.inference.evidence import Set, SetEvidence, weigh
from diagnosis.inference.model_selection import search, subsets
from diagnosis.linearisation.parameters import NONSMOOTH_EFFECTS, Group, ReplayKind, library
from diagnosis.linearisation.simulation_batch import FIXED_SLOPE_EFFECTS
from diagnosis.linearisation.unmodelled_effects import UNMODELLED, group_of
from diagnosis.tuning import (
    BETWEEN_RATIO,
    CLEAR_LOG_ODDS,
    FAR_RATIO,
    LEAST_OWN_LOG_EVIDENCE,
    MARGIN_LOG_ODDS,
    PARTNER_COUNT,
    PARTNER_SIZE_COUNT,
    RESIDUAL_JOINT_COUNT,
    RESIDUAL_JOINT_RATIO,
    RESIDUAL_JOINT_SD,
    SINGLE_COUNT,
    SMALLER_RATIO,
    STALE_MARGIN_LOG_ODDS,
    STICTION_BETWEEN_RATIO,
    SUBSET_COUNT,
    UNMODELLED_COUNT,
)
from machine.conventions import ACTIVE_JOINTS, Array
from sim_twin.effects.pairs import CONFUSABLE_PAIRS
from sim_twin.effects.schema import DRIFT
from sim_twin.effects.table import effects_where

HIDDEN_FROM_SLOPES = effects_where(lambda effect: effect.growth not in ("linear", "curved"))
"""Effects that are unlike a multiple of their slope at size 0."""


def library_groups(problem: GapProblem) -> list[int]:
    """Groups of effects of the library."""
    return [g for g in range(len(problem.layout.groups)) if not problem.layout.is_unmodelled(g)]


def groups_to_examine(
    problem: GapProblem, none: CandidateSet, alone: Sequence[SetEvidence]
) -> list[int]:
    """Groups that could act on joints with residual power, or where slopes show an effect clearly.

    Drifts of effects that slopes do not show are included where a drift shows clearly. Effects without a
    joint are always included.
    """
    groups = problem.layout.groups
    plain = [groups[e.members[0]] for e in alone if e.log_odds > CLEAR_LOG_ODDS]
    shown = [joint for _, joint in plain if joint is not None]
    residual_joints = joints_with_residual(problem, none, RESIDUAL_JOINT_COUNT)
    joints = list(dict.fromkeys([*shown[:RESIDUAL_JOINT_COUNT], *residual_joints]))
    drifts = any(effect.startswith(DRIFT) for effect, _ in plain[:RESIDUAL_JOINT_COUNT])
    hidden = [
        g
        for g, (effect, joint) in enumerate(groups)
        if (joint is None or joint in joints)
        and (drifts or not effect.startswith(DRIFT))
        and nonlinear_starts(problem, g)
    ]
    return list(dict.fromkeys([*groups_at_joints(problem, joints), *hidden]))


def nonlinear_starts(problem: GapProblem, group: int) -> list[Array]:
    """Starting sizes of an effect, or drift, that is not proportional to its slope at 0; empty for others."""
    priors = problem.layout.priors
    effect = problem.layout.groups[group][0].removeprefix(f"{DRIFT}:").partition(".")[0]
    if effect not in HIDDEN_FROM_SLOPES:
        return []
    typical = priors.slab_sd[priors.groups[group]]
    # A large size in one direction would hide the other direction.
    far = [FAR_RATIO * typical * way for way in np.eye(typical.size)]
    between = STICTION_BETWEEN_RATIO if effect == "stiction" else BETWEEN_RATIO
    return [typical, *far, *(ratio * typical for ratio in between)]


def joints_with_residual(problem: GapProblem, candidate: CandidateSet, count: int) -> list[str]:
    """The driven joints with the largest residual power above healthy machines, largest first."""
    names = [f"actuation.{joint}" for joint in ACTIVE_JOINTS]
    above = _above_healthy(problem, candidate, names)
    residual_joints: dict[str, float] = dict(zip(ACTIVE_JOINTS, above, strict=True))
    least = max(
        RESIDUAL_JOINT_SD, RESIDUAL_JOINT_RATIO * max(residual_joints.values(), default=0.0)
    )
    return sorted(
        (j for j in residual_joints if residual_joints[j] >= least),
        key=lambda j: -residual_joints[j],
    )[:count]


def _above_healthy(
    problem: GapProblem, candidate: CandidateSet, blocks: Sequence[str]
) -> list[float]:
    """Residual power in blocks, in standard deviations of healthy sets; -inf for missing blocks."""
    left, healthy = candidate.levels, problem.model.unknown_level
    return [
        (left[name] - healthy[name][0]) / healthy[name][1]
        if name in left and name in healthy
        else -np.inf
        for name in blocks
    ]


def groups_at_joints(problem: GapProblem, joints: Collection[str]) -> list[int]:
    """Groups of constant effects at some joints."""
    return [
        g
        for g, (effect, joint) in enumerate(problem.layout.groups)
        if joint in joints and not effect.startswith((DRIFT, UNMODELLED))
    ]


METERING_EFFECTS = effects_where(lambda effect: effect.shapes_speed)
"""Effects of a valve's metering edges."""


def with_unmodelled_effects(
    problem: GapProblem, candidates: Sequence[CandidateSet]
) -> list[EvaluatedSet]:
    """The best sets of a candidate's effects and one unmodelled effect.

    Unmodelled effects are linear in their sizes: they need no simulation.
    """
    groups = problem.layout.groups
    shapes = [g for g in range(len(groups)) if problem.layout.is_unmodelled(g)]
    found: list[tuple[float, Set, int]] = []
    for place, t in enumerate(candidates):
        own = local_evidence(t)
        named = [groups[m] for m in t.members]
        for shape in (g for g in shapes if not _is_model_error_of(named, groups[g])):
            members = (*t.members, shape)
            weighed = weigh(t.base, t.priors, members)
            log_evidence = t.base.log_evidence + weighed.log_odds
            if log_evidence > own and _unexplained_evidence(t, weighed) > LEAST_OWN_LOG_EVIDENCE:
                found.append((log_evidence, members, place))
    found.sort(key=lambda one: -one[0])
    return [(place, members) for _, members, place in found[:UNMODELLED_COUNT]]


def _is_model_error_of(named: Sequence[Group], shape: Group) -> bool:
    """Whether an unmodelled effect may be the model error of named effects at its joint.

    The model error of nonsmooth effects is not known. Dead band and gain are the simplest model of a
    valve's metering, whose model error is another dependence of speed on the command.
    """
    own = {effect for effect, joint in named if joint == shape[1]}
    is_metered = not own.isdisjoint(METERING_EFFECTS) and shape[0] == group_of("command")
    return is_metered or not own.isdisjoint(NONSMOOTH_EFFECTS)


def _unexplained_evidence(candidate: CandidateSet, weighed: SetEvidence) -> float:
    """Log evidence of a set's unmodelled effect from what no named parameter explains, at its size."""
    index = candidate.priors.groups[weighed.members[-1]]
    size = weighed.mean[-index.size :]
    return 0.5 * float(size @ candidate.base.precision[np.ix_(index, index)] @ size)


def refined_singles(problem: GapProblem, none: CandidateSet) -> list[CandidateSet]:
    """The most promising single effects, each evaluated at its own size.

    These are the best by slopes at "no effect", the members of the best sets, and the effects at joints
    with residual power. `none` is the candidate without effects.
    """
    base = none.base
    priors = problem.layout.priors
    library = library_groups(problem)
    alone = sorted((weigh(base, priors, (g,)) for g in library), key=lambda e: -e.log_odds)
    first = [e.members[0] for e in alone[:SINGLE_COUNT]]
    first += [g for e in search(base, priors, library)[:SUBSET_COUNT] for g in e.members]
    examined = groups_to_examine(problem, none, alone)
    points: list[StartingPoint] = []
    for group in dict.fromkeys([*first, *examined]):
        linear = weigh(base, priors, (group,)).mean
        beyond = nonlinear_starts(problem, group)[: None if group in examined else 1]
        shows = not beyond or bool(are_large_enough(problem, (group,), linear).any())
        points += [((group,), size) for size in [linear] * shows + beyond]
    previews = preview(problem, points)
    # A candidate that loses to no effect may beat it at another size, or on all throws.
    promising = [
        *most_promising(previews)[:SINGLE_COUNT],
        *sorted(previews, key=_best_first)[:SUBSET_COUNT],
    ]
    return fine_line_search(
        problem, refine(problem, coarse_line_search(problem, list(dict.fromkeys(promising))), 2)
    )


def _best_first(candidate: CandidateSet) -> float:
    return -local_evidence(candidate)


def most_promising(candidates: Sequence[CandidateSet]) -> list[CandidateSet]:
    """Candidates, best first; those that lose to no effect in their own linearisation come last."""
    fair = comparable_on_all(candidates)
    order = sorted(
        range(len(candidates)), key=lambda i: (beats_none(candidates[i]), fair[i]), reverse=True
    )
    return [candidates[i] for i in order]


def pair_starts(problem: GapProblem, singles: Sequence[CandidateSet]) -> list[StartingPoint]:
    """Pairs with single effects, best first: second effects that slopes do not show.

    They are examined at the best single effect's joint, at joints with residual power, where an unmodelled
    effect helps, and where slopes show a second effect clearly.
    """
    points: list[StartingPoint] = []
    for place, candidate in enumerate(singles):
        own = candidate.members[0]
        examined = [own] if place == 0 else []
        examined += [m[-1] for _, m in with_unmodelled_effects(problem, [candidate])]
        joints = [problem.layout.groups[g][1] or "" for g in examined]
        joints += joints_with_residual(problem, candidate, 1)
        joints += clear_partner_joints(problem, candidate)
        for group in groups_at_joints(problem, joints):
            members = tuple(sorted((own, group)))
            if group != own:
                points += [
                    (members, np.concatenate([first if m == own else other for m in members]))
                    for first, other in _sizes_together(problem, candidate, group)
                ]
    found = sorted(preview(problem, points), key=_best_first)
    return coarse_line_search(problem, found[:PARTNER_COUNT])


def _sizes_together(
    problem: GapProblem, single: CandidateSet, group: int
) -> list[tuple[Array, Array]]:
    """Starting sizes of a single effect and a second one; none if slopes show the second.

    A dead band alone also takes up the signal of a gain or stiction at its joint, and then starts smaller,
    too.
    """
    sizes = nonlinear_starts(problem, group)
    groups, priors = problem.layout.groups, problem.layout.priors
    (effect, joint), second = groups[single.members[0]], groups[group]
    smaller = [single.at * share for share in SMALLER_RATIO] if effect == "valve_dead_band" else []
    if smaller and second == ("valve_gain", joint):
        # Slopes determine the gain beside any of these.
        return [(at, np.zeros(priors.groups[group].size)) for at in smaller]
    if smaller and second == ("stiction", joint):
        return [(at, other) for at in [single.at, *smaller] for other in sizes]
    return [(single.at, other) for other in sizes[:PARTNER_SIZE_COUNT]]


def clear_partner_joints(problem: GapProblem, candidate: CandidateSet) -> list[str]:
    """The joint of the second effect with the highest log odds by slopes, if they are clear.

    The effect there need not be the one that slopes show.
    """
    pairs = [(*candidate.members, g) for g in library_groups(problem) if g not in candidate.members]
    weighed = [weigh(candidate.base, candidate.priors, tuple(sorted(pair))) for pair in pairs]
    place = int(np.argmax([e.log_odds for e in weighed]))
    ahead = (
        weighed[place].log_odds
        - weigh(candidate.base, candidate.priors, candidate.members).log_odds
    )
    joint = problem.layout.groups[pairs[place][-1]][1]
    return [joint] if joint is not None and ahead > CLEAR_LOG_ODDS else []


def extended_sets(
    problem: GapProblem, behind: Sequence[CandidateSet], kept: int, best: float
) -> dict[Set, Array]:
    """Sets of one more effect with starting sizes, by slopes about the smaller set.

    Sets whose extrapolated evidence is far below `best` are left out.
    """
    weighed: dict[Set, tuple[float, CandidateSet]] = {}
    promising: set[Set] = set()
    for candidate in behind:
        for group in library_groups(problem):
            members = tuple(sorted({*candidate.members, group}))
            if len(members) == len(candidate.members):
                continue
            score = evidence_in(candidate.base, candidate.priors, members)
            is_stale = _has_stale_slopes(problem, candidate, group)
            if score > best - (STALE_MARGIN_LOG_ODDS if is_stale else MARGIN_LOG_ODDS):
                promising.add(members)
            if members not in weighed or weighed[members][0] < score:
                weighed[members] = score, candidate
    ordered = sorted(promising, key=lambda m: -weighed[m][0])[:kept]
    return {m: kept_at(weighed[m][1], m, sizes_in(weighed[m][1], m)) for m in ordered}


def _has_stale_slopes(problem: GapProblem, candidate: CandidateSet, group: int) -> bool:
    """Whether a group's slopes in a candidate are those at no effect although the candidate moves its signal.

    So it is for effects of swing and flight, and for sensor biases beside them; slopes of valves and late
    sensors are updated.
    """
    own, *moved = (_views(problem, g) for g in (group, *candidate.members))
    if problem.layout.groups[group][0] in FIXED_SLOPE_EFFECTS:
        own = own - {ReplayKind.ACTUATION}
    return any(own & other and ReplayKind.ACTUATION not in own | other for other in moved)


def _views(problem: GapProblem, group: int) -> set[ReplayKind]:
    """Views that a constant effect moves; empty for a drift."""
    named = problem.layout.groups[group]
    return {view for p in library() if p.group == named for view in p.views}


def missing_subsets(
    found: Sequence[CandidateSet], leading: Sequence[CandidateSet]
) -> dict[Set, Array]:
    """Subsets of the leading sets that were not evaluated, at the sizes that they have there."""
    known = {t.members for t in found}
    points: dict[Set, Array] = {}
    for candidate in leading:
        sizes = by_member(candidate.plain, candidate.members, candidate.at)
        for part in subsets(candidate.members):
            if part and part not in known:
                points.setdefault(part, np.concatenate([sizes[m] for m in part]))
    return points


def missing_lookalikes(
    problem: GapProblem, found: Sequence[CandidateSet], leading: Sequence[CandidateSet]
) -> dict[Set, Array]:
    """The leading sets with one effect replaced by its lookalike, if they were not evaluated."""
    groups = problem.layout.groups
    other = {pair.first: pair.second for pair in CONFUSABLE_PAIRS if pair.is_exchanged}
    other |= {second: first for first, second in other.items()}
    known = {t.members for t in found}
    points: dict[Set, Array] = {}
    for candidate in leading:
        for member in candidate.members:
            effect, joint = groups[member]
            twin = (other.get(effect, ""), joint)
            if twin not in groups:
                continue
            swapped = {*candidate.members, groups.index(twin)} - {member}
            members = tuple(sorted(swapped))
            if members not in known and len(members) == len(candidate.members):
                points.setdefault(members, sizes_in(candidate, members))
    return points
