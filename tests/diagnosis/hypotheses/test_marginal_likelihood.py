"""The marginal likelihood equals that of the dense normal distribution, channel weights included."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.hypotheses.candidate import Throws, evaluate, no_effect
from diagnosis.hypotheses.gap_problem import GapProblem
from diagnosis.hypotheses.marginal_likelihood import (
    channel_weights,
    marginal_likelihood,
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


def test_deviations_of_a_simulated_parameter_act_along_its_slope_there(problem: GapProblem) -> None:
    likelihood = marginal_likelihood(problem)
    group = problem.layout.groups.index(("joint_sensor_latency", "slew"))
    (place,) = problem.layout.priors.groups[group].tolist()
    drift = place + problem.layout.parameter_count
    (late,) = evaluate(Throws(likelihood, likelihood), [((group,), np.array([0.03]))])
    # With the columns of the parameter and its drift replaced, all else is the plain normal.
    precision = likelihood.precision.copy()
    across = np.sum([one.with_healthy for one in late.products], axis=0)
    own = np.sum([one.own for one in late.products], axis=0)
    for column, index in enumerate((place, drift), start=1):
        precision[:, index] = precision[index, :] = across[:, column]
    precision[np.ix_([place, drift], [place, drift])] = own[1:, 1:]
    gradient = across[:, 0].copy()
    gradient[[place, drift]] = own[1:, 0]
    scatter = problem.layout.priors.scatter
    identity = np.eye(scatter.shape[0])
    mean = np.linalg.solve(identity + scatter @ precision, scatter @ gradient)
    volumes = [
        np.linalg.slogdet(identity + scatter @ p)[1] for p in (precision, likelihood.precision)
    ]
    expected = -0.5 * (own[0, 0] - gradient @ mean + volumes[0] - volumes[1])
    assert late.log_likelihood == pytest.approx(expected, rel=1e-6)
    np.testing.assert_allclose(late.healthy_mean, mean, atol=1e-7)


def test_a_misfit_lowers_the_weight_of_its_part_and_scatter_that_of_its_channel(
    problem: GapProblem,
) -> None:
    weights = channel_weights(problem)
    level, sd = problem.model.unknown_level["actuation.slew"]
    levels = {**problem.model.unknown_level, "actuation.slew": (level, 2.0 * sd)}
    model = problem.model.model_copy(update={"unknown_level": levels})
    scattered = channel_weights(replace(problem, model=model))
    assert {n for n in weights if scattered[n] < weights[n]} == {"actuation.slew"}
    louder = {**problem.none_levels, "actuation.boom": problem.none_levels["actuation.boom"] + 3.0}
    after = channel_weights(replace(problem, none_levels=louder))
    assert after["actuation.boom"] < 0.7 * weights["actuation.boom"]
    assert {n: w for n, w in after.items() if n != "actuation.boom"} == {
        n: w for n, w in weights.items() if n != "actuation.boom"
    }
    assert 0.0 < min(weights.values()) <= max(weights.values()) <= 1.0


def test_it_never_changes_while_a_second_process_is_given_it(problem: GapProblem) -> None:
    assert not hasattr(marginal_likelihood(problem), "__dict__"), "a cached value would be one"
