"""A machine of another type is its own baseline: its misfit is no effect, and what it never had still is."""

import numpy as np

from diagnosis.linearisation.parameters import EXCLUDED_LOG_PRIOR, layout, library
from diagnosis.population.machine_baseline import (
    with_set_tolerance,
)
from tests.diagnosis.twin_throws import health


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
