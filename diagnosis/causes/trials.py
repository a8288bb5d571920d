"""Sets of effects tried out: simulated at some sizes, linearised there, and estimated again.

An effect of finite size bends; so a set is judged about its own sizes, and others about theirs.
"""

from collections.abc import Collection, Sequence
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
from machine.conventions import Array, IntArray
from sim_twin.effects.effect import DRIFT, Effect, resolve

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
    return priors._replace(scatter=priors.scatter + np.diag(extra**2))


def _form_error_ratio(index: IntArray) -> float:
    """Of a hypothesis with these parameters: the same in every throw, as far as anybody knows."""
    constants = library()
    stages = {constants[int(i) % len(constants)].stage for i in index}
    return FORM_ERROR_RATIO["actuation" if "actuation" in stages else "swing"]


def try_sets(problem: Problem, seeds: dict[Set, Array], *, is_last: bool = False) -> list[Trial]:
    """Simulate every set at its sizes, in batches, and estimate the sizes again."""
    waiting = list(seeds.items())
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
    return Trial(members, start, mean, kept, informations, priors, problem.layout.priors, base)


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
        # Shapes of the unheard-of are no effects: there is nothing to simulate.
        if not layout.is_unheard(group):
            effects.append(effects_of(layout, group, sizes[at : at + width]))
        at += width
    return tuple(effects)


def settle(problem: Problem, seeds: dict[Set, Array], rounds: int) -> list[Trial]:
    """Simulate and estimate again, some rounds; of sets with rough effects the best round counts."""
    sizes = dict(seeds)
    found: dict[Set, Trial] = {}
    for _ in range(rounds):
        for t in try_sets(problem, sizes):
            before = found.get(t.members)
            is_worse = before is not None and own_evidence(t) < own_evidence(before)
            if not (is_worse and is_rough(problem, t.members)):
                found[t.members] = t
        sizes = {members: t.sizes for members, t in found.items()}
    return list(found.values())


def again(problem: Problem, trials: Sequence[Trial]) -> dict[Set, Array]:
    """Where to simulate trials once more: at their estimates, but rough effects where they were.

    Slopes by a size at which a joint breaks loose are no guide: with the noise of a version on the way they
    led from 0.05 m/s (499 ahead) in three steps to 0.027 m/s (238), where a telescope broke loose at 0.066.
    """
    return {t.members: t.at if is_rough(problem, t.members) else t.sizes for t in trials}


def kept_at(problem: Problem, trial: Trial, members: Set, sizes: Array) -> Array:
    """Sizes for a larger set, group after group: rough effects of the trial stay where they were."""
    places = problem.layout.priors.groups
    parts = np.split(sizes, np.cumsum([places[m].size for m in members])[:-1])
    own = np.split(trial.at, np.cumsum([places[m].size for m in trial.members])[:-1])
    rough = {
        m: part for m, part in zip(trial.members, own, strict=False) if is_rough(problem, (m,))
    }
    return np.concatenate([rough.get(m, part) for m, part in zip(members, parts, strict=True)])


def is_rough(problem: Problem, members: Set) -> bool:
    """Whether a set has an effect whose form nobody knows well (`ROUGH_EFFECTS`)."""
    return any(problem.layout.groups[m][0] in ROUGH_EFFECTS for m in members)


Seen = tuple[int, Set]
"""The place of a trial, and a set as that trial sees it."""


def fair_evidence(
    trials: Sequence[Trial], seen: Sequence[Seen], bases: Sequence[tuple[Screen, Screen]]
) -> Array:
    """Log evidence (sets,) of sets, each in its trial, so that noise and slopes are evidence for nobody.

    About another size slopes and noise are others. A set counts if it beats "no effect" in its own trial;
    others lie as far below "no effect" as they do there. "No effect", and every other part of the set that
    leads, may also have the leader's trial.

    Args:
        trials: simulated sets.
        seen: the sets, "no effect" among them; more than one may be of a trial.
        bases: the trials' screens (`screens`).
    """
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
        if part and set(part) < set(members):
            base = base_of(bases[place], trials[place], part)
            found[k] = max(found[k], evidence_in(base, trials[place].plain, part))
    return found


def fair_on_all(trials: Sequence[Trial]) -> list[float]:
    """Fair evidence of every trial's own set, on all throws."""
    bases = [screens(t, total(t.information)) for t in trials]
    return fair_evidence(trials, [(i, t.members) for i, t in enumerate(trials)], bases).tolist()


def screens(trial: Trial, data: Information) -> tuple[Screen, Screen]:
    """A trial's screens of these data (all throws or a bootstrap): with its effects, and without them.

    Where its effects are not, neither is their form error.
    """
    return screen(data, trial.priors), screen(bare(data), trial.plain)


def base_of(both: tuple[Screen, Screen], trial: Trial, members: Set) -> Screen:
    """Of a trial's two screens the one for a set: only the trial's own effects are carried back."""
    return both[0] if set(members) & set(trial.members) else both[1]


def evidence_in(base: Screen, priors: Priors, members: Set) -> float:
    """Log evidence of a set in a trial's screen."""
    return base.log_evidence + weigh(base, priors, members).log_odds


def own_evidence(trial: Trial) -> float:
    """Log evidence of a trial's set in the trial itself."""
    return evidence_in(trial.base, trial.priors, trial.members)
