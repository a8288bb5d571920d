"""Evaluation of candidates: sets of effects simulated at some sizes, linearised and estimated there.

An effect of finite size is nonlinear, so every set is judged about its own sizes.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from diagnosis.healthy.noise import whiten
from diagnosis.hypotheses.comparison import (
    CandidateSet,
    by_member,
    log_odds_over_none,
    with_model_error,
)
from diagnosis.hypotheses.gap_problem import GapProblem
from diagnosis.hypotheses.noise_normalisation import in_common_noise
from diagnosis.inference.evidence import (
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
from diagnosis.linearisation.basis_functions import play_columns
from diagnosis.linearisation.model_error import nonsmooth_blocks, with_excited_joints
from diagnosis.linearisation.parameters import (
    Parameter,
    ParameterLayout,
    ReplayKind,
    effects_of,
    library,
)
from diagnosis.linearisation.residual_power import levels
from diagnosis.linearisation.sensitivities import LinearThrow, extrapolated_to_none, relinearise
from diagnosis.linearisation.unmodelled_effects import (
    PLAY_ORDERS,
    group_of,
    unmodelled_groups,
    unmodelled_names,
)
from diagnosis.linearisation.whitening import (
    Whitened,
    beside_named,
    healthy_mean_of,
    information,
    slope_count,
    whiten_throw,
)
from diagnosis.loading.prepared import PreparedThrow
from machine.conventions import Array, IntArray
from sim_twin.effects.effect import Effect
from sim_twin.effects.schema import DRIFT
from sim_twin.effects.table import effects_where


def with_local_play_slopes(
    problem: GapProblem,
    throws: Sequence[Whitened],
    at: Sequence[LinearThrow],
    factors: Sequence[Sequence[Array]],
    joints: Collection[str],
) -> tuple[list[Whitened], Priors]:
    """Throws whose basis functions of varying play, at some joints, have the slopes of a candidate.

    Slopes of play that opens from zero are not those of play that is present. The projection on the named
    slopes is subtracted: constant play is the library's. The priors hold the projection.

    Args:
        problem: the throws.
        throws: whitened about the candidate.
        at: their residuals and slopes there.
        factors: Cholesky factors of their blocks' covariances.
        joints: where the candidate has play.
    """
    places = np.array([p for j in joints for p in unmodelled_groups()[group_of("play"), j]])
    middle = healthy_mean_of(problem.model, unmodelled_names())[places]
    columns = 2 + slope_count() - len(unmodelled_names()) + places
    own = [
        _with_columns(w, columns, _play_columns(p, linear, factor, joints), middle)
        for w, p, linear, factor in zip(throws, problem.prepared, at, factors, strict=True)
    ]
    beside = beside_named(total(information(own)), problem.layout)[:, places]
    named = slice(2, 2 + beside.shape[0])
    looks_like = problem.beside.copy()
    looks_like[:, places] = beside
    return [
        _with_columns(w, columns, w.table[:, columns] - w.table[:, named] @ beside, middle)
        for w in own
    ], problem.layout.priors._replace(looks_like=looks_like)


def _play_columns(
    prepared: PreparedThrow, linear: LinearThrow, factor: Sequence[Array], joints: Collection[str]
) -> Array:
    """Columns (n, k) of varying play, joint after joint, each at the rows of its joint."""
    parts: list[Array] = []
    for joint in joints:
        part = np.zeros((linear.residual.size, len(PLAY_ORDERS)))
        for block, lower in zip(prepared.blocks, factor, strict=True):
            if block.name == f"actuation.{joint}":
                part[block.rows] = whiten(lower, play_columns(prepared, linear, block))
        parts.append(part)
    return np.column_stack(parts)


def _with_columns(whitened: Whitened, columns: IntArray, values: Array, middle: Array) -> Whitened:
    """The throw with other values (n, k) in some columns; their healthy mean leaves the residuals."""
    table, gram = whitened.table.copy(), whitened.gram.copy()
    table[:, :2] += ((table[:, columns] - values) @ middle)[:, None]
    table[:, columns] = values
    moved = np.r_[0, 1, columns]
    gram[:, moved] = table.T @ table[:, moved]
    gram[moved] = gram[:, moved].T
    return replace(whitened, first=table, gram=gram, changes=())


JUMPING_EFFECTS = effects_where(lambda effect: effect.growth == "jumps")
"""Effects with jumps: joints stand, valves rest in their play, speeds saturate, for a time that grows in
jumps with the size."""
CURVED_EFFECTS = effects_where(lambda effect: effect.growth == "curved")
"""Effects that grow along a smooth curve, such as drag over mass and lift: slopes hold for sizes nearby
only."""
FREQUENCY_EFFECTS = effects_where(lambda effect: effect.growth == "frequency")
"""Effects that change a frequency: slopes at zero do not show them."""
EXCITING_EFFECTS = effects_where(lambda effect: effect.shakes_other_joints)
"""Effects that show at other joints, in another form than the library's."""
WIDELY_VARYING_EFFECTS = effects_where(lambda effect: effect.varies_widely)
"""Effects whose scatter between healthy machines is too large for slopes at the twin."""
StartingPoint = tuple[Set, Array]
"""A set, and the sizes at which it is simulated."""


def evaluate(
    problem: GapProblem,
    points: Mapping[Set, Array] | Sequence[StartingPoint],
    scatter: Sequence[tuple[Effect, ...]] | None = None,
    *,
    is_preview: bool = False,
) -> list[CandidateSet]:
    """Simulate every set at its sizes, and estimate the sizes again.

    Args:
        problem: the throws.
        points: the sets, and the sizes at which they are simulated.
        scatter: of the machine, beside each set; none if left out.
        is_preview: a preview of many sets of which few are evaluated again: half of the throws, slopes at no
            effect (`relinearise`), and neither the information of single throws nor the residual power is
            kept.
    """
    points = list(points.items()) if isinstance(points, Mapping) else list(points)
    off = [()] * len(points) if scatter is None else scatter
    items = list(zip(points, off, strict=True))
    if problem.worker is None or len(items) < 2:
        return _evaluate(problem, items, is_preview, scatter is not None)
    return problem.worker.split(_evaluate, problem, items, is_preview, scatter is not None)


def _evaluate(
    problem: GapProblem,
    items: Sequence[tuple[StartingPoint, tuple[Effect, ...]]],
    is_preview: bool,
    is_last: bool,
) -> list[CandidateSet]:
    """Evaluate sets at sizes, with the machine's scatter beside each."""
    problem = problem.preview_subset() if is_preview else problem
    layout = problem.layout
    points, beside = [seed for seed, _ in items], [off for _, off in items]
    effects = [fitted_effects(layout, members, sizes) for members, sizes in points]
    about = [(*own, *off) for own, off in zip(effects, beside, strict=True)]
    only = [
        [*_constants(layout, members), *(widely_varying_parameters() if off else ())]
        for (members, _), off in zip(points, beside, strict=True)
    ]
    found = relinearise(
        problem.prepared,
        problem.profile,
        problem.calibration,
        problem.healthy,
        problem.linear,
        list(zip(about, only, strict=True)),
        followed=_followed(is_preview=is_preview, is_last=is_last),
    )
    candidates: list[CandidateSet] = []
    for (members, _), own, there, at in zip(points, effects, about, found, strict=True):
        back = [
            extrapolated_to_none(one, there, p.input.progress_ratio)
            for one, p in zip(at, problem.prepared, strict=True)
        ]
        candidates.append(_estimate(problem, members, own, back, is_preview=is_preview))
    return candidates


def _followed(*, is_preview: bool, is_last: bool) -> tuple[ReplayKind, ...]:
    """Views in which all slopes are taken at the set (`relinearise`)."""
    if is_preview:
        return ()
    return (ReplayKind.ACTUATION, ReplayKind.SWING) if is_last else (ReplayKind.ACTUATION,)


def widely_varying_parameters() -> list[Parameter]:
    """Parameters by which the machine's own scatter is simulated."""
    return [p for p in library() if p.effect in WIDELY_VARYING_EFFECTS]


def _estimate(
    problem: GapProblem,
    members: Set,
    effects: Sequence[Effect],
    at: Sequence[LinearThrow],
    *,
    is_preview: bool,
) -> CandidateSet:
    """The candidate; noise at excited joints is widened if that raises its log odds over no effect."""
    nonsmooth = nonsmooth_blocks(effects)
    candidates = [
        _in_noise(problem, members, effects, at, blocks, is_preview=is_preview)
        for blocks in ([(), nonsmooth] if nonsmooth else [()])
    ]
    return candidates[0] if len(candidates) == 1 else max(candidates, key=log_odds_over_none)


def _in_noise(
    problem: GapProblem,
    members: Set,
    effects: Sequence[Effect],
    at: Sequence[LinearThrow],
    nonsmooth: Collection[str],
    *,
    is_preview: bool,
) -> CandidateSet:
    throws: list[Whitened] = []
    factors: list[Sequence[Array]] = []
    for i, (p, linear) in enumerate(zip(problem.prepared, at, strict=True)):
        factor = problem.factor[i]
        if nonsmooth:
            factor = with_excited_joints(
                p,
                problem.model,
                problem.healthy_factor[i],
                factor,
                problem.no_effect_residual[i],
                linear.change,
                nonsmooth,
            )
        throws.append(whiten_throw(p, linear, problem.model, factor, problem.basis[i]))
        factors.append(factor)
    groups = problem.layout.groups
    played = [j for e, j in (groups[m] for m in members) if e == "valve_hysteresis" and j]
    plain = problem.layout.priors
    if played:
        throws, plain = with_local_play_slopes(problem, throws, at, factors, played)
    informations = information(throws)
    if nonsmooth:
        informations = in_common_noise(problem.no_effect_throw, factors, informations)
    data = total(informations)
    start = np.array([v for e in effects for v in _sizes_of(e)])
    priors = with_model_error(plain, data, members, start) if members else plain
    base = screen(data, priors)
    mean = _sizes_in(data, plain, members)
    candidate = CandidateSet(
        members=members,
        at=start,
        sizes=mean,
        levels={},
        information=[data] if is_preview else informations,
        priors=priors,
        plain=plain,
        base=base,
        jumping=tuple(m for m in members if groups[m][0] in JUMPING_EFFECTS),
        curved=tuple(m for m in members if groups[m][0] in CURVED_EFFECTS),
        excites_others=any(groups[m][0] in EXCITING_EFFECTS for m in members),
    )
    if is_preview:
        return candidate
    return replace(
        candidate,
        levels=levels(throws, set_in_candidate(candidate, members)[1], nonsmooth_blocks(effects)),
    )


def set_in_candidate(candidate: CandidateSet, members: Set) -> tuple[SetEvidence, Array]:
    """A set in a candidate's linearisation: its evidence, and all parameters with the others' scatter."""
    evidence = weigh(candidate.base, candidate.priors, members)._replace(
        mean=sizes_in(candidate, members)
    )
    data = total(candidate.information)
    return evidence, mean_with(candidate.base, data, candidate.priors, evidence)


def sizes_in(candidate: CandidateSet, members: Set) -> Array:
    """Estimated sizes of a set in a candidate's linearisation, group after group."""
    if members == candidate.members:
        return candidate.sizes
    return _sizes_in(total(candidate.information), candidate.plain, members)


def _sizes_in(data: Information, plain: Priors, members: Set) -> Array:
    """Estimated sizes without model error: it would let other parameters take part of the effects."""
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


def _constants(layout: ParameterLayout, members: Set) -> list[Parameter]:
    """Parameters whose slopes a hypothesis needs; for a drift, those of the drifting parameter."""
    index = members_index(layout.priors, members)
    places = sorted({int(i) % layout.parameter_count for i in index})
    return [library()[i] for i in places]


def fitted_effects(layout: ParameterLayout, members: Set, sizes: Array) -> tuple[Effect, ...]:
    """A hypothesis with these sizes (group after group) as effects of the library."""
    # Unmodelled effects are linear: there is nothing to simulate.
    return tuple(
        effects_of(layout, group, own)
        for group, own in by_member(layout.priors, members, sizes).items()
        if not layout.is_unmodelled(group)
    )


def no_effect(problem: GapProblem) -> CandidateSet:
    """The candidate without effects."""
    priors = problem.layout.priors
    base = screen(total(problem.information), priors)
    return CandidateSet(
        members=(),
        at=np.zeros(0),
        sizes=np.zeros(0),
        levels=levels(problem.whitened, base.mean),
        information=problem.information,
        priors=priors,
        plain=priors,
        base=base,
    )


def kept_at(candidate: CandidateSet, members: Set, sizes: Array) -> Array:
    """Initial sizes for a larger set, group after group: effects with jumps keep their simulated sizes."""
    own = by_member(candidate.plain, candidate.members, candidate.at)
    return np.concatenate(
        [
            own[m] if m in candidate.jumping else part
            for m, part in by_member(candidate.plain, members, sizes).items()
        ]
    )
