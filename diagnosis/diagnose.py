"""Diagnosis of a set of throws: where the gap lies, what causes it, how far it shrinks."""

from collections.abc import Callable
from contextlib import closing, nullcontext
from dataclasses import replace
from time import perf_counter

import numpy as np

from diagnosis.conclusion import Findings, conclude
from diagnosis.cross_validation import shrink
from diagnosis.healthy.health import Health, load_health
from diagnosis.healthy.health_store import HealthStore
from diagnosis.healthy.sensor_noise import with_measured_sensor_noise
from diagnosis.hypotheses.candidate import Throws, evaluate
from diagnosis.hypotheses.gap_problem import pose_problem
from diagnosis.hypotheses.marginal_likelihood import marginal_likelihood
from diagnosis.hypotheses.ranking import rank
from diagnosis.hypotheses.release_jitter import fit_jitter
from diagnosis.hypotheses.search import search
from diagnosis.linearisation.parameters import layout
from diagnosis.loading.prepared import prepare
from diagnosis.loading.throw_data import LoadedSet
from diagnosis.reference_throws import check_reference, kept_or_estimated
from diagnosis.report.overlay import overlay
from diagnosis.stages import swap_stages
from diagnosis.verdict import Diagnosis
from diagnosis.worker_process import WorkerProcess
from sim_twin.child_processes import one_blas_thread
from sim_twin.twin.profile import TwinProfile

Progress = Callable[[float, str], None]
"""Called with the share done, 0 to 1, and what is being done."""


class CancelledError(Exception):
    """The caller asked to stop."""


def diagnose_throws(
    loaded: LoadedSet,
    profile: TwinProfile,
    progress: Progress | None = None,
    cancel: Callable[[], bool] | None = None,
    health: Health | None = None,
    reference: LoadedSet | None = None,
    *,
    material_m: float | None = None,
    store: HealthStore | None = None,
    is_alone: bool = True,
) -> Diagnosis:
    """Diagnose a set of throws.

    Args:
        loaded: the throws, and the refused logs.
        profile: of the twin that the machine is compared with.
        progress: called with the share done and what is being done.
        cancel: called between steps; true stops the diagnosis.
        health: model of healthy machines; the calibrated model of the type if left out.
        reference: throws of the same machine while it was healthy. They separate effects from the machine's
            own deviations. Without them the machine is compared with healthy machines of its type.
        material_m: least displacement of the impact from which an effect is claimed; one that acts on pose
            or sensors always is.
        store: keeps the model of the healthy machine, which takes longest to estimate, for the next
            diagnosis with the same reference throws and twin.
        is_alone: whether a second core is free.

    Raises:
        CancelledError: `cancel` returned true.
        UsageError: the reference throws are too few, of another machine, or among those diagnosed.
    """
    refused = loaded.too_few()
    if refused is not None:
        return refused
    if reference is not None:
        check_reference(reference, loaded.throws)
    with one_blas_thread(), closing(WorkerProcess()) if is_alone else nullcontext() as worker:
        if worker is not None:
            worker.preload(evaluate)
        known = load_health() if health is None else health
        return _diagnose(
            loaded, reference, profile, known, store, material_m, progress, cancel, worker
        )


def _diagnose(
    loaded: LoadedSet,
    reference: LoadedSet | None,
    profile: TwinProfile,
    health: Health,
    store: HealthStore | None,
    material_m: float | None,
    progress: Progress | None,
    cancel: Callable[[], bool] | None,
    worker: WorkerProcess | None,
) -> Diagnosis:
    started = perf_counter()
    seconds: dict[str, float] = {}

    def report(share: float, text: str) -> None:
        seconds[text] = round(perf_counter() - started, 2)
        if cancel is not None and cancel():
            raise CancelledError("the diagnosis was cancelled")
        if progress is not None:
            progress(share, text)

    kept_utc: str | None = None
    if reference is not None:
        report(0.01, "the machine while it was healthy")
        health, kept_utc = kept_or_estimated(reference, profile, health, store)
    twin = profile if health.profile is None else health.profile
    # From these throws alone: a sticking joint looks noisy, and did not while the machine was healthy.
    health = health._replace(noise=with_measured_sensor_noise(health.noise, loaded))
    report(0.2, "measured motion")
    model = health.noise
    prepared = prepare(loaded.throws, twin)
    calibration = loaded.throws[0].calibration
    report(0.22, "where: stages swapped")
    terms = swap_stages(prepared, profile, calibration)
    report(0.25, "which: sensitivities")
    jitter = fit_jitter(prepared, twin, model)
    plan = layout(model)
    if jitter.log_odds > 0.0:
        health = health._replace(noise=model.with_jitter(jitter.size_s))
    problem = pose_problem(prepared, twin, calibration, health, plan)
    likelihood = marginal_likelihood(problem)
    throws = Throws(likelihood, marginal_likelihood(problem.preview_subset()))
    report(0.35, "which: sets of effects")
    candidates = search(
        throws.shared_with(worker), lambda s: report(0.35 + 0.5 * s, "which: sets of effects")
    )
    ranked = rank(problem, likelihood, candidates, jitter)
    report(0.88, "how far: held-out throws")
    best = ranked.best
    floor = [model.healthy_gap_m.get(p.throw.mode, 0.0) for p in prepared]
    found = (
        shrink(likelihood, best, float(np.sqrt(np.mean(np.square(floor)))))
        if best.members
        else None
    )
    report(0.97, "series")
    findings = Findings(loaded, reference, problem, ranked, terms, found, material_m)
    concluded = conclude(
        replace(findings, healthy_gap_m=health.replay_gap_m, health_kept_utc=kept_utc)
    )
    where = concluded.evidence["where"]
    place = None if where is None else (where["stage"], where["joint"])
    plots = overlay(problem, best.effects, place)
    report(1.0, "done")
    evidence = {**concluded.evidence, "seconds": seconds}
    return concluded.model_copy(update={"plots": plots, "evidence": evidence})
