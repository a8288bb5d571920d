"""Adaptation of the noise model to the noise and the sampling rate of these logs.

Noise and clock errors of the type were learned from its own sensors at 100 Hz. Other sensors are noisier. A
log with fewer rows does not show when within a row a valve moved. Neither may be taken for an effect.
"""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from diagnosis.healthy.noise import NoiseModel
from diagnosis.loading.measured import (
    NOISE_WINDOW_COUNT,
    POSITION_SD_RAD_M,
    VELOCITY_SD_RAD_M_PER_S,
    smoothed_as_sd,
    smoothed_noise,
    white_noise_sd,
)
from diagnosis.loading.throw_data import LoadedSet, ThrowData
from machine.conventions import ACTIVE_JOINTS, CONTROL_PERIOD_S, Array

USUAL_SPEED_SD_RAD_M_PER_S = (0.0050, 0.0059, 0.0067, 0.0060)
"""White noise of the joint velocity sensors of the type, one standard deviation."""
NOISIER_RATIO = 1.1
"""Joint sensors and trackers of the type stay below this multiple of their usual noise."""
NOISE_LIKE_SD: Final[Mapping[str, float]] = {
    "joint_sensor_bias.telescope.bias_rad_m": 0.06,
    **{f"unmodelled.scale.{joint}.scale_ratio": 0.01 for joint in ACTIVE_JOINTS},
    **{f"joint_sensor_latency.{joint}.extra_latency_s": 0.008 for joint in ACTIVE_JOINTS},
    "joint_sensor_latency.slew.extra_latency_s": 0.004,
    "joint_sensor_latency.telescope.extra_latency_s": 0.02,
    "imu_latency.extra_latency_s": 0.004,
}
"""Standard deviations of parameters whose effect resembles a simulated gripper that joint-sensor noise
excites. They are scaled by the square of the excess of that noise over the type's."""
LEAST_TRACK_COUNT = NOISE_WINDOW_COUNT + 3
"""Fewest samples of a track that hold a window of third differences."""
_LATE_KEYS = ("valve_dead_time.{}.extra_dead_time_s", "joint_sensor_latency.{}.extra_latency_s")


def with_measured_sensor_noise(model: NoiseModel, loaded: LoadedSet) -> NoiseModel:
    """The model with the noise of these throws where it is higher, and with their clocks' resolution.

    Args:
        model: of the type.
        loaded: the throws, and their sampling rates.
    """
    shaking = _excitation(loaded.throws)
    channels = {
        name: channel.model_copy(
            update={
                "noise_sd": channel.noise_sd * _noisier(name, channel.noise_sd, loaded.throws),
                "floor_sd": channel.floor_sd * shaking.get(name.rpartition(".")[0], 1.0),
            }
        )
        for name, channel in model.channels.items()
    }
    # A command may have changed anywhere within a row.
    unsure_s = 0.5 * max(1.0 / loaded.rates["control"] - CONTROL_PERIOD_S, 0.0)
    unsure = {key.format(joint): unsure_s for key in _LATE_KEYS for joint in ACTIVE_JOINTS}
    louder = shaking["swing.gyro"] ** 2 - 1.0
    set_scatter = model.set_scatter
    for name in unsure | NOISE_LIKE_SD:
        more = np.hypot(unsure.get(name, 0.0), louder * NOISE_LIKE_SD.get(name, 0.0))
        sd = float(np.hypot(set_scatter.sd_of(name), more))
        set_scatter = set_scatter.with_sd(name, sd)
    return model.model_copy(update={"channels": channels, "set_scatter": set_scatter})


def _shown_ratio(throws: Sequence[ThrowData]) -> Array:
    """White noise of the joint velocities (4,) over that of the type."""
    shown = [white_noise_sd(t.sensor_velocity_rad_m_per_s) for t in throws]
    return np.median(shown, axis=0) / np.array(USUAL_SPEED_SD_RAD_M_PER_S)


def _noisier(block: str, usual_sd: float, throws: Sequence[ThrowData]) -> float:
    """Ratio of a block's noise to that of the type, at least 1."""
    stage, _, channel = block.partition(".")
    if stage == "actuation":
        ratio = float(_shown_ratio(throws)[ACTIVE_JOINTS.index(channel)])
    elif block == "flight.ball":
        ratio = _track_noise_sd_m(throws) / usual_sd
    elif block == "flight.impact":
        surveyed = [t.impact_sd_m for t in throws if np.isfinite(t.impact_sd_m)]
        return max(float(np.median(surveyed)) / usual_sd, 1.0) if surveyed else 1.0
    else:
        return 1.0
    return ratio if ratio > NOISIER_RATIO else 1.0


def _track_noise_sd_m(throws: Sequence[ThrowData]) -> float:
    """White noise of the load tracker over all axes and throws; 0 without a tracker."""
    tracks = [t.ball_m for t in throws if t.ball_m.shape[0] >= LEAST_TRACK_COUNT]
    if not tracks:
        return 0.0
    return float(np.sqrt(np.mean(np.square([white_noise_sd(one) for one in tracks]))))


def _excitation(throws: Sequence[ThrowData]) -> Mapping[str, float]:
    """How much more than the type's the joint sensors' noise moves the simulated gripper, by IMU sensor.

    At least 1. A pin 6 m out that follows the residual noise of the joint sensors excites the gripper below
    it. That is most of the deviation of gyro and accelerometer of a healthy machine at rest.
    """
    sensors = [(t.sensor_position_rad_m, t.sensor_velocity_rad_m_per_s) for t in throws]
    shown: Array = np.median([[white_noise_sd(v) for v in pair] for pair in sensors], axis=0)
    type_sd = np.array([POSITION_SD_RAD_M, VELOCITY_SD_RAD_M_PER_S])
    pairs = zip(shown.T, smoothed_as_sd(shown).T, strict=True)
    own = np.max([smoothed_noise(sd, taken_for) for sd, taken_for in pairs], axis=0)
    speed, push = np.maximum(own / smoothed_noise(type_sd, type_sd), 1.0).tolist()
    return {"swing.gyro": speed, "swing.accel": push}
