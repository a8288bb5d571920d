"""Sets of effects tried out: simulated at some sizes, linearised there, and estimated again.

An effect of finite size bends; so a set is judged about its own sizes, and others about theirs.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from diagnosis.causes.evidence import (
    Information,
    Priors,
    Set,
    SetEvidence,
    mean_with,
    members_index,
    screen,
    total,
    weigh,
)
from diagnosis.causes.form_error import rough_blocks, shaken
from diagnosis.causes.leftovers import levels
from diagnosis.causes.linear import Linear, carried
from diagnosis.causes.own_noise import in_common_noise
from diagnosis.causes.own_play import with_own_play
from diagnosis.causes.parameters import Layout, Parameter, View, effects_of, library
from diagnosis.causes.problem import Problem
from diagnosis.causes.residuals import relinearise
from diagnosis.causes.weighing import Trial, by_member, formed, lead
from diagnosis.causes.whitening import Whitened, information, whiten_throw
from machine.conventions import Array
from sim_twin.effects.effect import Effect
from sim_twin.effects.schema import DRIFT
from sim_twin.effects.table import effects_where

BENT_EFFECTS = effects_where(lambda effect: effect.growth == "jumps")
"""Joints stand, valves hang in their play, speeds are cut, for a time that grows with the size in jumps."""
CURVED_EFFECTS = effects_where(lambda effect: effect.growth == "curved")
"""Drag over mass and lift grow with the size along a curve, without jumps: slopes are a guide to sizes
nearby, and to no others. A load lighter by 0.5 kg, six times the drag, promised what 0.46 would be: 14 ahead
of the drag of 2.8 times that was there."""
SWAYING = effects_where(lambda effect: effect.growth == "frequency")
"""A softer chassis sways slower. Of one by 0.02 rad slopes at none showed nothing, and simulated it was 5400
ahead of none, where 36 had been the most."""
SHAKING_EFFECTS = effects_where(lambda effect: effect.shakes_other_joints)
"""One joint's, or the pump's, shows at others, in another form than the library's."""
BENDING_EFFECTS = effects_where(lambda effect: effect.varies_widely)
"""By which healthy machines scatter so much that slopes at the twin are no good guide."""
Seed = tuple[Set, Array]
"""A set, and the sizes at which it is to be simulated."""


def try_sets(
    problem: Problem,
    seeds: Mapping[Set, Array] | Sequence[Seed],
    scatter: Sequence[tuple[Effect, ...]] | None = None,
    *,
    is_rough: bool = False,
) -> list[Trial]:
    """Simulate every set at its sizes, and estimate the sizes again.

    Args:
        problem: the throws.
        seeds: the sets, and the sizes at which they are simulated.
        scatter: of the machine, beside each set; none if left out.
        is_rough: for a look at many, of which few will be tried again: at half of the throws and half the
            time for each (`relinearise`), and what each throw says by itself, and what is left of it, is not
            kept.
    """
    seeds = list(seeds.items()) if isinstance(seeds, Mapping) else list(seeds)
    off = [()] * len(seeds) if scatter is None else scatter
    items = list(zip(seeds, off, strict=True))
    if problem.worker is None or len(items) < 2:
        return _tried(problem, items, is_rough, scatter is not None)
    return problem.worker.split(_tried, problem, items, is_rough, scatter is not None)


def _tried(
    problem: Problem,
    items: Sequence[tuple[Seed, tuple[Effect, ...]]],
    is_rough: bool,
    is_last: bool,
) -> list[Trial]:
    """Sets at sizes, and the machine's scatter beside each."""
    problem = problem.at_a_glance() if is_rough else problem
    layout = problem.layout
    seeds, beside = [seed for seed, _ in items], [off for _, off in items]
    effects = [fitted_effects(layout, members, sizes) for members, sizes in seeds]
    about = [(*own, *off) for own, off in zip(effects, beside, strict=True)]
    only = [
        [*_constants(layout, members), *(bending_parameters() if off else ())]
        for (members, _), off in zip(seeds, beside, strict=True)
    ]
    found = relinearise(
        problem.prepared,
        problem.profile,
        problem.calibration,
        problem.healthy,
        problem.linear,
        list(zip(about, only, strict=True)),
        followed=_followed(is_rough=is_rough, is_last=is_last),
    )
    trials: list[Trial] = []
    for (members, _), own, there, at in zip(seeds, effects, about, found, strict=True):
        back = [
            carried(one, there, p.input.progress_ratio)
            for one, p in zip(at, problem.prepared, strict=True)
        ]
        trials.append(_estimated(problem, members, own, back, is_rough=is_rough))
    return trials


def _followed(*, is_rough: bool, is_last: bool) -> tuple[View, ...]:
    """Views in which all slopes are taken where a set is (`relinearise`)."""
    if is_rough:
        return ()
    return (View.ACTUATION, View.SWING) if is_last else (View.ACTUATION,)


def bending_parameters() -> list[Parameter]:
    """Of the effects by which the machine's own scatter is simulated, too."""
    return [p for p in library() if p.effect in BENDING_EFFECTS]


def _estimated(
    problem: Problem,
    members: Set,
    effects: Sequence[Effect],
    at: Sequence[Linear],
    *,
    is_rough: bool,
) -> Trial:
    """The set's trial; effects that may shake other joints do if that tells them better from no effect."""
    rough = rough_blocks(effects)
    trials = [
        _with_form(problem, members, effects, at, blocks, is_rough=is_rough)
        for blocks in ([(), rough] if rough else [()])
    ]
    return trials[0] if len(trials) == 1 else max(trials, key=lead)


def _with_form(
    problem: Problem,
    members: Set,
    effects: Sequence[Effect],
    at: Sequence[Linear],
    rough: Collection[str],
    *,
    is_rough: bool,
) -> Trial:
    throws: list[Whitened] = []
    factors: list[Sequence[Array]] = []
    for i, (p, linear) in enumerate(zip(problem.prepared, at, strict=True)):
        factor = problem.factor[i]
        if rough:
            factor = shaken(
                p,
                problem.model,
                problem.plain[i],
                factor,
                problem.off[i],
                linear.change,
                rough,
            )
        throws.append(whiten_throw(p, linear, problem.model, factor, problem.basis[i]))
        factors.append(factor)
    groups = problem.layout.groups
    played = [j for e, j in (groups[m] for m in members) if e == "valve_hysteresis" and j]
    plain = problem.layout.priors
    if played:
        throws, plain = with_own_play(problem, throws, at, factors, played)
    informations = information(throws)
    if rough:
        informations = in_common_noise(problem.at_none, factors, informations)
    data = total(informations)
    start = np.array([v for e in effects for v in _sizes_of(e)])
    priors = formed(plain, data, members, start) if members else plain
    base = screen(data, priors)
    mean = _sizes_in(data, plain, members)
    trial = Trial(
        members=members,
        at=start,
        sizes=mean,
        levels={},
        information=[data] if is_rough else informations,
        priors=priors,
        plain=plain,
        base=base,
        bent=tuple(m for m in members if groups[m][0] in BENT_EFFECTS),
        curved=tuple(m for m in members if groups[m][0] in CURVED_EFFECTS),
        is_shaken=any(groups[m][0] in SHAKING_EFFECTS for m in members),
    )
    if is_rough:
        return trial
    return replace(trial, levels=levels(throws, seen_in(trial, members)[1], rough_blocks(effects)))


def seen_in(trial: Trial, members: Set) -> tuple[SetEvidence, Array]:
    """A set as a trial sees it: its evidence, and all parameters, scatter of the others included."""
    evidence = weigh(trial.base, trial.priors, members)._replace(mean=sizes_in(trial, members))
    data = total(trial.information)
    return evidence, mean_with(trial.base, data, trial.priors, evidence)


def sizes_in(trial: Trial, members: Set) -> Array:
    """Sizes of a set, group after group, as a trial sees it."""
    if members == trial.members:
        return trial.sizes
    return _sizes_in(total(trial.information), trial.plain, members)


def _sizes_in(data: Information, plain: Priors, members: Set) -> Array:
    """Without the form error: what it lets other parameters take is taken from the effects themselves.

    With it a telescope's valve that was 0.27 s late came out as 0.20 s from 0.23 s, then as 0.12 and 0.04 s.
    """
    return weigh(screen(data, plain), plain, members).mean


def _sizes_of(effect: Effect) -> list[float]:
    """Sizes of an effect in the order of the vector."""
    if effect.effect == DRIFT:
        return list(effect.parameters.values())
    return [
        effect.parameters.get(p.name, 0.0)
        for p in library()
        if p.group == (effect.effect, effect.joint)
    ]


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


def no_effect(problem: Problem) -> Trial:
    """The trial of no effect."""
    priors = problem.layout.priors
    base = screen(total(problem.information), priors)
    return Trial(
        members=(),
        at=np.zeros(0),
        sizes=np.zeros(0),
        levels=levels(problem.whitened, base.mean),
        information=problem.information,
        priors=priors,
        plain=priors,
        base=base,
    )


def kept_at(trial: Trial, members: Set, sizes: Array) -> Array:
    """Sizes for a larger set, group after group: bent effects of the trial stay where they were."""
    own = by_member(trial.plain, trial.members, trial.at)
    return np.concatenate(
        [
            own[m] if m in trial.bent else part
            for m, part in by_member(trial.plain, members, sizes).items()
        ]
    )
