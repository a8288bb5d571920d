"""Candidates: which sets of effects are worth a simulation, and from which sizes it should begin."""

from collections.abc import Collection, Sequence

import numpy as np

from diagnosis.causes.elements import STRAIGHT_EFFECTS
from diagnosis.causes.least_sizes import is_some
from diagnosis.causes.parameters import ROUGH_EFFECTS, Group, View, library
from diagnosis.causes.problem import Problem
from diagnosis.causes.selection import (
    Set,
    SetEvidence,
    search,
    subsets,
    weigh,
)
from diagnosis.causes.shapes import UNHEARD, group_of
from diagnosis.causes.strides import LATE, followed, look, polished
from diagnosis.causes.trials import SWAYING, Seed, kept_at, settle, sizes_in
from diagnosis.causes.weighing import (
    Seen,
    Trial,
    by_member,
    evidence_in,
    fair_on_all,
    is_ahead,
    own_evidence,
)
from machine.conventions import ACTIVE_JOINTS, Array
from sim_twin.effects.effect import DRIFT

SINGLE_COUNT = 6
PART_COUNT = 3
"""Sets whose members alone, or whose parts, are looked at."""
LOUD_SD = 3.0
"""A joint's leftover power that calls for a look at everything that could act on it."""
LOUD_COUNT = 2
NEARLY_AS_LOUD_RATIO = 0.5
"""A joint that a neighbour shakes may be louder than the neighbour (0.6 with a late dipper sensor)."""
PLAIN_LOG_ODDS = 10.0
"""An effect that slopes at "no effect" show so plainly makes its joint suspect, loud or not."""
WITH_THRESHOLD = (
    "valve_dead_band",
    "valve_hysteresis",
    "speed_limit",
    "backlash",
    "stiction",
    "pump_flow_sharing",
)
FAR_RATIO = 3.0
"""Suspects start from this multiple of it, too: from 0.05 s the estimate of a latency of 0.135 s moves on by
0.012 s a simulation only, and from 0.068 rad/s that of a breakaway speed of 0.135 rad/s by 0.006 rad/s."""
BETWEEN_RATIO = (1.75,)
STICTION_BETWEEN_RATIO = (1.35, 1.75, 2.15, 2.55)
"""And from these: a dipper that broke loose at 0.11 rad/s was told by neither 0.05 nor 0.15 rad/s, and one of
0.135 rad/s between 0.1 and 0.14 rad/s alone."""
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
TWINS = (
    ("valve_dead_time", "valve_lag"),
    ("valve_gain", "load_dependent_speed"),
    ("payload_mass", "air_drag"),
)
"""Effects that look so much alike that neither is named before the other was simulated at its joint. A
stranger's dead time of a boom, 62 ms, was surely a lag (93 %): no dead time had come as far as that. A load
heavier by 4.5 kg beside a late slew was less drag, and 9 ahead of it once it was simulated."""
METERING_EFFECTS = ("valve_dead_band", "valve_gain")
SHAPED_COUNT = 5
"""Sets with a shape that are weighed."""
LEAST_OWN_LOG_EVIDENCE = 4.0
"""That a shape has to tell by what no name explains of it. In seven sets with unknown
effects the leading shapes told 6 to 38 by that; a stranger's gain of 0.15 beside a late sensor was a valve
whose speed grows with the command in another way, 11 ahead of the late sensor alone, and told 1.3."""


def settled_singles(problem: Problem, none: Trial) -> list[Trial]:
    """The most hopeful effects alone, each simulated at its own size.

    Candidates are the best by slopes at "no effect", the members of the best sets (alone they may look worse
    than they are), and everything that could act on suspect joints. `none` is the trial of no effect.
    """
    base = none.base
    priors = problem.layout.priors
    library = _of_library(problem)
    alone = sorted((weigh(base, priors, (g,)) for g in library), key=lambda e: -e.log_odds)
    first = [e.members[0] for e in alone[:SINGLE_COUNT]]
    first += [g for e in search(base, priors, library)[:PART_COUNT] for g in e.members]
    suspects = _suspects(problem, none, alone)
    seeds: list[Seed] = []
    for group in dict.fromkeys([*first, *suspects]):
        linear = weigh(base, priors, (group,)).mean
        beyond = _sizes_beyond_slopes(problem, group)[: None if group in suspects else 1]
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
        joints += _loud_joints(problem, trial, 1)
        joints += plain_partner_joints(problem, trial)
        for group in _of_joints(problem, joints):
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
    sizes = _sizes_beyond_slopes(problem, group)
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
    pairs = [(*trial.members, g) for g in _of_library(problem) if g not in trial.members]
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
        for group in _of_library(problem):
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


def with_shapes(problem: Problem, trials: Sequence[Trial]) -> list[Seen]:
    """The best sets of a trial's effects and a shape of an unheard-of one.

    Shapes are linear in their sizes: there is nothing to simulate.
    """
    groups = problem.layout.groups
    shapes = [g for g in range(len(groups)) if problem.layout.is_unheard(g)]
    found: list[tuple[float, Set, int]] = []
    for place, t in enumerate(trials):
        own = own_evidence(t)
        named = [groups[m] for m in t.members]
        for shape in (g for g in shapes if not _is_form_of(named, groups[g])):
            members = (*t.members, shape)
            weighed = weigh(t.base, t.priors, members)
            log_evidence = t.base.log_evidence + weighed.log_odds
            if log_evidence > own and _of_its_own(t, weighed) > LEAST_OWN_LOG_EVIDENCE:
                found.append((log_evidence, members, place))
    found.sort(key=lambda one: -one[0])
    return [(place, members) for _, members, place in found[:SHAPED_COUNT]]


def _is_form_of(named: Sequence[Group], shape: Group) -> bool:
    """Whether a shape may be what the form of named effects leaves at its joint.

    Nobody knows that of an effect that makes a joint rough. A valve's own metering, of which a dead band and
    a gain are the simplest form, makes its speed grow with the command in another way: beside a dead band of
    0.08 and 0.11 that was 28 ahead of the gain of 0.35 that was there.
    """
    own = {effect for effect, joint in named if joint == shape[1]}
    is_metered = not own.isdisjoint(METERING_EFFECTS) and shape[0] == group_of("command")
    return is_metered or not own.isdisjoint(ROUGH_EFFECTS)


def _of_its_own(trial: Trial, weighed: SetEvidence) -> float:
    """Log evidence that the shape at a set's end tells by what no name explains of it, at its size there."""
    index = trial.priors.groups[weighed.members[-1]]
    size = weighed.mean[-index.size :]
    return 0.5 * float(size @ trial.base.precision[np.ix_(index, index)] @ size)


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
    """The leading sets with one effect's twin in its place (`TWINS`), if they were not simulated."""
    groups = problem.layout.groups
    other = dict(TWINS) | {b: a for a, b in TWINS}
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


def _of_library(problem: Problem) -> list[int]:
    """Groups of effects of the library."""
    return [g for g in range(len(problem.layout.groups)) if not problem.layout.is_unheard(g)]


def _suspects(problem: Problem, none: Trial, alone: Sequence[SetEvidence]) -> list[int]:
    """Groups that could act on joints that are loud, or where slopes show an effect plainly.

    What hides from slopes may drift, too, where a drift shows plainly. The pump, a late IMU and a chassis
    that sways are always looked at: no joint is loud for them, and of a stranger's machine the noise of the
    swing is scaled to what they leave.
    """
    groups = problem.layout.groups
    plain = [groups[e.members[0]] for e in alone if e.log_odds > PLAIN_LOG_ODDS]
    shown = [joint for _, joint in plain if joint is not None]
    loud = _loud_joints(problem, none, LOUD_COUNT)
    joints = list(dict.fromkeys([*shown[:LOUD_COUNT], *loud]))
    drifts = any(effect.startswith(DRIFT) for effect, _ in plain[:LOUD_COUNT])
    hidden = [
        g
        for g, (effect, joint) in enumerate(groups)
        if (joint is None or joint in joints)
        and (drifts or not effect.startswith(DRIFT))
        and _sizes_beyond_slopes(problem, g)
    ]
    return list(dict.fromkeys([*_of_joints(problem, joints), *hidden]))


def _sizes_beyond_slopes(problem: Problem, group: int) -> list[Array]:
    """A typical size and large ones of an effect, or drift, that is unlike a multiple of its slope at 0."""
    priors = problem.layout.priors
    effect = problem.layout.groups[group][0].removeprefix(f"{DRIFT}:").partition(".")[0]
    if effect not in (*WITH_THRESHOLD, *LATE, *SWAYING):
        return []
    typical = priors.slab_sd[priors.groups[group]]
    # Of two directions, one would hide the other.
    far = [FAR_RATIO * typical * way for way in np.eye(typical.size)]
    between = STICTION_BETWEEN_RATIO if effect == "stiction" else BETWEEN_RATIO
    return [typical, *far, *(ratio * typical for ratio in between)]


def _loud_joints(problem: Problem, trial: Trial, count: int) -> list[str]:
    """The driven joints that a trial's set leaves furthest above healthy ones, loudest first."""
    names = [f"actuation.{joint}" for joint in ACTIVE_JOINTS]
    above = _above_healthy(problem, trial, names)
    loud: dict[str, float] = dict(zip(ACTIVE_JOINTS, above, strict=True))
    least = max(LOUD_SD, NEARLY_AS_LOUD_RATIO * max(loud.values(), default=0.0))
    return sorted((j for j in loud if loud[j] >= least), key=lambda j: -loud[j])[:count]


def _above_healthy(problem: Problem, trial: Trial, blocks: Sequence[str]) -> list[float]:
    """Power that a trial's set leaves in blocks, in sd of healthy sets; -inf of what is not there."""
    left, healthy = trial.levels, problem.model.unknown_level
    return [
        (left[name] - healthy[name][0]) / healthy[name][1]
        if name in left and name in healthy
        else -np.inf
        for name in blocks
    ]


def _of_joints(problem: Problem, joints: Collection[str]) -> list[int]:
    """Groups of constant effects at some joints."""
    return [
        g
        for g, (effect, joint) in enumerate(problem.layout.groups)
        if joint in joints and not effect.startswith((DRIFT, UNHEARD))
    ]
