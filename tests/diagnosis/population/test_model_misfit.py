"""The model of healthy machines is adapted to a machine as far as it fits."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.healthy.filters import HealthyModel, nothing
from diagnosis.healthy.health import Health
from diagnosis.healthy.noise import NoiseModel
from diagnosis.hypotheses import gap_problem
from diagnosis.hypotheses.gap_problem import GapProblem, pose_problem
from diagnosis.inference.evidence import Information
from diagnosis.linearisation.parameters import layout
from diagnosis.linearisation.whitening import whiten_throw
from diagnosis.loading.prepared import prepare
from diagnosis.population.model_misfit import misfit, scaled_to
from diagnosis.population.other_machine_type import other_type_model
from machine.conventions import ACTIVE_JOINTS
from tests.diagnosis.twin_throws import health, profile, throws


@pytest.fixture(scope="module")
def problem() -> GapProblem:
    loaded, known = throws(count=3), health()
    plan = layout(known.noise)
    prepared = prepare(loaded.throws, profile())
    calibration = loaded.throws[0].calibration
    return pose_problem(prepared, profile(), calibration, known, plan)


def louder(problem: GapProblem, joints: tuple[str, ...], sd: float) -> dict[str, float]:
    """Misfit when these joints' velocities are off by coarse noise of this size."""
    rng, found = np.random.default_rng(0), []
    for p, linear, factor in zip(problem.prepared, problem.linear, problem.factor, strict=True):
        residual = linear.residual.copy()
        for joint in joints:
            block = p.block(f"actuation.{joint}")
            assert block is not None
            residual[block.rows] += sd * rng.standard_normal(block.t_s.size)
        moved = replace(linear, residual=residual)
        found.append(whiten_throw(p, moved, problem.model, factor, beside=problem.beside))
    return misfit(found, problem.layout.priors, problem.model)


def test_the_model_of_a_machine_of_the_type_is_kept(problem: GapProblem) -> None:
    assert max(louder(problem, (), 0.0).values()) <= 1.0
    assert problem.model == health().noise


def test_deviation_of_one_joint_is_an_effect_and_of_all_a_misfit(problem: GapProblem) -> None:
    assert louder(problem, ("boom",), 0.05)["actuation"] <= 1.0
    ratio = louder(problem, tuple(ACTIVE_JOINTS), 0.05)
    assert ratio["actuation"] > 3.0
    assert ratio["swing"] <= 1.0


def test_misfit_widens_the_discrepancy_of_its_stage_alone(problem: GapProblem) -> None:
    wider = scaled_to(problem.model, {"actuation": 2.0, "swing": 1.0})
    before = problem.model.channels
    assert wider.channels["actuation.boom"].floor_sd == 2.0 * before["actuation.boom"].floor_sd
    assert wider.channels["actuation.boom"].noise_sd == before["actuation.boom"].noise_sd
    assert wider.channels["swing.gyro.x"] == before["swing.gyro.x"]


def test_filters_that_raise_the_residual_are_not_used(
    problem: GapProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    def widest(model: NoiseModel, _: Information) -> NoiseModel:
        return other_type_model(model, [1.0] * len(ACTIVE_JOINTS))

    monkeypatch.setattr(gap_problem, "fitted_other_type_model", widest)
    wrong = nothing().joints[0].model_copy(update={"offset": 0.1, "weight": (1e-9,) * 140})
    filters = HealthyModel(note="another type", joints=(wrong,) * len(ACTIVE_JOINTS))
    posed = pose_problem(
        problem.prepared,
        problem.profile,
        problem.calibration,
        Health(filters, problem.model),
        problem.layout,
    )
    assert posed.healthy == nothing()
