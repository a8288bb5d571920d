"""Hypotheses refined and weighed: linearised where each fits best, and weighed on bootstraps of the throws.

A first linearisation at "no effect" finds candidates; an effect of finite size bends, so each candidate is
simulated again at its own estimate and compared by the evidence that the data then give.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

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
from diagnosis.causes.trials import (
    Trial,
    fair_evidence,
    fitted_effects,
    own_evidence,
    settle,
    try_sets,
)
from diagnosis.causes.whitening import (
    Whitened,
    leftovers,
)
from machine.conventions import ACTIVE_JOINTS, Array
from sim_twin.effects.effect import DRIFT, Effect

BOOTSTRAP_COUNT = 30
SINGLE_COUNT = 6
PART_COUNT = 3
GROWTH = ((3, 6), (2, 3))
"""For pairs, then triples: smaller sets to grow from, and grown sets to simulate."""
WEIGHED_COUNT = 5
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
    none = Trial((), np.zeros(0), problem.whitened, problem.information, priors, at_none)
    found = [none, *_singles(problem, at_none)]
    tick(0.4)
    for size, (behind, kept) in enumerate(GROWTH, start=2):
        fair = fair_evidence(found)
        best = sorted(
            (t for t in found if len(t.members) == size - 1), key=lambda t: -fair[t.members][0]
        )
        leader = max(evidence for evidence, _ in fair.values())
        seeds = _grown(best[:behind], kept, leader - MARGIN_LOG_ODDS)
        if size == 2:
            seeds |= _partners_of_typical_size(problem, best[:PARTNERED_COUNT])
        found += settle(problem, seeds, 2 if size == 2 else 1)
        tick(0.4 + 0.2 * (size - 1))
    fair = fair_evidence(found)
    ranked = sorted(found, key=lambda t: -fair[t.members][0])
    chosen = {t.members: t.sizes for t in ranked[:WEIGHED_COUNT] if t.members}
    # A set must not win because it was simulated nearer to its best size than its own parts were.
    by_members = {t.members: t for t in found}
    for members in list(chosen)[:PART_COUNT]:
        for part in subsets(members):
            if part in by_members and part:
                chosen.setdefault(part, by_members[part].sizes)
    tick(0.9)
    settled = {t.members: t.sizes for t in settle(problem, chosen, 1)}
    weights = bootstrap_weights(len(problem.prepared), BOOTSTRAP_COUNT)
    trials = [none, *try_sets(problem, settled, is_last=True)]
    bases = [_bootstrapped(trial, weights) for trial in trials]
    fair = fair_evidence(trials)
    return [_weighed(problem, trial, bases[fair[trial.members][1]]) for trial in trials]


def _singles(problem: Problem, base: Screen) -> list[Trial]:
    """The most hopeful effects alone, each settled at its own size.

    Seeds are the best by slopes at "no effect", the members of the best sets (alone they may look worse than
    they are), and everything that could act on the loudest joint. Effects with a threshold hardly show in a
    slope at 0, so they also start from a typical size. `base` is the screen at "no effect".
    """
    priors = problem.layout.priors
    first = search(base, priors)
    seeds = [e.members for e in first if len(e.members) == 1][:SINGLE_COUNT]
    seeds += [(g,) for e in first[:PART_COUNT] for g in e.members]
    loud = [(g,) for g in _of_loud_joints(problem, problem.whitened, base.mean, LOUD_COUNT)]
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
    fair = fair_evidence(list(settled.values()))
    best = sorted(settled.values(), key=lambda t: -fair[t.members][0])[:SINGLE_COUNT]
    return try_sets(problem, {t.members: t.sizes for t in best})


def _hides_from_slopes(problem: Problem, group: int) -> bool:
    """Whether an effect of some size looks unlike a multiple of its slope at 0."""
    return problem.layout.groups[group][0] in (*WITH_THRESHOLD, *LATE)


def _partners_of_typical_size(problem: Problem, singles: Sequence[Trial]) -> dict[Set, Array]:
    """Pairs behind singles that leave a joint loud: with every effect there that slopes do not show."""
    priors, seeds = problem.layout.priors, dict[Set, Array]()
    known = {t.members: t.sizes for t in singles if t.members}
    for trial in try_sets(problem, known, is_last=True):
        own, size = trial.members[0], weigh(trial.base, trial.priors, trial.members)
        mean = _mean_with(trial.base, total(trial.information), trial.priors, size)
        for group in _of_loud_joints(problem, trial.whitened, mean, 1):
            if group == own or not _hides_from_slopes(problem, group):
                continue
            sizes = {own: trial.sizes, group: priors.slab_sd[priors.groups[group]]}
            members = tuple(sorted(sizes))
            seeds[members] = np.concatenate([sizes[g] for g in members])
    return seeds


def _of_loud_joints(
    problem: Problem, whitened: Sequence[Whitened], mean: Array, count: int
) -> list[int]:
    """Groups of constant effects at the driven joints furthest above healthy ones, `count` at most.

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
    loud = sorted((j for j in levels if levels[j] >= least), key=lambda j: -levels[j])[:count]
    return [
        g
        for g, (effect, joint) in enumerate(problem.layout.groups)
        if joint in loud and not effect.startswith(DRIFT)
    ]


def _grown(behind: Sequence[Trial], kept: int, least: float) -> dict[Set, Array]:
    """Sets of one more effect, from the linearisation of the smaller set; first sizes of the best ones.

    Sets that promise less evidence than `least` are not worth a simulation.
    """
    weighed: dict[Set, tuple[float, Array]] = {}
    for trial in behind:
        priors, base = trial.priors, trial.base
        for group in range(len(priors.groups)):
            members = tuple(sorted({*trial.members, group}))
            if len(members) == len(trial.members):
                continue
            evidence = weigh(base, priors, members)
            score = base.log_evidence + evidence.log_odds
            if members not in weighed or weighed[members][0] < score:
                weighed[members] = score, evidence.mean
    hopeful = [members for members, (score, _) in weighed.items() if score > least]
    best = sorted(hopeful, key=lambda m: -weighed[m][0])[:kept]
    return {members: weighed[members][1] for members in best}


def _bootstrapped(trial: Trial, weights: Array) -> list[Screen]:
    """A trial on bootstraps of the throws (draws, throws)."""
    return [screen(total(trial.information, w), trial.priors) for w in weights]


def _weighed(problem: Problem, trial: Trial, draws: Sequence[Screen]) -> Hypothesis:
    """A trial's set with its evidence on bootstraps of the trial in which it looks best."""
    priors, members, base = trial.priors, trial.members, trial.base
    data = total(trial.information)
    logs = np.array([b.log_evidence + weigh(b, priors, members).log_odds for b in draws])
    evidence = weigh(base, priors, members)
    mean = _mean_with(base, data, priors, evidence)
    return Hypothesis(
        members=members,
        effects=fitted_effects(problem.layout, members, evidence.mean),
        evidence=evidence,
        log_evidence=logs,
        mean=mean,
        levels=_levels(trial.whitened, mean),
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


def _levels(whitened: Sequence[Whitened], mean: Array) -> dict[str, float]:
    """Log of the residual power per row of every block, after the parameters `mean`, over all throws."""
    power: dict[str, float] = {}
    rows: dict[str, int] = {}
    for one in whitened:
        for name, (square, count) in leftovers(one, mean).items():
            power[name] = power.get(name, 0.0) + square
            rows[name] = rows.get(name, 0) + count
    return {name: float(np.log(power[name] / rows[name])) for name in power if rows[name]}
