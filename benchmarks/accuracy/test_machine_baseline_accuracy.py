"""A machine of another type is its own baseline: its misfit is no effect, and what it never had still is."""

from pathlib import Path

import pytest

from benchmarks.other_plant import Variant, throws
from diagnosis.healthy.health import Health
from diagnosis.healthy.noise import NoiseModel
from diagnosis.hypotheses.candidate import no_effect
from diagnosis.hypotheses.gap_problem import GapProblem, pose_problem
from diagnosis.hypotheses.marginal_likelihood import marginal_likelihood
from diagnosis.hypotheses.search import linear_gains
from diagnosis.linearisation.parameters import layout
from diagnosis.loading.prepared import prepare
from diagnosis.population.machine_baseline import (
    ReferenceThrows,
    machine_model,
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


def log_odds(model: NoiseModel, posed_throws: GapProblem) -> dict[str, float]:
    """Of every single effect and unmodelled effect over none, along slopes."""
    profile = posed_throws.profile
    health = Health(posed_throws.healthy, model, profile)
    with one_blas_thread():
        problem = pose_problem(
            posed_throws.prepared, profile, posed_throws.calibration, health, layout(model)
        )
    likelihood, groups = marginal_likelihood(problem), problem.layout.groups
    gains = linear_gains(likelihood, no_effect(likelihood), range(len(groups)))
    return {
        ".".join(part for part in groups[group] if part): gain for group, (gain, _) in gains.items()
    }


def test_a_machine_is_compared_with_itself(reference: GapProblem, tmp_path: Path) -> None:
    model = machine_model(reference.model, as_throws(reference))
    of_type, own = reference.model.channels[SLEW], model.channels[SLEW]
    assert own.memory_s > 2.0 * of_type.memory_s
    first = REFERENCE_COUNT
    healthy = posed(tmp_path / "healthy", RINGING, OTHER_COUNT, first)
    by_type = max(log_odds(reference.model, healthy).values())
    assert by_type > 50.0, "the twin's misfit of this slew would be evidence under the type's model"
    assert max(log_odds(model, healthy).values()) < 0.25 * by_type
    late = RINGING._replace(release_delay_s=0.08)
    odds = log_odds(model, posed(tmp_path / "late", late, OTHER_COUNT, first))
    assert max(odds, key=lambda name: odds[name]) == "release_delay"
