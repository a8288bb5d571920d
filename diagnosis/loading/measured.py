"""Measured motion of a throw on the control grid: driven joints smoothed, passive joints from the gyro.

It is independent of the twin and replaces a simulated stage when that stage is taken as measured.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import solveh_banded

from diagnosis.loading.throw_data import ThrowData
from machine.conventions import ACTIVE_COUNT, CONTROL_PERIOD_S, Array, BoolArray
from runtime.control.imu_estimator import start_angle
from sim_twin.replay.motion import shifted
from sim_twin.replay.replay import ReplayInput
from sim_twin.replay.turned_imu import swing_from_gyro

POSITION_SD_RAD_M = 1.3e-3
VELOCITY_SD_RAD_M_PER_S = 7e-3
"""Least noise that the smoother assumes for position (rad or m) and velocity sensors, one standard
deviation."""
NOISIER_RATIO = 1.3
"""Sensors with more noise than this multiple of the least are smoothed by the noise that they show."""
NOISE_WINDOW_COUNT = 24
"""Samples of a window in which white noise is estimated."""
SETTLED_COUNT = 60
"""Ticks after which a sample no longer affects the smoothed motion."""
LEAST_STEP_S = 1e-4
"""Samples closer together than this are one, s."""
JERK_SD_RAD_M_PER_S3 = 15.0
"""White jerk of the smoother. A drive's jerk is 60 (3 rad/s2 within 50 ms), which would pass so much
noise that a low-pass filter, which looks like a latency, would fit better. At 15 the simulated swing is
closest to the gyro."""
REST_S = 0.06
"""Duration of rest at the start of a throw, s, before the valves' dead time has passed: the gyro reads
its bias."""
REST_RATE_RAD_PER_S = 0.04
SAME_START_RAD = 0.015
"""The machine took its initial estimate from the first specific forces if the two agree within this."""
SWITCH_LAG_S = 0.0275
"""Delay of the gripper switch's report behind the release, s: latch and debounce, 15 to 40 ms."""
SETTLED_S = 1.0
"""Recorded time before the throw after which the gripper hangs at rest, s."""
CALM_S = 0.12
CALM_COUNT = 4
CALM_RAD_PER_S2 = 0.15
"""A gripper whose rate changes by no more than this before the throw, or before the valves' dead time has
passed, hangs at rest. One that is let go 0.02 rad off plumb changes it by as much."""
SWITCH_TICK_S = 0.5 * CONTROL_PERIOD_S
"""Mean delay of a switch that is read once a tick, s."""


AFTER_OPENING_S = 2.0
AFTER_SWITCH_S = 0.6


class MeasuredMotion(NamedTuple):
    """Motion at the control ticks from the throw's start on; T rows of 10 ms."""

    t_s: Array
    """(T,)"""
    position_rad_m: Array
    """(T, 4)"""
    velocity_rad_m_per_s: Array
    """(T, 4)"""
    acceleration_rad_m_per_s2: Array
    """(T, 4)"""
    swing_rad: Array
    """(T, 2) pitch and roll joint angles."""
    swing_rate_rad_per_s: Array
    """(T, 2)"""
    gyro_rad_per_s: Array | None = None
    """(T, 3) without its bias."""
    start_force_m_per_s2: Array | None = None
    """(3,) specific force at the start, where the machine took the initial swing from it."""

    def early(self, latency_s: Array) -> "MeasuredMotion":
        """The motion corrected for latencies (4,) of the driven joints' sensors; held at the end."""
        if not (latency_s > 0.0).any():
            return self
        ticks = latency_s / CONTROL_PERIOD_S
        return self._replace(
            position_rad_m=shifted(self.position_rad_m, ticks),
            velocity_rad_m_per_s=shifted(self.velocity_rad_m_per_s, ticks),
            acceleration_rad_m_per_s2=shifted(self.acceleration_rad_m_per_s2, ticks),
        )


def new_samples(at_s: Array) -> BoolArray:
    """(n,) whether each of these times (n,) is a new sample."""
    return np.concatenate([[True], np.diff(at_s) > LEAST_STEP_S])


def smooth_joints(
    throw: ThrowData, t_s: Array, velocity_lag_s: Array
) -> tuple[Array, Array, Array]:
    """Position, velocity, acceleration (T, 4) at `t_s` from both sensors of each driven joint.

    Least squares with a penalty on the third difference, at the sensors' time stamps. Velocity sensors lag
    behind position sensors by (4,).
    """
    at = throw.sensor_t_s
    keep = new_samples(at)
    grid = np.arange(at[keep][0], at[keep][-1] + 0.5 * CONTROL_PERIOD_S, CONTROL_PERIOD_S)
    outputs = np.empty((3, t_s.size, ACTIVE_COUNT))
    sensors = (throw.sensor_position_rad_m, throw.sensor_velocity_rad_m_per_s)
    own_sd = smoothed_as_sd(np.stack([white_noise_sd(values) for values in sensors]))
    for joint in range(ACTIVE_COUNT):
        position = np.interp(grid, at[keep], throw.sensor_position_rad_m[keep, joint])
        velocity = np.interp(grid, at[keep], throw.sensor_velocity_rad_m_per_s[keep, joint])
        sds = own_sd[0, joint], own_sd[1, joint]
        smooth = _smooth(position, velocity, *sds, float(velocity_lag_s[joint]))
        speed = np.gradient(smooth, CONTROL_PERIOD_S)
        push = np.gradient(speed, CONTROL_PERIOD_S)
        for row, channel in enumerate((smooth, speed, push)):
            outputs[row, :, joint] = np.interp(t_s, grid, channel)
    return outputs[0], outputs[1], outputs[2]


def white_noise_sd(values: Array) -> Array:
    """Standard deviation (k,) of the white noise of samples (n, k); 0 for too few samples.

    From third differences, whose variance is 20 times that of white noise, in the calmer windows of a
    throw. Slow motion cancels; the calmer windows exclude impacts of gears and valves.
    """
    steps = np.square(np.diff(values, 3, axis=0)) / 20.0
    count = steps.shape[0] // NOISE_WINDOW_COUNT
    if count == 0:
        return np.zeros(values.shape[1])
    windows = steps[: count * NOISE_WINDOW_COUNT].reshape(count, NOISE_WINDOW_COUNT, -1)
    return np.sqrt(np.quantile(windows.mean(axis=1), 0.25, axis=0))


def _smooth(
    position: Array,
    velocity: Array,
    position_sd_rad_m: float,
    velocity_sd_rad_m_per_s: float,
    lag_s: float,
) -> Array:
    """Minimise |x - position|^2 / sp^2 + |D1 x - lag D2 x - velocity|^2 / sv^2 + |D3 x|^2 / sj^2, (n,)."""
    n, h = position.size, CONTROL_PERIOD_S
    bands = np.zeros((4, n))
    right = position / position_sd_rad_m**2
    bands[0] = 1.0 / position_sd_rad_m**2
    # Central differences for the velocity, third differences for the jerk.
    reported = np.array([-0.5, 0.0, 0.5]) / h - lag_s * np.array([1.0, -2.0, 1.0]) / h**2
    _add(bands, reported / velocity_sd_rad_m_per_s)
    inner = velocity[1:-1] / velocity_sd_rad_m_per_s**2
    for place, share in enumerate(reported):
        right[place : n - 2 + place] += share * inner
    _add(bands, np.array([-1.0, 3.0, -3.0, 1.0]) / h**3 / JERK_SD_RAD_M_PER_S3)
    return np.asarray(solveh_banded(bands, right, lower=True))


def smoothed_as_sd(shown_sd: Array) -> Array:
    """Noise that the smoother assumes for measured noise (2, 4) of positions and velocities."""
    least = [[POSITION_SD_RAD_M], [VELOCITY_SD_RAD_M_PER_S]]
    return np.maximum(shown_sd / NOISIER_RATIO, least)


def smoothed_noise(noise_sd: Array, taken_for_sd: Array) -> tuple[float, float]:
    """Noise of the smoothed speed and acceleration of a joint, from that of its sensors.

    A lag of the velocity sensor, which raises it slightly for all machines alike, is neglected.

    Args:
        noise_sd: of position and velocity sensor (2,), rad or m and per s.
        taken_for_sd: (2,) noise that the smoother assumes.
    """
    count = 2 * SETTLED_COUNT + 1
    parts: list[tuple[float, float]] = []
    for sensor in (0, 1):
        pulse = np.zeros((2, count))
        pulse[sensor, SETTLED_COUNT] = noise_sd[sensor]
        smooth = _smooth(pulse[0], pulse[1], float(taken_for_sd[0]), float(taken_for_sd[1]), 0.0)
        speed = np.gradient(smooth, CONTROL_PERIOD_S)
        push = np.gradient(speed, CONTROL_PERIOD_S)
        parts.append((float(np.sum(speed**2)), float(np.sum(push**2))))
    speed_sd, push_sd = np.sqrt(np.sum(parts, axis=0)).tolist()
    return speed_sd, push_sd


def _add(bands: Array, stencil: Array) -> None:
    """Add the normal matrix of a difference stencil to lower bands (4, n)."""
    n, width = bands.shape[1], stencil.size
    for i in range(width):
        for j in range(i, width):
            bands[j - i, i : n - width + 1 + i] += stencil[i] * stencil[j]


def rows_of_interest(throw: ThrowData) -> BoolArray:
    """(T,) ticks from the throw's start to the landing."""
    last = throw.open_command_t_s + AFTER_OPENING_S
    if np.isfinite(throw.impact_t_s):
        opened = measured_opening_s(throw) if np.isfinite(throw.switch_open_t_s) else 0.0
        last = max(throw.impact_t_s, opened + AFTER_SWITCH_S) + 0.05
    return (throw.t_s >= -1e-9) & (throw.t_s <= last)


def measured_motion(throw: ThrowData, velocity_lag_s: Array) -> MeasuredMotion:
    """Driven joints smoothed; pitch and roll by integrating the gyro from the hanging pose at the start.

    Velocity sensors lag by (4,). Without an IMU the machine's own estimate of pitch and roll is used.
    """
    t_s = throw.t_s[rows_of_interest(throw)]
    position, velocity, acceleration = smooth_joints(throw, t_s, velocity_lag_s)
    if throw.imu_t_s.size == 0:
        rows, free = rows_of_interest(throw), slice(ACTIVE_COUNT, None)
        swung, rates = throw.joint_position_rad_m[rows, free], throw.joint_velocity_rad_m_per_s
        return MeasuredMotion(t_s, position, velocity, acceleration, swung, rates[rows, free])
    gyro, force = _imu_at(throw, t_s)
    estimate = throw.joint_position_rad_m[int(np.flatnonzero(throw.t_s >= -1e-9)[0])]
    start = np.array([[estimate[1] + estimate[2] + estimate[4], estimate[5]]])
    angle, rate = swing_from_gyro(gyro[:, None], velocity[:, :1], start)
    swing, swing_rate = angle[:, 0], rate[:, 0]
    swing[:, 0] -= position[:, 1] + position[:, 2]
    swing_rate[:, 0] -= velocity[:, 1] + velocity[:, 2]
    from_force = force is not None and np.abs(start - start_angle(force)).max() < SAME_START_RAD
    return MeasuredMotion(
        t_s,
        position,
        velocity,
        acceleration,
        swing,
        swing_rate,
        gyro,
        force if from_force else None,
    )


def _imu_at(throw: ThrowData, t_s: Array) -> tuple[Array, Array | None]:
    """Angular rate (T, 3) at `t_s` without its bias; specific force (3,) of a gripper at rest, or None."""
    calm = (throw.imu_t_s <= REST_S) & (
        np.abs(throw.gyro_rad_per_s).max(axis=1) < REST_RATE_RAD_PER_S
    )
    rate = np.stack(
        [np.interp(t_s, throw.imu_t_s, throw.gyro_rad_per_s[:, axis]) for axis in range(3)], axis=1
    )
    if np.count_nonzero(calm) < 2:
        return rate, None
    return rate - throw.gyro_rad_per_s[calm].mean(axis=0), throw.accel_m_per_s2[calm].mean(axis=0)


def hung_at_rest(throws: Sequence[ThrowData]) -> bool:
    """Whether the grippers hung at rest when the throws began, rather than being placed off plumb."""
    return bool(np.median([_starts_calm(throw) for throw in throws]) > 0.5)


def _starts_calm(throw: ThrowData) -> bool:
    if bool((throw.t_s < -SETTLED_S).any()):
        return True
    is_recorded = bool((throw.imu_t_s <= -CALM_S).any())
    first_s, last_s = (-CALM_S, 0.0) if is_recorded else (0.0, REST_S)
    chosen = (throw.imu_t_s >= first_s) & (throw.imu_t_s <= last_s)
    if np.count_nonzero(chosen) < CALM_COUNT:
        return False
    line = np.polyfit(throw.imu_t_s[chosen], throw.gyro_rad_per_s[chosen], 1)
    return bool(np.abs(line[0]).max() < CALM_RAD_PER_S2)


def measured_opening_s(throw: ThrowData) -> float:
    """Moment of release from the gripper switch, s; NaN without a report."""
    return throw.switch_open_t_s - SWITCH_LAG_S - SWITCH_TICK_S


def replay_input(
    throw: ThrowData,
    motion: MeasuredMotion,
    progress_ratio: float,
    default_opening_s: float,
    *,
    is_hung: bool,
) -> ReplayInput:
    """The throw as input of the twin's replay.

    Args:
        throw: the log.
        motion: its measured motion.
        progress_ratio: place of the throw in its set, 0 to 1.
        default_opening_s: used where the switch reported nothing.
        is_hung: whether the gripper hung at rest when the throw began.
    """
    rows = rows_of_interest(throw)
    opening = measured_opening_s(throw)
    height = float(throw.impact_m[2])
    return ReplayInput(
        valve_ratio=throw.valve_ratio[rows],
        gripper_open=throw.gripper_open[rows],
        position_rad_m=motion.position_rad_m,
        velocity_rad_m_per_s=motion.velocity_rad_m_per_s,
        swing_start_rad=motion.swing_rad[0],
        swing_rate_start_rad_per_s=motion.swing_rate_rad_per_s[0],
        release_t_s=throw.open_command_t_s,
        surface_height_m=height if np.isfinite(height) else float(throw.target_m[2]),
        progress_ratio=progress_ratio,
        hung_at_rest=is_hung,
        opening_t_s=opening if np.isfinite(opening) else default_opening_s,
        swing_rad=motion.swing_rad,
        swing_rate_rad_per_s=motion.swing_rate_rad_per_s,
        gyro_rad_per_s=motion.gyro_rad_per_s,
        start_force_m_per_s2=motion.start_force_m_per_s2,
    )
