"""Lag of velocity sensors behind position sensors."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from diagnosis.loading.measured import smooth_joints
from diagnosis.loading.throw_data import ThrowData
from diagnosis.loading.velocity_lag import velocity_lag_s
from machine.conventions import ACTIVE_COUNT, Array
from tests.cases import each
from tests.diagnosis.loading.test_throw_csv import both, make_log, throw_csv

AMPLITUDE_RAD_M = np.array([0.5, 0.2, 0.3, 0.2])
RATE_RAD_PER_S = np.array([2.8, 3.1, 3.5, 2.5])
POSITION_SD_RAD_M, VELOCITY_SD_RAD_M_PER_S = 1.2e-3, 7e-3


def moved(at_s: Array, share: Array | float = 1.0) -> tuple[Array, Array]:
    """Positions and velocities (n, 4) of joints that swing."""
    phase = np.multiply.outer(at_s, RATE_RAD_PER_S)
    size = AMPLITUDE_RAD_M * share
    return size * (1.0 - np.cos(phase)), size * RATE_RAD_PER_S * np.sin(phase)


def filtered(at_s: Array, lag_s: Array, share: Array | float = 1.0) -> Array:
    """Velocities (n, 4) of the same joints through a first-order filter, long after its start."""
    angle = np.arctan(RATE_RAD_PER_S * lag_s)
    phase = np.multiply.outer(at_s, RATE_RAD_PER_S) - angle
    return AMPLITUDE_RAD_M * share * RATE_RAD_PER_S * np.cos(angle) * np.sin(phase)


@pytest.fixture
def throw(tmp_path: Path) -> ThrowData:
    _, loaded = both(tmp_path, throw_csv(make_log()))
    return loaded.throws[0]


def seen(throw: ThrowData, position: Array, velocity: Array, seed: int = 1) -> ThrowData:
    """A throw whose sensors reported this and noise."""
    noise = np.random.default_rng(seed).standard_normal((2, *position.shape))
    return replace(
        throw,
        sensor_position_rad_m=position + POSITION_SD_RAD_M * noise[0],
        sensor_velocity_rad_m_per_s=velocity + VELOCITY_SD_RAD_M_PER_S * noise[1],
    )


@each("lag_s", [-0.01, 0.0, 0.008, 0.03])
@each("scale", [0.9, 1.0])
def test_the_lag_of_a_filter_is_found_whatever_the_scale(
    throw: ThrowData, lag_s: float, scale: float
):
    at_s, lags_s = throw.sensor_t_s, np.full(ACTIVE_COUNT, lag_s)
    position, velocity = moved(at_s)[0] * scale, filtered(at_s, lags_s)
    throws = [seen(throw, position, velocity, seed) for seed in range(6)]
    np.testing.assert_allclose(velocity_lag_s(throws), lags_s * scale, atol=2e-3)


def test_what_delays_both_sensors_is_no_lag(throw: ThrowData):
    position, velocity = moved(throw.sensor_t_s - 0.04)
    throws = [seen(throw, position, velocity, seed) for seed in range(6)]
    np.testing.assert_allclose(velocity_lag_s(throws), 0.0, atol=2e-3)


def test_a_joint_that_hardly_moved_counts_as_prompt(throw: ThrowData):
    still = np.array([1.0, 0.0, 1.0, 0.01])
    at_s, lags_s = throw.sensor_t_s, np.full(ACTIVE_COUNT, 0.008)
    found_s = velocity_lag_s([seen(throw, moved(at_s, still)[0], filtered(at_s, lags_s, still))])
    assert found_s[1] == found_s[3] == 0.0
    assert (found_s[[0, 2]] > 0.004).all()


def test_a_throw_without_samples_gives_no_lag(throw: ThrowData):
    short = replace(
        throw,
        sensor_t_s=throw.sensor_t_s[:2],
        sensor_position_rad_m=throw.sensor_position_rad_m[:2],
        sensor_velocity_rad_m_per_s=throw.sensor_velocity_rad_m_per_s[:2],
    )
    np.testing.assert_array_equal(velocity_lag_s([short]), 0.0)


def test_smoothed_joints_are_not_late_with_their_velocity_sensors(throw: ThrowData):
    lags_s, at_s = np.full(ACTIVE_COUNT, 0.02), throw.sensor_t_s
    late = seen(throw, moved(at_s)[0], filtered(at_s, lags_s))
    inner = throw.t_s[30:-30]
    true = moved(inner)
    off = [
        [np.sqrt(np.mean((track - one) ** 2)) for track, one in zip(found, true, strict=False)]
        for found in (smooth_joints(late, inner, lags_s), smooth_joints(late, inner, 0.0 * lags_s))
    ]
    assert off[0][0] < 0.4 * off[1][0], "positions"
    assert off[0][1] < 0.4 * off[1][1], "velocities"
