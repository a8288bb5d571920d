"""Hypotheses refined and weighed: linearised where each fits best, and weighed on bootstraps of the throws.

A first linearisation at "no effect" finds candidates; an effect of finite size bends, so each candidate is
simulated again at its own estimate and compared by the evidence that the data then give.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.causes.parameters import ROUGH_EFFECTS
from diagnosis.causes.problem import Problem
from diagnosis.causes.selection import (
    Information,
    Priors,
    Screen,
    Set,
    SetEvidence,
    bootstrap_weights,
    members_index,
    screen,
    search,
    subsets,
    total,
    weigh,
)
from diagnosis.causes.shapes import UNHEARD
from diagnosis.causes.trials import (
    Seen,
    Trial,
    again,
    evidence_in,
    fair_evidence,
    fair_on_all,
    fitted_effects,
    kept_at,
    own_evidence,
    screens,
    settle,
    try_sets,
)
from diagnosis.causes.whitening import (
    Whitened,
    leftovers,
    rough_blocks,
)
from machine.conventions import ACTIVE_JOINTS, Array
from sim_twin.effects.effect import DRIFT, Effect

BOOTSTRAP_COUNT = 30
SINGLE_COUNT = 6
PART_COUNT = 3
GROWTH = ((3, 6), (2, 3))
"""For pairs, then triples: smaller sets to grow from, and grown sets to simulate."""
WEIGHED_COUNT = 5
SHAPED_COUNT = 5
"""Sets with a shape that are weighed."""
LOUD_SD = 3.0
"""A joint's leftover power that calls for a look at everything that could act on it."""
WITH_THRESHOLD = ("valve_dead_band", "valve_hysteresis", "speed_limit", "backlash", "stiction")
LATE = ("valve_dead_time", "valve_lag", "joint_sensor_latency")
"""A large delay is no multiple of a small one's slope: these, too, start from a typical size."""
FAR_RATIO = 3.0
"""At a loud joint also from this multiple of it: from 0.05 s the estimate of a latency of 0.135 s moves on by
0.012 s a simulation only, and from 0.068 rad/s that of a breakaway speed of 0.135 rad/s by 0.006 rad/s."""
LOUD_COUNT = 2
NEARLY_AS_LOUD_RATIO = 0.5
"""A joint that a neighbour shakes may be louder than the neighbour (0.6 with a late dipper sensor)."""
PARTNERED_COUNT = 2
"""Singles whose joint, if they leave it loud, is searched for a second effect that no slope shows."""
MARGIN_LOG_ODDS = 3.0
"""A grown set must promise to come this close to the best one."""


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """A set of effects at its best size."""

    members: Set
    effects: tuple[Effect, ...]
    evidence: SetEvidence
    log_evidence: Array
    """(draws,) on each bootstrap of the throws; the first is the data themselves."""
    mean: Array
    """Posterior of the whole vector of the layout, scatter of the other parameters included."""
    levels: Mapping[str, float]
    """By block: log of the residual power per row that is left over all throws."""
    information: Sequence[Information]
    """Of the whole vector, linearised at the hypothesis."""


def explore(problem: Problem, tick: Callable[[float], None]) -> list[Hypothesis]:
    """Grow hypotheses effect by effect, each from a linearisation at the smaller one's best size.

    What bends an effect of finite size looks like a second effect from "no effect", and not from its own
    size; so pairs are looked for behind refined singles, and triples behind refined pairs.
    """
    priors = problem.layout.priors
    at_none = screen(total(problem.information), priors)
    none = Trial(
        members=(),
        at=np.zeros(0),
        sizes=np.zeros(0),
        whitened=problem.whitened,
        information=problem.information,
        priors=priors,
        plain=priors,
        base=at_none,
    )
    found = [none, *_singles(problem, at_none)]
    tick(0.4)
    for size, (behind, kept) in enumerate(GROWTH, start=2):
        fair = fair_on_all(found)
        ordered = [found[i] for i in np.argsort(fair)[::-1]]
        best = [t for t in ordered if len(t.members) == size - 1]
        seeds = _grown(problem, best[:behind], kept, max(fair) - MARGIN_LOG_ODDS)
        if size == 2:
            seeds |= _partners_of_typical_size(problem, best[:PARTNERED_COUNT])
        found += settle(problem, seeds, 2 if size == 2 else 1)
        tick(0.4 + 0.2 * (size - 1))
    ranked = [found[i] for i in np.argsort(fair_on_all(found))[::-1]]
    chosen = again(problem, [t for t in ranked[:WEIGHED_COUNT] if t.members])
    # A set must not win because it was simulated nearer to its best size than its own parts were.
    by_members = {t.members: t for t in found}
    for members in list(chosen)[:PART_COUNT]:
        for part in subsets(members):
            if part in by_members and part:
                chosen = again(problem, [by_members[part]]) | chosen
    tick(0.9)
    settled = again(problem, settle(problem, chosen, 1))
    weights = bootstrap_weights(len(problem.prepared), BOOTSTRAP_COUNT)
    trials = [none, *try_sets(problem, settled, is_last=True)]
    seen = [*((i, t.members) for i, t in enumerate(trials)), *_with_shapes(problem, trials)]
    logs = np.array(
        [
            fair_evidence(trials, seen, [screens(t, total(t.information, w)) for t in trials])
            for w in weights
        ]
    )
    return [_weighed(problem, trials[i], m, logs[:, k]) for k, (i, m) in enumerate(seen)]


def _with_shapes(problem: Problem, trials: Sequence[Trial]) -> list[Seen]:
    """The best sets of a trial's effects and a shape of an unheard-of one.

    Shapes are linear in their sizes: there is nothing to simulate. Where an effect makes a joint rough,
    nobody knows the form of what it leaves.
    """
    groups = problem.layout.groups
    shapes = [g for g in range(len(groups)) if problem.layout.is_unheard(g)]
    found: list[tuple[float, Set, int]] = []
    for place, t in enumerate(trials):
        own = own_evidence(t)
        rough = {groups[m][1] for m in t.members if groups[m][0] in ROUGH_EFFECTS}
        for shape in (g for g in shapes if groups[g][1] not in rough):
            members = (*t.members, shape)
            log_evidence = evidence_in(t.base, t.priors, members)
            if log_evidence > own:
                found.append((log_evidence, members, place))
    found.sort(key=lambda one: -one[0])
    return [(place, members) for _, members, place in found[:SHAPED_COUNT]]


def _of_library(problem: Problem) -> list[int]:
    """Groups of effects of the library."""
    return [g for g in range(len(problem.layout.groups)) if not problem.layout.is_unheard(g)]


def _singles(problem: Problem, base: Screen) -> list[Trial]:
    """The most hopeful effects alone, each settled at its own size.

    Seeds are the best by slopes at "no effect", the members of the best sets (alone they may look worse than
    they are), and everything that could act on the loudest joint. Effects with a threshold hardly show in a
    slope at 0, so they also start from a typical size. `base` is the screen at "no effect".
    """
    priors = problem.layout.priors
    first = search(base, priors, _of_library(problem))
    seeds = [e.members for e in first if len(e.members) == 1][:SINGLE_COUNT]
    seeds += [(g,) for e in first[:PART_COUNT] for g in e.members]
    joints = _loud_joints(problem, problem.whitened, base.mean, LOUD_COUNT)
    loud = [(g,) for g in _of_joints(problem, joints)]
    linear = {m: weigh(base, priors, m).mean for m in dict.fromkeys([*seeds, *loud])}
    typical = {
        m: priors.slab_sd[priors.groups[m[0]]] for m in linear if _hides_from_slopes(problem, m[0])
    }
    far = {m: FAR_RATIO * typical[m] for m in loud if m in typical}
    settled: dict[Set, Trial] = {}
    for start in (linear, typical, far):
        for trial in try_sets(problem, start):
            before = settled.get(trial.members)
            if before is None or own_evidence(before) < own_evidence(trial):
                settled[trial.members] = trial
    trials = list(settled.values())
    best = [trials[i] for i in np.argsort(fair_on_all(trials))[::-1][:SINGLE_COUNT]]
    return try_sets(problem, again(problem, best))


def _hides_from_slopes(problem: Problem, group: int) -> bool:
    """Whether an effect of some size looks unlike a multiple of its slope at 0."""
    return problem.layout.groups[group][0] in (*WITH_THRESHOLD, *LATE)


def _partners_of_typical_size(problem: Problem, singles: Sequence[Trial]) -> dict[Set, Array]:
    """Pairs behind singles that leave a joint loud, or with a shape: with all that slopes do not show."""
    priors, seeds = problem.layout.priors, dict[Set, Array]()
    known = again(problem, [t for t in singles if t.members])
    for trial in try_sets(problem, known, is_last=True):
        own, size = trial.members[0], weigh(trial.base, trial.priors, trial.members)
        mean = _mean_with(trial.base, total(trial.information), trial.priors, size)
        joints = _loud_joints(problem, trial.whitened, mean, 1)
        joints += [problem.layout.groups[m[-1]][1] or "" for _, m in _with_shapes(problem, [trial])]
        for group in _of_joints(problem, joints):
            if group == own or not _hides_from_slopes(problem, group):
                continue
            sizes = {own: trial.sizes, group: priors.slab_sd[priors.groups[group]]}
            members = tuple(sorted(sizes))
            seeds[members] = np.concatenate([sizes[g] for g in members])
    return seeds


def _loud_joints(
    problem: Problem, whitened: Sequence[Whitened], mean: Array, count: int
) -> list[str]:
    """The driven joints that are furthest above healthy ones, `count` at most, loudest first.

    Judged by what the parameters `mean` leave of the whitened throws.
    """
    left = _levels(whitened, mean)
    levels = {
        joint: (left[name] - healthy[0]) / healthy[1]
        for joint in ACTIVE_JOINTS
        if (name := f"actuation.{joint}") in left
        and (healthy := problem.model.unknown_level.get(name)) is not None
    }
    least = max(LOUD_SD, NEARLY_AS_LOUD_RATIO * max(levels.values(), default=0.0))
    return sorted((j for j in levels if levels[j] >= least), key=lambda j: -levels[j])[:count]


def _of_joints(problem: Problem, joints: Collection[str]) -> list[int]:
    """Groups of constant effects at some joints."""
    return [
        g
        for g, (effect, joint) in enumerate(problem.layout.groups)
        if joint in joints and not effect.startswith((DRIFT, UNHEARD))
    ]


def _grown(problem: Problem, behind: Sequence[Trial], kept: int, least: float) -> dict[Set, Array]:
    """Sets of one more effect, from the linearisation of the smaller set; first sizes of the best ones.

    Sets that promise less evidence than `least` are not worth a simulation.
    """
    weighed: dict[Set, tuple[float, Array]] = {}
    for trial in behind:
        priors, base = trial.priors, trial.base
        for group in _of_library(problem):
            members = tuple(sorted({*trial.members, group}))
            if len(members) == len(trial.members):
                continue
            evidence = weigh(base, priors, members)
            score = base.log_evidence + evidence.log_odds
            if members not in weighed or weighed[members][0] < score:
                weighed[members] = score, kept_at(problem, trial, members, evidence.mean)
    hopeful = [members for members, (score, _) in weighed.items() if score > least]
    best = sorted(hopeful, key=lambda m: -weighed[m][0])[:kept]
    return {members: weighed[members][1] for members in best}


def _weighed(problem: Problem, trial: Trial, members: Set, logs: Array) -> Hypothesis:
    """A set as the trial sees it, with its log evidence (draws,) on bootstraps of the throws."""
    priors, base = trial.priors, trial.base
    data = total(trial.information)
    evidence = weigh(base, priors, members)
    mean = _mean_with(base, data, priors, evidence)
    effects = fitted_effects(problem.layout, members, evidence.mean)
    return Hypothesis(
        members=members,
        effects=effects,
        evidence=evidence,
        log_evidence=logs,
        mean=mean,
        levels=_levels(trial.whitened, mean, rough_blocks(effects)),
        information=trial.information,
    )


def _mean_with(base: Screen, data: Information, priors: Priors, found: SetEvidence) -> Array:
    """Posterior mean of all parameters: members at their sizes, and the scatter that the data then want."""
    if not found.members:
        return base.mean
    index = members_index(priors, found.members)
    mean = base.mean - base.covariance @ (data.precision[:, index] @ found.mean)
    mean[index] += found.mean
    return mean


def _levels(
    whitened: Sequence[Whitened], mean: Array, rough: Collection[str] = ()
) -> dict[str, float]:
    """Log of the residual power per row of every block, after the parameters `mean`, over all throws."""
    power: dict[str, float] = {}
    rows: dict[str, int] = {}
    for one in whitened:
        for name, (square, count) in leftovers(one, mean, rough).items():
            power[name] = power.get(name, 0.0) + square
            rows[name] = rows.get(name, 0) + count
    return {name: float(np.log(power[name] / rows[name])) for name in power if rows[name]}
