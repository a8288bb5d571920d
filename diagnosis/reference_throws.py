"""Throws of a machine while it was healthy, and what they show about it.

Healthy machines of a type scatter more than one of them does over time, and a machine may be of another type.
Reference throws make the machine its own baseline (population/machine_baseline.py): its deviations from the
twin, the covariance of what the twin misses on it, and the scatter above which an effect has to show.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from diagnosis.correction import with_effects
from diagnosis.healthy.health import Health
from diagnosis.healthy.health_store import HealthStore, health_key
from diagnosis.healthy.noise import NoiseModel
from diagnosis.hypotheses.gap_problem import GapProblem, pose_problem
from diagnosis.linearisation.open_loop import impacts
from diagnosis.linearisation.parameters import ReplayKind, layout, library
from diagnosis.linearisation.sensitivities import relinearise
from diagnosis.loading.prepared import PreparedThrow, prepare
from diagnosis.loading.throw_data import LoadedSet, ThrowData, refusals
from diagnosis.population.machine_baseline import OWN_EFFECTS, ReferenceThrows, machine_model
from diagnosis.population.machine_filters import MachineFilters, as_unseen, machine_filters
from machine.conventions import Array
from machine.errors import UsageError
from sim_twin.replay.replay import ReplayElement, replay
from sim_twin.twin.profile import TwinProfile


def check_reference(reference: LoadedSet, diagnosed: Sequence[ThrowData]) -> None:
    """Refuse reference throws that cannot be compared with the diagnosed ones.

    Raises:
        UsageError: too few, of another machine, or among those that are diagnosed.
    """
    shortage = reference.shortage("usable reference throws")
    if shortage is not None:
        raise UsageError(shortage)
    own, other = diagnosed[0].machine_id, reference.throws[0].machine_id
    if own != other:
        raise UsageError(
            f"the reference throws are of machine {other!r}, the diagnosed ones of {own!r}: a machine can "
            "only be compared with itself. Give healthy throws of the same machine, or none"
        )
    both = sorted({t.throw_id for t in diagnosed} & {t.throw_id for t in reference.throws})
    if both:
        raise UsageError(
            f"{len(both)} throws are to be diagnosed and are reference throws as well "
            f"({', '.join(both[:3])}): what both have would not show. Give each throw once"
        )


def reference_evidence(
    reference: LoadedSet | None, kept_utc: str | None = None
) -> dict[str, Any] | None:
    """For `Diagnosis.evidence`; None where the machine was compared with healthy machines of its type.

    Args:
        reference: throws of the machine while it was healthy.
        kept_utc: when their model was estimated, if it was kept from an earlier diagnosis.
    """
    if reference is None:
        return None
    return {
        "throws_count": len(reference.throws),
        "throw_ids": [throw.throw_id for throw in reference.throws],
        "refused": refusals(reference.refused),
        "kept_utc": kept_utc,
    }


def kept_or_estimated(
    reference: LoadedSet, profile: TwinProfile, health: Health, store: HealthStore | None
) -> tuple[Health, str | None]:
    """`health_from_reference`, taken from a store where it was estimated before, and kept there else.

    Returns:
        The model, and when it was estimated (UTC) if it was taken from the store.
    """
    if store is None:
        return health_from_reference(reference, profile, health), None
    key = health_key(reference.throws, profile, health)
    kept = store.find(key)
    if kept is not None:
        return kept
    found = health_from_reference(reference, profile, health)
    store.keep(key, found)
    return found, None


def health_from_reference(reference: LoadedSet, profile: TwinProfile, health: Health) -> Health:
    """The model of this machine from that of its type and from throws while it was healthy.

    What the throws show of the machine's deviations beside its repeated misfit is added to the twin, and the
    throws are linearised again there, as in Gauss and Newton's method: a twin with its own machine's lengths
    and friction has the slopes of that machine.
    """
    prepared = prepare(reference.throws, profile)
    calibration = prepared[0].throw.calibration
    first = pose_problem(prepared, profile, calibration, health, layout(health.noise))
    repeated = machine_filters(prepared, first.linear, first.healthy)
    left = as_unseen(prepared, first.linear, first.healthy, repeated)
    mean = machine_model(first.model, ReferenceThrows(prepared, left, first.beside)).healthy_mean
    offsets = {p: p.clip(mean[p.key]) for p in library() if p.effect in OWN_EFFECTS}
    own = with_effects(profile, [p.at(size) for p, size in offsets.items()])
    [moved] = relinearise(
        prepared,
        own,
        calibration,
        first.healthy,
        first.linear,
        [((), ())],
        (ReplayKind.ACTUATION,),
        followed=(),
    )
    filters = machine_filters(prepared, moved, first.healthy)
    model = health.noise.about({p.key: size for p, size in offsets.items()})
    about_own = health._replace(filters=filters.all, noise=model)
    problem = pose_problem(prepared, own, calibration, about_own, layout(model))
    unseen = as_unseen(prepared, problem.linear, filters.all, filters)
    found = machine_model(problem.model, ReferenceThrows(prepared, unseen, problem.beside))
    model = _with_gap(found, problem, filters)
    return Health(filters.all, model, own, _replay_gap_m(prepared, profile))


def _with_gap(model: NoiseModel, problem: GapProblem, filters: MachineFilters) -> NoiseModel:
    """The model with the impact gap of this machine's reference throws by mode, root mean square."""
    found = np.stack(
        [
            impacts([p], filters.of_others(i), problem.profile, problem.calibration)[0]
            for i, p in enumerate(problem.prepared)
        ]
    )
    gap_m = {**model.healthy_gap_m, **_gap_by_mode(problem.prepared, found)}
    return model.model_copy(update={"healthy_gap_m": gap_m})


def _replay_gap_m(prepared: Sequence[PreparedThrow], profile: TwinProfile) -> dict[str, float]:
    """Impact gap of throws against a twin that replays their valve commands, by mode."""
    elements = [ReplayElement(throw) for throw in range(len(prepared))]
    output = replay([p.input for p in prepared], elements, profile, prepared[0].throw.calibration)
    return _gap_by_mode(prepared, output.impact_m[:, :2])


def _gap_by_mode(prepared: Sequence[PreparedThrow], impact_m: Array) -> dict[str, float]:
    """Root mean square of measured minus simulated impacts (N, 2), by mode."""
    gap_m = np.stack([p.throw.impact_m[:2] for p in prepared]) - impact_m
    modes = np.array([p.throw.mode for p in prepared])
    is_known = np.isfinite(gap_m).all(axis=1)
    return {
        mode: float(np.sqrt(np.square(gap_m[is_known & (modes == mode)]).sum(axis=1).mean()))
        for mode in np.unique(modes[is_known]).tolist()
    }
