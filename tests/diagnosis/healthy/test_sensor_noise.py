"""The noise model follows the sensors and the sampling rate of the logs."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.healthy.noise import load_noise
from diagnosis.healthy.sensor_noise import NOISE_LIKE_SD, with_measured_sensor_noise
from diagnosis.loading.throw_data import LoadedSet
from tests.cases import each
from tests.diagnosis.twin_throws import throws

LATE = "valve_dead_time.boom.extra_dead_time_s"


def noisier(loaded: LoadedSet, ratio: float) -> LoadedSet:
    """The same throws from joint sensors with this multiple of the noise."""
    rng = np.random.default_rng(3)
    more = np.sqrt(ratio**2 - 1.0)
    return replace(
        loaded,
        throws=tuple(
            replace(
                t,
                sensor_position_rad_m=t.sensor_position_rad_m
                + more * 1e-3 * rng.standard_normal(t.sensor_position_rad_m.shape),
                sensor_velocity_rad_m_per_s=t.sensor_velocity_rad_m_per_s
                + more * 5e-3 * rng.standard_normal(t.sensor_velocity_rad_m_per_s.shape),
            )
            for t in loaded.throws
        ),
    )


def test_logs_like_the_type_s_change_nothing() -> None:
    assert with_measured_sensor_noise(load_noise(), throws()) == load_noise()


def test_a_command_is_not_known_within_a_row() -> None:
    model = load_noise()
    found = with_measured_sensor_noise(
        model, replace(throws(), rates={"control": 50.0})
    ).set_scatter
    assert found.sd_of(LATE) == pytest.approx(np.hypot(model.set_scatter.sd_of(LATE), 0.005))


def test_noisy_joint_sensors_widen_the_swing_s_noise() -> None:
    model, found = load_noise(), with_measured_sensor_noise(load_noise(), noisier(throws(), 4.0))
    for name in ("actuation.boom", "actuation.slew"):
        assert 2.0 < found.channels[name].noise_sd / model.channels[name].noise_sd < 4.0
    gyro = found.channels["swing.gyro.x"].floor_sd / model.channels["swing.gyro.x"].floor_sd
    assert 1.5 < gyro < 4.0, "what smoothing leaves grows less than noise"
    assert found.channels["flight.ball"] == model.channels["flight.ball"]
    for name in NOISE_LIKE_SD:
        assert found.set_scatter.sd_of(name) > 2.0 * model.set_scatter.sd_of(name)


@each("sd_m", [0.025, 0.05])
def test_the_tracker_s_noise_is_measured(sd_m: float) -> None:
    rng = np.random.default_rng(3)
    loaded = throws()
    noisy = tuple(
        replace(t, ball_m=t.ball_m + sd_m * rng.standard_normal(t.ball_m.shape))
        for t in loaded.throws
    )
    found = with_measured_sensor_noise(load_noise(), replace(loaded, throws=noisy))
    most = np.hypot(sd_m, load_noise().channels["flight.ball"].noise_sd)
    assert 0.95 * sd_m < found.channels["flight.ball"].noise_sd < 1.1 * most


def test_the_survey_s_standard_deviation_is_used() -> None:
    loaded = throws()
    coarse = replace(loaded, throws=tuple(replace(t, impact_sd_m=0.1) for t in loaded.throws))
    found = with_measured_sensor_noise(load_noise(), coarse)
    assert found.channels["flight.impact"].noise_sd == pytest.approx(0.1)
