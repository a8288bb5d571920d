"""Sets of effects tried out: simulated at some sizes, linearised there, and estimated again.

An effect of finite size bends; so a set is judged about its own sizes, and others about theirs.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from diagnosis.causes.parameters import (
    ROUGH_EFFECTS,
    Layout,
    Parameter,
    effects_of,
    index_of,
    library,
)
from diagnosis.causes.problem import Problem
from diagnosis.causes.residuals import Linear, relinearise
from diagnosis.causes.selection import (
    Information,
    Priors,
    Screen,
    Set,
    bare,
    members_index,
    screen,
    total,
    weigh,
)
from diagnosis.causes.whitening import (
    FORM_ERROR_RATIO,
    Whitened,
    information,
    rough_blocks,
    whiten_throw,
    widened,
)
from machine.conventions import Array
from sim_twin.effects.effect import DRIFT, Effect, resolve

BENT_EFFECTS = (*ROUGH_EFFECTS, "valve_hysteresis")
"""Joints stand, or valves hang in their play, for a time that grows with the size in jumps."""
MOST_STEPS_COUNT = 3
"""Simulations of a bent effect that may follow each other in search of its size."""
BATCH_COUNT = 10
"""Sets simulated side by side: 12 throws with the slopes of 30 sets took 1.7 GiB."""


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A set of effects, linearised at its sizes."""

    members: Set
    at: Array
    """Sizes of the members' parameters in the simulation."""
    sizes: Array
    """As estimated there."""
    whitened: Sequence[Whitened]
    """Kept in the last round only: it is large."""
    information: Sequence[Information]
    priors: Priors
    """With the form error of the members."""
    plain: Priors
    """Without it."""
    base: Screen
    """On all throws."""
    bent: Set = ()
    """Members whose slopes at their sizes are no guide to other sizes."""


def _formed(priors: Priors, data: Information, members: Set, sizes: Array) -> Priors:
    """Spikes under a hypothesis: what other parameters can make of its effects' form error.

    A real effect is never quite the library's, in the same way in every throw. Where another parameter's
    slopes lie along the effects' signal, a share of that signal may look like it.

    Args:
        priors: without form error.
        data: on all throws.
        members: the hypothesis.
        sizes: of its parameters, group after group.
    """
    index = members_index(priors, members)
    own = np.sqrt(np.maximum(np.diag(data.precision), 1e-12))
    ratio = np.array([_form_error_ratio(int(i)) for i in index])
    # Effects of one ratio are off as a whole: alike ones may be large against each other.
    extra = [
        r * np.abs(data.precision[:, index[ratio == r]] @ sizes[ratio == r]) / own**2
        for r in np.unique(ratio)
    ]
    variance = np.sum(np.square(extra), axis=0)
    variance[index] = 0.0
    return priors._replace(scatter=priors.scatter + np.diag(variance))


def _form_error_ratio(place: int) -> float:
    """Of a parameter of the layout: the same in every throw, as far as anybody knows."""
    stage = library()[place % len(library())].stage
    return FORM_ERROR_RATIO["actuation" if stage == "actuation" else "swing"]


Seed = tuple[Set, Array]
"""A set, and the sizes at which it is to be simulated."""


def try_sets(
    problem: Problem, seeds: Mapping[Set, Array] | Sequence[Seed], *, is_last: bool = False
) -> list[Trial]:
    """Simulate every set at its sizes, in batches, and estimate the sizes again."""
    waiting = list(seeds.items()) if isinstance(seeds, Mapping) else list(seeds)
    found: list[Trial] = []
    for first in range(0, len(waiting), BATCH_COUNT):
        found += _try_batch(problem, waiting[first : first + BATCH_COUNT], is_last=is_last)
    return found


def _try_batch(
    problem: Problem, seeds: Sequence[tuple[Set, Array]], *, is_last: bool
) -> list[Trial]:
    effects = [fitted_effects(problem.layout, members, sizes) for members, sizes in seeds]
    only = [_constants(problem.layout, members) for members, _ in seeds]
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
        for (members, _), found, linear in zip(seeds, effects, batch, strict=True)
    ]


def _estimated(
    problem: Problem,
    members: Set,
    effects: Sequence[Effect],
    at: Sequence[Linear],
    *,
    is_last: bool,
) -> Trial:
    """The set's trial; effects that may shake other joints do if that tells them better from no effect."""
    rough = rough_blocks(effects)
    trials = [
        _with_form(problem, members, effects, at, blocks, is_last=is_last)
        for blocks in ([(), rough] if rough else [()])
    ]
    return trials[0] if len(trials) == 1 else max(trials, key=_lead)


def is_ahead(trial: Trial) -> bool:
    """Whether a trial's set beats no effect in the trial itself."""
    return _lead(trial) > 0.0


def _lead(trial: Trial) -> float:
    """Log odds of a trial's set over no effect in its own noise."""
    own, without = screens(trial, total(trial.information))
    return evidence_in(own, trial.priors, trial.members) - without.log_evidence


def _with_form(
    problem: Problem,
    members: Set,
    effects: Sequence[Effect],
    at: Sequence[Linear],
    rough: Collection[str],
    *,
    is_last: bool,
) -> Trial:
    kept: list[Whitened] = []
    informations: list[Information] = []
    for i, p in enumerate(problem.prepared):
        linear = _carried(at[i], effects, p.input.progress_ratio)
        factor = problem.factor[i]
        if rough:
            factor = widened(
                p, problem.model, problem.plain[i], problem.off[i], linear.change, rough
            )
        whitened = whiten_throw(p, linear, problem.model, factor, problem.basis(i))
        informations += information([whitened])
        if is_last:
            kept.append(whitened)
    data = total(informations)
    start = np.array([v for e in effects for v in _sizes_of(e)])
    priors = _formed(problem.layout.priors, data, members, start)
    base = screen(data, priors)
    mean = weigh(base, priors, members).mean
    bent = tuple(m for m in members if problem.layout.groups[m][0] in BENT_EFFECTS)
    return Trial(
        members, start, mean, kept, informations, priors, problem.layout.priors, base, bent
    )


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
    # Shapes of the unheard-of are no effects: there is nothing to simulate.
    return tuple(
        effects_of(layout, group, own)
        for group, own in by_member(layout.priors, members, sizes).items()
        if not layout.is_unheard(group)
    )


def settle(problem: Problem, seeds: Mapping[Set, Array], rounds: int) -> list[Trial]:
    """Simulate and estimate again, some rounds."""
    found = try_sets(problem, seeds)
    for _ in range(rounds - 1):
        found = refined(problem, found)
    return found


def refined(problem: Problem, trials: Sequence[Trial]) -> list[Trial]:
    """Simulated once more, at their estimates; of sets with bent effects the better trial counts."""
    found = try_sets(problem, {t.members: t.sizes for t in trials})
    return [
        old if old.bent and own_evidence(old) > own_evidence(new) else new
        for old, new in zip(trials, found, strict=True)
    ]


def nearer(problem: Problem, trials: Sequence[Trial]) -> list[Trial]:
    """Trials; once more, where the estimate is further than its uncertainty from what was simulated.

    Slopes of bent effects are no guide: those are simulated again as long as that tells them better. Behind
    the best play of a telescope alone a lag beside it came out 3 behind the play alone; with the play at
    0.034 m (it was 0.035 m) it is 270 ahead.
    """
    found = {t.members: t for t in trials}
    moved = [t for t in trials if t.bent or not _is_near(t)]
    for _ in range(MOST_STEPS_COUNT):
        tried = refined(problem, moved)
        moved = [t for t, old in zip(tried, moved, strict=True) if t.bent and t is not old]
        found |= {t.members: t for t in tried}
        if not moved:
            break
    return [found[t.members] for t in trials]


def _is_near(trial: Trial) -> bool:
    variance = np.diag(weigh(trial.base, trial.priors, trial.members).covariance)
    return bool(np.all(np.square(trial.sizes - trial.at) <= variance))


def best_of_each(trials: Sequence[Trial]) -> list[Trial]:
    """Of trials of the same set from different sizes the best."""
    found: dict[Set, Trial] = {}
    for trial in trials:
        before = found.get(trial.members)
        if before is None or own_evidence(before) < own_evidence(trial):
            found[trial.members] = trial
    return list(found.values())


def again(trials: Sequence[Trial]) -> dict[Set, Array]:
    """Where to simulate trials once more: at their estimates, but bent effects where they were.

    Slopes by a size at which a joint breaks loose are no guide: with the noise of a version on the way they
    led from 0.05 m/s (499 ahead) in three steps to 0.027 m/s (238), where a telescope broke loose at 0.066;
    and a valve's play from 0.17 (1202 ahead) to 0.07 (404), where it was 0.18.
    """
    return {t.members: t.at if t.bent else t.sizes for t in trials}


def kept_at(trial: Trial, members: Set, sizes: Array) -> Array:
    """Sizes for a larger set, group after group: bent effects of the trial stay where they were."""
    own = by_member(trial.plain, trial.members, trial.at)
    return np.concatenate(
        [
            own[m] if m in trial.bent else part
            for m, part in by_member(trial.plain, members, sizes).items()
        ]
    )


def by_member(priors: Priors, members: Set, sizes: Array) -> dict[int, Array]:
    """Sizes of every group of a set."""
    found: dict[int, Array] = {}
    at = 0
    for member in members:
        width = priors.groups[member].size
        found[member] = sizes[at : at + width]
        at += width
    return found


Seen = tuple[int, Set]
"""The place of a trial, and a set as that trial sees it."""


def fair_evidence(
    trials: Sequence[Trial], seen: Sequence[Seen], data: Sequence[Information]
) -> Array:
    """Log evidence (sets,) of sets, each in its trial, so that noise and slopes are evidence for nobody.

    About another size slopes and noise are others. A set counts if it beats "no effect" in its own trial;
    others lie as far below "no effect" as they do there. "No effect", and every other part of the set that
    leads, may also have the leader's trial.

    Args:
        trials: simulated sets.
        seen: the sets, "no effect" among them; more than one may be of a trial.
        data: what all throws, or a bootstrap of them, say in each of the trials.
    """
    bases = [screens(t, d) for t, d in zip(trials, data, strict=True)]
    own = np.array([evidence_in(bases[i][0], trials[i].priors, m) for i, m in seen])
    without = np.array([bases[i][1].log_evidence for i, _ in seen])
    is_none = np.array([not m for _, m in seen])
    counts = (own > without) & ~is_none
    none = float(own[is_none].max()) if is_none.any() else float(without.min())
    if not counts.any():
        return np.where(is_none, none, none + own - without)
    leader = int(np.argmax(np.where(counts, own, -np.inf)))
    place, members = seen[leader]
    none = max(none, float(without[leader]))
    found = np.where(is_none, none, np.where(counts, own, none + own - without))
    for k, (_, part) in enumerate(seen):
        # Slopes do not carry a bent effect back to where it is not.
        if part and set(part) < set(members) and set(trials[place].bent) <= set(part):
            base = _base_of_part(trials[place], data[place], part)
            found[k] = max(found[k], evidence_in(base, trials[place].plain, part))
    return found


def fair_on_all(trials: Sequence[Trial]) -> list[float]:
    """Fair evidence of every trial's own set, on all throws."""
    seen = [(i, t.members) for i, t in enumerate(trials)]
    return fair_evidence(trials, seen, [total(t.information) for t in trials]).tolist()


def screens(trial: Trial, data: Information) -> tuple[Screen, Screen]:
    """A trial's screens of these data (all throws or a bootstrap): with its effects, and without them.

    Where its effects are not, neither is their form error.
    """
    return screen(data, trial.priors), screen(bare(data), trial.plain)


def _base_of_part(trial: Trial, data: Information, part: Set) -> Screen:
    """A trial's screen for a part of its set: nothing may look like effects that the part does not have."""
    sizes = by_member(trial.plain, trial.members, trial.at)
    own = {m: size for m, size in sizes.items() if m in part}
    if not own:
        return screen(bare(data), trial.plain)
    kept = np.concatenate(list(own.values()))
    return screen(data, _formed(trial.plain, total(trial.information), tuple(own), kept))


def evidence_in(base: Screen, priors: Priors, members: Set) -> float:
    """Log evidence of a set in a trial's screen."""
    return base.log_evidence + weigh(base, priors, members).log_odds


def own_evidence(trial: Trial) -> float:
    """Log evidence of a trial's set in the trial itself."""
    return evidence_in(trial.base, trial.priors, trial.members)
