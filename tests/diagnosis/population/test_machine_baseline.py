"""A machine is its own baseline: wide priors, and the tolerance of another day."""

import numpy as np

from diagnosis.linearisation.parameters import library
from diagnosis.population.machine_baseline import (
    OWN_EFFECTS,
    with_set_tolerance,
    with_wide_priors,
)
from tests.diagnosis.twin_throws import health


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
