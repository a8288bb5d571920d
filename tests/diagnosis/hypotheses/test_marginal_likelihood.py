"""The marginal likelihood equals that of the dense normal distribution, channel weights included."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.hypotheses.candidate import no_effect
from diagnosis.hypotheses.gap_problem import GapProblem
from diagnosis.hypotheses.marginal_likelihood import (
    channel_weights,
    marginal_likelihood,
    stage_of,
)
from sim_twin.effects.effect import Effect
from tests.diagnosis.twin_throws import posed, throws

WEAK = Effect(effect="valve_gain", joint="boom", parameters={"negative_ratio": -0.45})


@pytest.fixture(scope="module")
def problem() -> GapProblem:
    return posed(throws((WEAK,), 2))


def test_it_equals_the_dense_normal(problem: GapProblem) -> None:
    likelihood = marginal_likelihood(problem)
    residual = np.concatenate([one.residual for one in likelihood.throws])
    slopes = np.vstack([one.healthy for one in likelihood.throws])
    covariance = np.eye(residual.size) + slopes @ problem.layout.priors.scatter @ slopes.T
    at = 0
    for one in likelihood.throws:
        rows = slice(at, at + one.residual.size)
        covariance[rows, rows] += one.nuisance @ one.nuisance.T
        at = rows.stop
    expected = -0.5 * float(residual @ np.linalg.solve(covariance, residual))
    assert no_effect(likelihood).log_likelihood == pytest.approx(expected, rel=1e-6)


def test_channels_of_one_part_share_a_weight_and_a_misfit_lowers_it(problem: GapProblem) -> None:
    weights = channel_weights(problem)
    by_part: dict[str, set[float]] = {}
    for name, weight in weights.items():
        by_part.setdefault(stage_of(name), set()).add(weight)
    assert all(len(found) == 1 for found in by_part.values())
    louder = {**problem.none_levels, "actuation.boom": problem.none_levels["actuation.boom"] + 3.0}
    after = channel_weights(replace(problem, none_levels=louder))
    assert after["actuation.boom"] < 0.3 * weights["actuation.boom"]
    assert {n: w for n, w in after.items() if n != "actuation.boom"} == {
        n: w for n, w in weights.items() if n != "actuation.boom"
    }
    assert 0.0 < min(weights.values()) <= max(weights.values()) <= 1.0


def test_it_never_changes_while_a_second_process_is_given_it(problem: GapProblem) -> None:
    assert not hasattr(marginal_likelihood(problem), "__dict__"), "a cached value would be one"
