"""Candidates: which sets of effects are worth a simulation, and from which sizes it should begin."""

from collections.abc import Sequence

import numpy as np

from diagnosis.causes.elements import STRAIGHT_EFFECTS
from diagnosis.causes.evidence import Set, weigh
from diagnosis.causes.least_sizes import is_some
from diagnosis.causes.parameters import View, library
from diagnosis.causes.problem import Problem
from diagnosis.causes.selection import search, subsets
from diagnosis.causes.settling import settle
from diagnosis.causes.shaped import with_shapes
from diagnosis.causes.strides import followed, look, polished
from diagnosis.causes.suspects import (
    PLAIN_LOG_ODDS,
    loud_joints,
    of_joints,
    of_library,
    sizes_beyond_slopes,
    suspected,
)
from diagnosis.causes.trials import Seed, kept_at, sizes_in
from diagnosis.causes.weighing import (
    Trial,
    by_member,
    evidence_in,
    fair_on_all,
    is_ahead,
    own_evidence,
)
from machine.conventions import Array
from sim_twin.effects.pairs import CONFUSABLE_PAIRS

SINGLE_COUNT = 6
PART_COUNT = 3
"""Sets whose members alone, or whose parts, are looked at."""
PARTNER_SIZE_COUNT = 2
"""Sizes from which a second effect starts."""
SMALLER_RATIO = ((1.0, 0.6), (0.6, 1.0), (0.6, 0.6))
"""Of a dead band alone, in both directions: what it may be beside another effect at its joint."""
PARTNER_COUNT = 4
"""Pairs that no slope shows which are worth more than one simulation."""
MARGIN_LOG_ODDS = 3.0
"""A grown set must promise to come this close to the best one."""
STALE_MARGIN_LOG_ODDS = 10.0
"""The same where the slopes of its last effect are those at no effect (`residuals.relinearise`): behind
viscous friction of 0.25 those of dry friction promised 4 less than nothing, and simulated the pair was 224
ahead. For all sets 10 is too much: three single effects (seed 1413302223) were answered again with it, and a
late dipper's sensor got a bias beside it, a sticking dipper a late boom's sensor."""


def settled_singles(problem: Problem, none: Trial) -> list[Trial]:
    """The most hopeful effects alone, each simulated at its own size.

    Candidates are the best by slopes at "no effect", the members of the best sets (alone they may look worse
    than they are), and everything that could act on suspect joints. `none` is the trial of no effect.
    """
    base = none.base
    priors = problem.layout.priors
    library = of_library(problem)
    alone = sorted((weigh(base, priors, (g,)) for g in library), key=lambda e: -e.log_odds)
    first = [e.members[0] for e in alone[:SINGLE_COUNT]]
    first += [g for e in search(base, priors, library)[:PART_COUNT] for g in e.members]
    suspects = suspected(problem, none, alone)
    seeds: list[Seed] = []
    for group in dict.fromkeys([*first, *suspects]):
        linear = weigh(base, priors, (group,)).mean
        beyond = sizes_beyond_slopes(problem, group)[: None if group in suspects else 1]
        shows = not beyond or bool(is_some(problem, (group,), linear).any())
        seeds += [((group,), size) for size in [linear] * shows + beyond]
    looks = look(problem, seeds)
    # At another size, or on all throws, what loses to no effect in itself may well beat it.
    hopeful = [*most_hopeful(looks)[:SINGLE_COUNT], *sorted(looks, key=_best_first)[:PART_COUNT]]
    return polished(problem, settle(problem, followed(problem, list(dict.fromkeys(hopeful))), 2))


def _best_first(trial: Trial) -> float:
    return -own_evidence(trial)


def most_hopeful(trials: Sequence[Trial]) -> list[Trial]:
    """Trials, best first; those that lose to no effect in themselves come last.

    About the leader's size "no effect" may be likelier than all that is still far from its own best size.
    """
    fair = fair_on_all(trials)
    order = sorted(range(len(trials)), key=lambda i: (is_ahead(trials[i]), fair[i]), reverse=True)
    return [trials[i] for i in order]


def partnered(problem: Problem, singles: Sequence[Trial]) -> list[Seed]:
    """Pairs behind singles, best first: with all that slopes do not show at suspect joints.

    These are the best one's own, those that they leave loud, those where a shape helps, and those where
    slopes show a second effect plainly.
    """
    seeds: list[Seed] = []
    for place, trial in enumerate(singles):
        own = trial.members[0]
        suspects = [own] if place == 0 else []
        suspects += [m[-1] for _, m in with_shapes(problem, [trial])]
        joints = [problem.layout.groups[g][1] or "" for g in suspects]
        joints += loud_joints(problem, trial, 1)
        joints += plain_partner_joints(problem, trial)
        for group in of_joints(problem, joints):
            members = tuple(sorted((own, group)))
            if group != own:
                seeds += [
                    (members, np.concatenate([first if m == own else other for m in members]))
                    for first, other in _sizes_together(problem, trial, group)
                ]
    found = sorted(look(problem, seeds), key=_best_first)
    return followed(problem, found[:PARTNER_COUNT])


def _sizes_together(problem: Problem, single: Trial, group: int) -> list[tuple[Array, Array]]:
    """Sizes of a single effect and a second one to start from together; none if slopes tell the second.

    A dead band alone also stands for what a gain or stiction at its joint does: a dipper's of 0.09 and 0.36
    beside a stiction of 0.113 rad/s came out as 0.2 and 0.49, where stiction settled at 0.06, 700 behind;
    one of 0.29 beside a gain as 0.4, where slopes said that the gain was none, 100 behind.
    """
    sizes = sizes_beyond_slopes(problem, group)
    groups, priors = problem.layout.groups, problem.layout.priors
    (effect, joint), second = groups[single.members[0]], groups[group]
    smaller = [single.at * share for share in SMALLER_RATIO] if effect == "valve_dead_band" else []
    if smaller and second == ("valve_gain", joint):
        # Slopes tell the gain beside any of these.
        return [(at, np.zeros(priors.groups[group].size)) for at in smaller]
    if smaller and second == ("stiction", joint):
        return [(at, other) for at in [single.at, *smaller] for other in sizes]
    return [(single.at, other) for other in sizes[:PARTNER_SIZE_COUNT]]


def plain_partner_joints(problem: Problem, trial: Trial) -> list[str]:
    """The joint of the second effect that slopes show best beside a trial's, if they show it plainly.

    What they show need not be what is there: they called a slew's speed limit a gain, 536 ahead of the late
    sensor of the telescope alone; the limit was another 306 ahead.
    """
    pairs = [(*trial.members, g) for g in of_library(problem) if g not in trial.members]
    weighed = [weigh(trial.base, trial.priors, tuple(sorted(pair))) for pair in pairs]
    place = int(np.argmax([e.log_odds for e in weighed]))
    ahead = weighed[place].log_odds - weigh(trial.base, trial.priors, trial.members).log_odds
    joint = problem.layout.groups[pairs[place][-1]][1]
    return [joint] if joint is not None and ahead > PLAIN_LOG_ODDS else []


def grown_sets(
    problem: Problem, behind: Sequence[Trial], kept: int, best: float
) -> dict[Set, Array]:
    """Sets of one more effect, from the linearisation of the smaller set; first sizes of the best ones.

    Sets that promise much less evidence than `best` are not worth a simulation.
    """
    weighed: dict[Set, tuple[float, Trial]] = {}
    hopeful: set[Set] = set()
    for trial in behind:
        for group in of_library(problem):
            members = tuple(sorted({*trial.members, group}))
            if len(members) == len(trial.members):
                continue
            score = evidence_in(trial.base, trial.priors, members)
            is_stale = _has_stale_slopes(problem, trial, group)
            if score > best - (STALE_MARGIN_LOG_ODDS if is_stale else MARGIN_LOG_ODDS):
                hopeful.add(members)
            if members not in weighed or weighed[members][0] < score:
                weighed[members] = score, trial
    ordered = sorted(hopeful, key=lambda m: -weighed[m][0])[:kept]
    return {m: kept_at(weighed[m][1], m, sizes_in(weighed[m][1], m)) for m in ordered}


def _has_stale_slopes(problem: Problem, trial: Trial, group: int) -> bool:
    """Whether a group's slopes in a trial are those at no effect though the trial moves what they show.

    So it is for effects of the swing and the flight alone, and for sensors' biases beside them
    (`STRAIGHT_EFFECTS`); what a valve or a late sensor moves is followed.
    """
    own, *moved = (_views(problem, g) for g in (group, *trial.members))
    if problem.layout.groups[group][0] in STRAIGHT_EFFECTS:
        own = own - {View.ACTUATION}
    return any(own & other and View.ACTUATION not in own | other for other in moved)


def _views(problem: Problem, group: int) -> set[View]:
    """What a constant effect moves; nothing of a drift."""
    named = problem.layout.groups[group]
    return {view for p in library() if p.group == named for view in p.views}


def missing_parts(found: Sequence[Trial], leading: Sequence[Trial]) -> dict[Set, Array]:
    """Parts of the leading sets that were not simulated, at the sizes that they have there.

    A set may lead that was found behind its lesser part.
    """
    known = {t.members for t in found}
    seeds: dict[Set, Array] = {}
    for trial in leading:
        sizes = by_member(trial.plain, trial.members, trial.at)
        for part in subsets(trial.members):
            if part and part not in known:
                seeds.setdefault(part, np.concatenate([sizes[m] for m in part]))
    return seeds


def missing_twins(
    problem: Problem, found: Sequence[Trial], leading: Sequence[Trial]
) -> dict[Set, Array]:
    """The leading sets with one effect's twin in its place (`is_exchanged`), if they were not simulated."""
    groups = problem.layout.groups
    other = {pair.first: pair.second for pair in CONFUSABLE_PAIRS if pair.is_exchanged}
    other |= {second: first for first, second in other.items()}
    known = {t.members for t in found}
    seeds: dict[Set, Array] = {}
    for trial in leading:
        for member in trial.members:
            effect, joint = groups[member]
            twin = (other.get(effect, ""), joint)
            if twin not in groups:
                continue
            swapped = {*trial.members, groups.index(twin)} - {member}
            members = tuple(sorted(swapped))
            if members not in known and len(members) == len(trial.members):
                seeds.setdefault(members, sizes_in(trial, members))
    return seeds
