"""Whitening the difference to no effect equals whitening everything."""

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


def whitened(problem: GapProblem, linear: LinearThrow, *, is_whole: bool = False) -> Whitened:
    """The first throw; a factor that is not the basis' own makes everything be whitened."""
    factor = [f.copy() if is_whole else f for f in problem.factor[0]]
    return whiten_throw(problem.prepared[0], linear, problem.model, factor, problem.basis[0])


def same(one: Whitened, other: Whitened) -> None:
    np.testing.assert_allclose(one.table, other.table, atol=1e-8)
    np.testing.assert_allclose(one.gram, other.gram, rtol=1e-7, atol=1e-6)


def test_whitening_the_difference_is_enough(problem: GapProblem) -> None:
    late, worn, both = (found[0] for found in about(problem, [LATE, WORN, (*LATE, *WORN)]))
    for linear in (late, worn, both, late):
        assert not np.array_equal(linear.residual, problem.linear[0].residual)
        same(whitened(problem, linear), whitened(problem, linear, is_whole=True))
    basis = problem.basis[0]
    np.testing.assert_array_equal(whitened(problem, basis.linear).table, basis.whitened.table)


def test_rows_without_a_prediction_are_no_data(problem: GapProblem) -> None:
    (found,) = about(problem, [WORN])
    residual, block = found[0].residual.copy(), problem.prepared[0].block("flight.impact")
    assert block is not None
    residual[block.rows] = np.nan
    lost = replace(found[0], residual=residual)
    assert not whitened(problem, lost).table[block.rows].any()
    same(whitened(problem, lost), whitened(problem, lost, is_whole=True))


def test_sets_are_the_same_in_several_batches(
    problem: GapProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    at_once = about(problem, [LATE, WORN, (*LATE, *WORN)])
    monkeypatch.setattr("diagnosis.linearisation.sensitivities.BATCH_COUNT", 1)
    for one, other in zip(at_once, about(problem, [LATE, WORN, (*LATE, *WORN)]), strict=True):
        np.testing.assert_allclose(one[0].residual, other[0].residual, atol=1e-12)
        np.testing.assert_allclose(one[0].jacobian, other[0].jacobian, atol=1e-7)
