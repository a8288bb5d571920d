"""Hypotheses refined and weighed: linearised where each fits best, and weighed on bootstraps of the throws.

A first linearisation at "no effect" finds candidates; an effect of finite size bends, so each candidate is
simulated again at its own estimate and compared by the evidence that the data then give.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from diagnosis.causes.adapt import filters_help, inflated, misfit
from diagnosis.causes.healthy import HealthyModel, nothing
from diagnosis.causes.noise import NoiseModel
from diagnosis.causes.parameters import Layout, Parameter, effects_of, index_of, library
from diagnosis.causes.residuals import Linear, linearise, relinearise
from diagnosis.causes.selection import (
    Information,
    Priors,
    Set,
    SetEvidence,
    bootstrap_weights,
    log_evidence,
    members_index,
    screen,
    search,
    subsets,
    total,
    weigh,
)
from diagnosis.causes.whitening import (
    FORM_ERROR_RATIO,
    Basis,
    Whitened,
    factors,
    information,
    leftovers,
    whiten_throw,
    widened,
)
from diagnosis.loading.prepared import PreparedThrow
from machine.calibration import ValveCalibration
from machine.conventions import ACTIVE_JOINTS, Array, IntArray
from sim_twin.effects.effect import DRIFT, Effect, resolve
from sim_twin.twin.profile import TwinProfile

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
MARGIN_LOG_ODDS = 3.0
"""A grown set must promise to come this close to the best one."""


@dataclass(frozen=True, slots=True)
class Problem:
    """One set of throws against one twin."""

    prepared: Sequence[PreparedThrow]
    profile: TwinProfile
    calibration: ValveCalibration
    healthy: HealthyModel
    model: NoiseModel
    layout: Layout
    factor: Sequence[Sequence[Array]]
    """Of every throw's blocks."""
    linear: Sequence[Linear]
    """At "no effect"."""
    whitened: Sequence[Whitened]
    information: Sequence[Information]

    def basis(self, throw: int) -> Basis:
        """A throw at "no effect", whitened."""
        return Basis(self.linear[throw], self.factor[throw], self.whitened[throw])


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


def pose(
    prepared: Sequence[PreparedThrow],
    profile: TwinProfile,
    calibration: ValveCalibration,
    healthy: HealthyModel,
    model: NoiseModel,
    layout: Layout,
) -> Problem:
    """Linearise at "no effect", with as much of the healthy machines' model as suits this one."""
    linear = linearise(prepared, profile, calibration, healthy)
    if not filters_help(prepared, linear, healthy):
        healthy = nothing()
        linear = linearise(prepared, profile, calibration, healthy)
    first = _whitened(prepared, profile, calibration, healthy, model, layout, linear)
    excess = misfit(first.whitened, layout.priors, model)
    if max(excess.values()) <= 1.0:
        return first
    wider = inflated(model, excess)
    return _whitened(prepared, profile, calibration, healthy, wider, layout, linear)


def _whitened(
    prepared: Sequence[PreparedThrow],
    profile: TwinProfile,
    calibration: ValveCalibration,
    healthy: HealthyModel,
    model: NoiseModel,
    layout: Layout,
    linear: Sequence[Linear],
) -> Problem:
    factor = [factors(p, model) for p in prepared]
    whitened = [
        whiten_throw(p, one, model, f) for p, one, f in zip(prepared, linear, factor, strict=True)
    ]
    return Problem(
        prepared,
        profile,
        calibration,
        healthy,
        model,
        layout,
        factor,
        linear,
        whitened,
        information(whitened),
    )


def explore(problem: Problem, tick: Callable[[float], None]) -> list[Hypothesis]:
    """Grow hypotheses effect by effect, each from a linearisation at the smaller one's best size.

    What bends an effect of finite size looks like a second effect from "no effect", and not from its own
    size; so pairs are looked for behind refined singles, and triples behind refined pairs.
    """
    none = _Trial(
        (),
        np.zeros(0),
        problem.whitened,
        problem.information,
        problem.layout.priors,
    )
    found = [none, *_singles(problem)]
    tick(0.4)
    for size, (behind, kept) in enumerate(GROWTH, start=2):
        best = sorted(
            (t for t in found if len(t.members) == size - 1),
            key=lambda t: -_log_evidence(problem, t),
        )
        leader = max(_log_evidence(problem, t) for t in found)
        seeds = _grown(problem, best[:behind], kept, leader - MARGIN_LOG_ODDS)
        found += _settle(problem, seeds, 2 if size == 2 else 1)
        tick(0.4 + 0.2 * (size - 1))
    ranked = sorted(found, key=lambda t: -_log_evidence(problem, t))
    chosen = {t.members: t.sizes for t in ranked[:WEIGHED_COUNT] if t.members}
    # A set must not win because it was simulated nearer to its best size than its own parts were.
    by_members = {t.members: t for t in found}
    for members in list(chosen)[:PART_COUNT]:
        for part in subsets(members):
            if part in by_members and part:
                chosen.setdefault(part, by_members[part].sizes)
    tick(0.9)
    settled = {t.members: t.sizes for t in _settle(problem, chosen, 1)}
    weights = bootstrap_weights(len(problem.prepared), BOOTSTRAP_COUNT)
    return [
        _weighed(problem, trial, weights)
        for trial in (none, *_round(problem, settled, is_last=True))
    ]


def _singles(problem: Problem) -> list["_Trial"]:
    """The most hopeful effects alone, each settled at its own size.

    Seeds are the best by slopes at "no effect", the members of the best sets (alone they may look worse than
    they are), and everything that could act on the loudest joint. Effects with a threshold hardly show in a
    slope at 0, so they also start from a typical size.
    """
    priors = problem.layout.priors
    base = screen(total(problem.information), priors)
    first = search(base, priors)
    seeds = [e.members for e in first if len(e.members) == 1][:SINGLE_COUNT]
    seeds += [(g,) for e in first[:PART_COUNT] for g in e.members]
    seeds += [(g,) for g in _of_loud_joint(problem, base.mean)]
    linear = {m: weigh(base, priors, m).mean for m in dict.fromkeys(seeds)}
    typical = {
        m: priors.slab_sd[priors.groups[m[0]]]
        for m in linear
        if problem.layout.groups[m[0]][0] in (*WITH_THRESHOLD, *LATE)
    }
    settled: dict[Set, _Trial] = {}
    for start in (linear, typical):
        for trial in _round(problem, start):
            before = settled.get(trial.members)
            if before is None or _log_evidence(problem, before) < _log_evidence(problem, trial):
                settled[trial.members] = trial
    best = sorted(settled.values(), key=lambda t: -_log_evidence(problem, t))[:SINGLE_COUNT]
    return _round(problem, {t.members: t.sizes for t in best})


def _of_loud_joint(problem: Problem, mean: Array) -> list[int]:
    """Groups of constant effects at the driven joint that is furthest above a healthy one, if one is."""
    power: dict[str, tuple[float, int]] = {}
    for whitened in problem.whitened:
        for name, (square, count) in leftovers(whitened, mean).items():
            before = power.get(name, (0.0, 0))
            power[name] = before[0] + square, before[1] + count
    levels = {
        joint: (np.log(power[name][0] / power[name][1]) - healthy[0]) / healthy[1]
        for joint in ACTIVE_JOINTS
        if (name := f"actuation.{joint}") in power
        and (healthy := problem.model.unknown_level.get(name)) is not None
    }
    loud = max(levels, key=lambda joint: levels[joint], default=None)
    if loud is None or levels[loud] < LOUD_SD:
        return []
    return [
        g
        for g, (effect, joint) in enumerate(problem.layout.groups)
        if joint == loud and not effect.startswith(DRIFT)
    ]


def _grown(
    problem: Problem, behind: Sequence["_Trial"], kept: int, least: float
) -> dict[Set, Array]:
    """Sets of one more effect, from the linearisation of the smaller set; first sizes of the best ones.

    Sets that promise less evidence than `least` are not worth a simulation.
    """
    weighed: dict[Set, tuple[float, Array]] = {}
    for trial in behind:
        priors = trial.priors
        base = screen(total(trial.information), priors)
        offset = _log_evidence(problem, trial) - weigh(base, priors, trial.members).log_odds
        for group in range(len(priors.groups)):
            members = tuple(sorted({*trial.members, group}))
            if len(members) == len(trial.members):
                continue
            evidence = weigh(base, priors, members)
            score = evidence.log_odds + offset
            if members not in weighed or weighed[members][0] < score:
                weighed[members] = score, evidence.mean
    hopeful = [members for members, (score, _) in weighed.items() if score > least]
    best = sorted(hopeful, key=lambda m: -weighed[m][0])[:kept]
    return {members: weighed[members][1] for members in best}


def _settle(problem: Problem, seeds: dict[Set, Array], rounds: int) -> list["_Trial"]:
    """Simulate and estimate again, some rounds."""
    sizes = dict(seeds)
    trials: list[_Trial] = []
    for _ in range(rounds):
        trials = _round(problem, sizes)
        sizes = {t.members: t.sizes for t in trials}
    return trials


def _log_evidence(problem: Problem, trial: "_Trial") -> float:
    return log_evidence(total(trial.information), trial.priors, trial.members)


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    members: Set
    sizes: Array
    """Of the members' parameters."""
    whitened: Sequence[Whitened]
    """Kept in the last round only: it is large."""
    information: Sequence[Information]
    priors: Priors


def _formed(priors: Priors, data: Information, members: Set, sizes: Array) -> Priors:
    """Spikes under a hypothesis: what other parameters can make of its effects' form error.

    A real effect is never quite the library's, in the same way in every throw. Where another parameter's
    slopes lie along the hypothesis' signal, a share of that signal may look like it.
    """
    index = members_index(priors, members)
    precision = data.precision
    signal = np.sqrt(max(float(sizes @ precision[np.ix_(index, index)] @ sizes), 0.0))
    own = np.sqrt(np.maximum(np.diag(precision), 1e-12))
    along = np.abs(precision[:, index] @ sizes) / (own * max(signal, 1e-12))
    along[index] = 0.0
    extra = _form_error_ratio(index) * signal * along / own
    return priors._replace(spike_sd=np.hypot(priors.spike_sd, extra))


def _form_error_ratio(index: IntArray) -> float:
    """Of a hypothesis with these parameters: the same in every throw, as far as anybody knows."""
    constants = library()
    stages = {constants[int(i) % len(constants)].stage for i in index if i < 2 * len(constants)}
    return FORM_ERROR_RATIO["actuation" if "actuation" in stages else "swing"]


def _round(problem: Problem, seeds: dict[Set, Array], *, is_last: bool = False) -> list[_Trial]:
    """Simulate every set at its sizes, in one batch, and estimate the sizes again."""
    if not seeds:
        return []
    effects = [fitted_effects(problem.layout, m, sizes) for m, sizes in seeds.items()]
    only = [_constants(problem.layout, members) for members in seeds]
    batch = relinearise(
        problem.prepared,
        problem.profile,
        problem.calibration,
        problem.healthy,
        problem.linear,
        list(zip(effects, only, strict=True)),
    )
    return [
        _estimated(problem, members, found, linear, is_last=is_last)
        for members, found, linear in zip(seeds, effects, batch, strict=True)
    ]


def _estimated(
    problem: Problem,
    members: Set,
    effects: Sequence[Effect],
    at: Sequence[Linear],
    *,
    is_last: bool,
) -> _Trial:
    kept: list[Whitened] = []
    informations: list[Information] = []
    for i, p in enumerate(problem.prepared):
        change = problem.linear[i].residual - at[i].residual
        linear = _carried(at[i], effects, p.input.progress_ratio)
        factor = widened(p, problem.model, problem.factor[i], change, effects)
        whitened = whiten_throw(p, linear, problem.model, factor, problem.basis(i))
        informations += information([whitened])
        if is_last:
            kept.append(whitened)
    data = total(informations)
    start = np.array([v for e in effects for v in _sizes_of(e)])
    priors = _formed(problem.layout.priors, data, members, start)
    sizes = weigh(screen(data, priors), priors, members).mean
    return _Trial(members, sizes, kept, informations, priors)


def _sizes_of(effect: Effect) -> list[float]:
    """Sizes of an effect in the order of the vector."""
    if effect.effect == DRIFT:
        return list(effect.parameters.values())
    return [
        effect.parameters.get(p.name, 0.0)
        for p in library()
        if p.group == (effect.effect, effect.joint)
    ]


def _carried(at: Linear, effects: Sequence[Effect], progress_ratio: float) -> Linear:
    """Carry the residual back to size 0 along the slopes at the size."""
    keys = index_of()
    sizes = _acting_sizes(effects, progress_ratio)
    residual = at.residual.copy()
    for key, size in sizes.items():
        residual += at.jacobian[:, keys[key]] * size
    return replace(at, residual=residual)


def _acting_sizes(effects: Sequence[Effect], progress_ratio: float) -> dict[str, float]:
    """Size by parameter key that acts in one throw, drifts carried out."""
    return {
        ".".join(part for part in key if part is not None): size
        for key, size in resolve(effects, progress_ratio).items()
    }


def _constants(layout: Layout, members: Set) -> list[Parameter]:
    """Parameters whose slopes a hypothesis needs; a drift needs those of what drifts."""
    index = members_index(layout.priors, members)
    places = sorted({int(i) % layout.parameter_count for i in index})
    return [library()[i] for i in places]


def fitted_effects(layout: Layout, members: Set, sizes: Array) -> tuple[Effect, ...]:
    """A hypothesis at sizes (of its parameters, group after group) as effects of the library."""
    effects: list[Effect] = []
    at = 0
    for group in members:
        width = layout.priors.groups[group].size
        effects.append(effects_of(layout, group, sizes[at : at + width]))
        at += width
    return tuple(effects)


def _weighed(problem: Problem, trial: _Trial, weights: Array) -> Hypothesis:
    priors, members = trial.priors, trial.members
    logs = np.array([log_evidence(total(trial.information, w), priors, members) for w in weights])
    base = screen(total(trial.information), priors)
    evidence = weigh(base, priors, members)
    mean = _conditional_mean(base.mean, base.covariance, priors, evidence)
    return Hypothesis(
        members=members,
        effects=fitted_effects(problem.layout, members, evidence.mean),
        evidence=evidence,
        log_evidence=logs,
        mean=mean,
        levels=_levels(trial.whitened, mean),
        information=trial.information,
    )


def _conditional_mean(mean: Array, covariance: Array, priors: Priors, found: SetEvidence) -> Array:
    """Posterior mean of all parameters given that the members are at their own posterior mean."""
    if not found.members:
        return mean
    index = members_index(priors, found.members)
    block = covariance[np.ix_(index, index)]
    return mean + covariance[:, index] @ np.linalg.solve(block, found.mean - mean[index])


def _levels(whitened: Sequence[Whitened], mean: Array) -> dict[str, float]:
    """Log of the residual power per row of every block, after the parameters `mean`, over all throws."""
    power: dict[str, float] = {}
    rows: dict[str, int] = {}
    for one in whitened:
        for name, (square, count) in leftovers(one, mean).items():
            power[name] = power.get(name, 0.0) + square
            rows[name] = rows.get(name, 0) + count
    return {name: float(np.log(power[name] / rows[name])) for name in power if rows[name]}
