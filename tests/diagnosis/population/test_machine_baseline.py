"""A machine of another type is its own baseline: its misfit is no effect, and what it never had still is."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.other_plant import Variant, throws
from diagnosis.hypotheses.gap_problem import GapProblem, pose_problem
from diagnosis.inference.evidence import screen, total, weigh
from diagnosis.linearisation.parameters import EXCLUDED_LOG_PRIOR, layout, library
from diagnosis.linearisation.whitening import information
from diagnosis.loading.prepared import prepare
from diagnosis.population.machine_baseline import (
    ReferenceThrows,
    machine_model,
    with_set_tolerance,
)
from machine.spec import load_spec
from sim_twin.child_processes import one_blas_thread
from sim_twin.twin.profile import nominal_profile
from tests.diagnosis.twin_throws import health

SLEW = "actuation.slew"
RINGING = Variant(slew_frequency_hz=1.1)
REFERENCE_COUNT, OTHER_COUNT = 12, 4


def posed(folder: Path, variant: Variant, count: int, first: int) -> GapProblem:
    loaded = throws(folder, variant, count, first)
    prepared = prepare(loaded.throws, nominal_profile(load_spec()))
    calibration = loaded.throws[0].calibration
    known = health()
    profile = nominal_profile(load_spec())
    with one_blas_thread():
        return pose_problem(prepared, profile, calibration, known, layout(known.noise))


def as_throws(problem: GapProblem) -> ReferenceThrows:
    return ReferenceThrows(problem.prepared, problem.linear, problem.beside)


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> GapProblem:
    return posed(tmp_path_factory.mktemp("reference"), RINGING, REFERENCE_COUNT, 0)


def log_odds(model, healthy: ReferenceThrows) -> dict[str, float]:
    """Of every single effect and unmodelled effect over none."""
    plan = layout(model)
    priors = plan.priors._replace(looks_like=healthy.beside)
    base = screen(total(information(healthy.whitened(model))), priors)
    return {
        ".".join(part for part in name if part): weigh(base, priors, (group,)).log_odds
        for group, name in enumerate(plan.groups)
    }


def test_a_machine_is_compared_with_itself(reference: GapProblem, tmp_path: Path) -> None:
    model = machine_model(reference.model, as_throws(reference))
    of_type, own = reference.model.channels[SLEW], model.channels[SLEW]
    assert own.memory_s > 2.0 * of_type.memory_s
    first = REFERENCE_COUNT
    healthy = as_throws(posed(tmp_path / "healthy", RINGING, OTHER_COUNT, first))
    by_type = max(log_odds(reference.model, healthy).values())
    assert by_type > 50.0, "the twin's misfit of this slew would be evidence under the type's model"
    assert max(log_odds(model, healthy).values()) < 0.25 * by_type
    late = RINGING._replace(release_delay_s=0.08)
    odds = log_odds(model, as_throws(posed(tmp_path / "late", late, OTHER_COUNT, first)))
    assert max(odds, key=lambda name: odds[name]) == "release_delay"


def test_parameters_scatter_between_sets_by_their_tolerance_at_least() -> None:
    model = health().noise
    tolerant = with_set_tolerance(model)
    for parameter in library():
        sd = tolerant.set_scatter.sd_of(parameter.key)
        assert sd == max(model.set_scatter.sd_of(parameter.key), parameter.tolerance)


def test_an_unmodelled_effect_that_healthy_throws_show_is_no_hypothesis() -> None:
    model = health().noise
    plan = layout(model)
    name = next(g for i, g in enumerate(plan.groups) if plan.is_unmodelled(i))
    key = ".".join(part for part in name if part is not None)
    usual = layout(model.model_copy(update={"usual_unmodelled": (key,)}))
    changed = np.flatnonzero(usual.priors.log_prior != plan.priors.log_prior)
    assert [plan.groups[i] for i in changed] == [name]
    assert usual.priors.log_prior[changed] == EXCLUDED_LOG_PRIOR
