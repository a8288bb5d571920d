"""Whitened throws, and several sets linearised together."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from diagnosis.hypotheses.gap_problem import GapProblem, pose_problem
from diagnosis.linearisation.parameters import layout, library
from diagnosis.linearisation.sensitivities import LinearThrow, relinearise
from diagnosis.linearisation.whitening import Whitened, whiten_throw
from diagnosis.loading.prepared import prepare
from sim_twin.effects.effect import Effect
from tests.diagnosis.twin_throws import health, profile, throws

LATE = (Effect(effect="imu_latency", parameters={"extra_latency_s": 0.03}),)
WORN = (
    Effect(effect="valve_gain", joint="boom", parameters={"positive_ratio": -0.2}),
    Effect(effect="air_drag", parameters={"extra_drag_coefficient_ratio": 0.5}),
)


@pytest.fixture(scope="module")
def problem() -> GapProblem:
    loaded, known = throws(count=3), health()
    prepared = prepare(loaded.throws, profile())
    plan = layout(known.noise)
    return pose_problem(prepared, profile(), loaded.throws[0].calibration, known, plan)


def about(problem: GapProblem, sets: Sequence[tuple[Effect, ...]]) -> list[list[LinearThrow]]:
    requests = [
        (effects, [p for p in library() for e in effects if p.group == (e.effect, e.joint)])
        for effects in sets
    ]
    args = problem.prepared, problem.profile, problem.calibration, problem.healthy, problem.linear
    return list(relinearise(*args, requests))


def whitened(problem: GapProblem, linear: LinearThrow) -> Whitened:
    """The first throw."""
    return whiten_throw(problem.prepared[0], linear, problem.model, problem.factor[0])


def test_rows_without_a_prediction_are_no_data(problem: GapProblem) -> None:
    (found,) = about(problem, [WORN])
    residual, block = found[0].residual.copy(), problem.prepared[0].block("flight.impact")
    assert block is not None
    residual[block.rows] = np.nan
    lost = replace(found[0], residual=residual)
    assert not whitened(problem, lost).table[block.rows].any()
    assert whitened(problem, found[0]).table[block.rows].any()


def test_sets_are_the_same_in_several_batches(
    problem: GapProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    at_once = about(problem, [LATE, WORN, (*LATE, *WORN)])
    monkeypatch.setattr("diagnosis.linearisation.sensitivities.BATCH_COUNT", 1)
    for one, other in zip(at_once, about(problem, [LATE, WORN, (*LATE, *WORN)]), strict=True):
        np.testing.assert_allclose(one[0].residual, other[0].residual, atol=1e-12)
        np.testing.assert_allclose(one[0].jacobian, other[0].jacobian, atol=1e-7)
