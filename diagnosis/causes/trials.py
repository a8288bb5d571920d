"""Sets of effects tried out: simulated at some sizes, linearised there, and estimated again.

An effect of finite size bends; so a set is judged about its own sizes, and others about theirs.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from diagnosis.causes.parameters import Layout, Parameter, effects_of, index_of, library
from diagnosis.causes.problem import Problem
from diagnosis.causes.residuals import Linear, relinearise
from diagnosis.causes.selection import (
    Information,
    Priors,
    Screen,
    Set,
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
"""Sets simulated side by side: the slopes of 12 throws for 30 sets took more than 1 GiB."""


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A set of effects, linearised at its sizes."""

    members: Set
    sizes: Array
    """Of the members' parameters."""
    whitened: Sequence[Whitened]
    """Kept in the last round only: it is large."""
    information: Sequence[Information]
    priors: Priors
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
    stages = {constants[int(i) % len(constants)].stage for i in index if i < 2 * len(constants)}
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
    """The set's trial; effects that may be rough are taken as rough as the throws want them."""
    rough = rough_blocks(effects)
    trials = [
        _with_form(problem, members, effects, at, blocks, is_last=is_last)
        for blocks in ([(), rough] if rough else [()])
    ]
    return max(trials, key=own_evidence)


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
        change = problem.linear[i].residual - at[i].residual
        linear = _carried(at[i], effects, p.input.progress_ratio)
        factor = widened(p, problem.model, problem.factor[i], change, rough)
        whitened = whiten_throw(p, linear, problem.model, factor, problem.basis(i))
        informations += information([whitened])
        if is_last:
            kept.append(whitened)
    data = total(informations)
    start = np.array([v for e in effects for v in _sizes_of(e)])
    priors = _formed(problem.layout.priors, data, members, start)
    base = screen(data, priors)
    return Trial(members, weigh(base, priors, members).mean, kept, informations, priors, base)


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


def settle(problem: Problem, seeds: dict[Set, Array], rounds: int) -> list[Trial]:
    """Simulate and estimate again, some rounds."""
    sizes = dict(seeds)
    trials: list[Trial] = []
    for _ in range(rounds):
        trials = try_sets(problem, sizes)
        sizes = {t.members: t.sizes for t in trials}
    return trials


def fair_evidence(trials: Sequence[Trial]) -> dict[Set, tuple[float, int]]:
    """Log evidence of every trial's set, and in which of the trials it has it.

    About another size slopes and noise are others. What "no effect", or a rival, would gain from them as well
    is no evidence for the trial's own set: so each set may choose the trial in which it looks best.
    """
    found: dict[Set, tuple[float, int]] = {}
    for members, priors in {t.members: t.priors for t in trials}.items():
        logs = [t.base.log_evidence + weigh(t.base, priors, members).log_odds for t in trials]
        best = int(np.argmax(logs))
        found[members] = logs[best], best
    return found


def own_evidence(trial: Trial) -> float:
    """Log evidence of a trial's set in the trial itself."""
    return trial.base.log_evidence + weigh(trial.base, trial.priors, trial.members).log_odds
