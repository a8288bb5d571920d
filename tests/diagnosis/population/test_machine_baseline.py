"""A machine is its own baseline: wide priors, and the tolerance of another day."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.linearisation.parameters import library
from diagnosis.linearisation.residual_power import log_level
from diagnosis.population.machine_baseline import (
    DROPPED_RATIO,
    OWN_EFFECTS,
    ReferenceThrows,
    with_set_tolerance,
    with_usual_level,
    with_wide_priors,
)
from tests.diagnosis.twin_throws import health, posed_healthy


def test_every_parameter_scatters_between_days_by_its_tolerance_alone() -> None:
    model = health().noise
    names = model.set_scatter.names
    more = with_set_tolerance(model).set_scatter.covariance(names) - model.set_scatter.covariance(
        names
    )
    tolerance = {p.key: p.tolerance for p in library()}
    expected = np.array([tolerance.get(name, 0.0) for name in names])
    np.testing.assert_allclose(more, np.diag(expected**2), rtol=2e-3, atol=1e-6)


def test_a_machine_may_have_any_smooth_effect_that_is_not_the_loads() -> None:
    model = health().noise
    before, after = model.machine_scatter, with_wide_priors(model).machine_scatter
    for p in library():
        widened = after.sd_of(p.key) > 1.01 * before.sd_of(p.key)
        assert widened is (p.effect in OWN_EFFECTS), p.key


def test_the_usual_level_does_not_count_a_sixth_of_the_throws() -> None:
    problem = posed_healthy(6)
    reference = ReferenceThrows(problem.prepared, problem.linear, problem.beside)
    usual = with_usual_level(problem.model, reference)
    assert usual.dropped_ratio == DROPPED_RATIO
    (place,) = [i for i, b in enumerate(problem.prepared[0].blocks) if b.name == "actuation.boom"]
    rows = problem.prepared[0].blocks[place].rows
    residual = problem.linear[0].residual.copy()
    residual[rows] += np.where(np.arange(rows.stop - rows.start) % 2, 0.2, -0.2)
    loud = [replace(problem.linear[0], residual=residual), *problem.linear[1:]]
    one_loud = with_usual_level(problem.model, reference._replace(linear=loud))
    middle, sd = usual.unknown_level["actuation.boom"]
    again, wider = one_loud.unknown_level["actuation.boom"]
    # A single throw that leaves many times the usual moves neither much.
    assert abs(again - middle) < 3.0 * sd
    assert wider < 3.0 * sd


def test_the_level_leaves_out_the_loudest_throws() -> None:
    power = np.array([1.0] * 10 + [50.0, 80.0])
    assert log_level(power, DROPPED_RATIO) == pytest.approx(0.0)
    assert log_level(power, 0.0) == pytest.approx(np.log(140.0 / 12.0))
