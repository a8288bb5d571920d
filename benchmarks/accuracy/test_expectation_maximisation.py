"""Expectation maximisation finds the mean and the scatter of healthy machines."""

import numpy as np
import pytest

from diagnosis.healthy.filters import nothing
from diagnosis.linearisation.parameters import scatter_names
from diagnosis.linearisation.sensitivities import linearise
from diagnosis.loading.prepared import prepare
from diagnosis.population.expectation_maximisation import HealthySet, improve
from sim_twin.effects.effect import Effect
from tests.diagnosis.twin_throws import health, profile, throws

LENGTH = "gripper_length.extra_length_m"
SIZES_M = (0.010, 0.020, 0.030, 0.040)
"""Four machines whose gripper is longer than drawn, each by its own length."""


@pytest.fixture(scope="module")
def sets() -> list[HealthySet]:
    found: list[HealthySet] = []
    for number, size in enumerate(SIZES_M):
        longer = Effect(effect="gripper_length", joint=None, parameters={"extra_length_m": size})
        loaded = throws((longer,), count=2, seed=number)
        prepared, calibration = prepare(loaded.throws, profile()), loaded.throws[0].calibration
        linear = linearise(prepared, profile(), calibration, nothing())
        found.append(HealthySet(prepared, linear, profile(), calibration))
    return found


def test_what_all_machines_share_becomes_the_mean_and_the_rest_scatter(
    sets: list[HealthySet],
) -> None:
    model = health().noise
    for _ in range(3):
        model = improve(sets, model)
    # Two throws each leave some of it to others, and give it some of theirs: a pendulum has one period.
    assert 0.6 * np.mean(SIZES_M) < model.healthy_mean[LENGTH] < 1.4 * np.mean(SIZES_M)
    assert np.sqrt(model.scatter([LENGTH])) == pytest.approx(np.std(SIZES_M), rel=0.5)
    assert np.linalg.eigvalsh(model.scatter(scatter_names())).min() > 0.0
