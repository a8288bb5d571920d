"""Cross-checks of the gripper IMU: its signal against itself and against the arm's motion; batched, pure."""

from typing import Final, NamedTuple

import numpy as np

from machine.conventions import CONTROL_PERIOD_S, GRAVITY_M_PER_S2, Array, BoolArray, IntArray
from runtime.driver import SensorSample

REPEAT_COUNT: Final = 8
"""Samples in a row with the same rates, or the same specific force: a living IMU is noisy."""
MOVING_RAD_OR_M_PER_S: Final = 0.1
"""A joint faster than this shakes the gripper."""
TURNING_RAD_PER_S: Final = 0.05
"""A gyro that reads more belongs to a pendulum in motion, whose rate changes."""
RATE_LIMIT_RAD_PER_S: Final = 8.7
"""Range of the gyro (500 degrees/s); throws stay below 4.5."""
FORCE_LIMITS_M_PER_S2: Final = (3.0, 30.0)
"""Specific force of a hanging gripper, as a mean over `SLOW_MEAN_S`; throws stay within 5.5 and 20."""
SLEW_LIMIT_RAD_PER_S: Final = 0.35
"""Slew rate of the gyro against that of the joint, as a mean over `MEAN_S`: the gripper cannot turn about the
vertical by itself. Healthy throws reach 0.19 (bias, mounting, delay of the samples)."""
MEAN_S: Final = 0.2
LEAST_SHARE: Final = 0.15
"""Ticks with a new sample, as a mean over `SLOW_MEAN_S`: 15 Hz; the data sheet's is 100."""
SLOW_MEAN_S: Final = 0.5
_MEAN: Final = 1.0 - np.exp(-CONTROL_PERIOD_S / MEAN_S)
_SLOW_MEAN: Final = 1.0 - np.exp(-CONTROL_PERIOD_S / SLOW_MEAN_S)


class ImuMemory(NamedTuple):
    """What the checks remember from tick to tick."""

    t_ns: IntArray
    """(N,) last sample."""
    numbers: Array
    """(N, 6) of it: rates, specific force."""
    same_count: IntArray
    """(N, 2) samples in a row with these rates, and with this specific force."""
    share: Array
    """(N,) mean share of ticks with a new sample."""
    slew_error: Array
    """(N,) mean difference between the slew rates of gyro and joint, rad/s."""
    force: Array
    """(N,) mean specific force, m/s2."""


def initial_imu(t_ns: IntArray, numbers: Array) -> ImuMemory:
    """Memory of machines whose last sample (N,) had these numbers (N, 6)."""
    count = len(t_ns)
    return ImuMemory(
        t_ns,
        numbers,
        np.zeros((count, 2), dtype=np.int64),
        np.ones(count),
        np.zeros(count),
        np.full(count, GRAVITY_M_PER_S2),
    )


def imu_numbers(sample: SensorSample) -> Array:
    """The six numbers (N, 6) of an IMU sample."""
    return np.concatenate([sample.imu_gyro_rad_per_s, sample.imu_accel_m_per_s2], axis=1)


def check_imu(
    memory: ImuMemory, sample: SensorSample, velocity: Array, swing_rad: Array, roll_rad: Array
) -> tuple[ImuMemory, BoolArray]:
    """One tick.

    Args:
        memory: of the last tick.
        sample: of this tick.
        velocity: (N, 4) of the joints.
        swing_rad: (N,) angle of the gripper from the vertical in the arm plane.
        roll_rad: (N,) across it.

    Returns:
        Memory, and machines (N,) whose IMU contradicts itself or the arm.
    """
    t_ns, now = sample.imu_t_mono_ns, imu_numbers(sample)
    is_new: BoolArray = t_ns > memory.t_ns
    same = (now == memory.numbers).reshape(-1, 2, 3).all(axis=2)
    count = np.where(same, memory.same_count + 1, 0)
    same_count = np.where(is_new[:, None], count, memory.same_count)
    share = memory.share + _SLOW_MEAN * (is_new - memory.share)
    gyro, force = now[:, :3], np.sqrt((now[:, 3:] ** 2).sum(axis=1))
    # The part of the rate that is about neither the pitch nor the roll axis.
    turn = gyro[:, 1] * np.sin(roll_rad) + gyro[:, 2] * np.cos(roll_rad)
    error = turn - velocity[:, 0] * np.cos(swing_rad)
    known = np.isfinite(error + force) & (t_ns > 0)
    error, force = np.where(known, error, 0.0), np.where(known, force, memory.force)
    error = memory.slew_error + _MEAN * (error - memory.slew_error)
    force = memory.force + _SLOW_MEAN * (force - memory.force)
    rate = np.abs(gyro).max(axis=1)
    moving = (np.abs(velocity) > MOVING_RAD_OR_M_PER_S).any(axis=1)
    low, high = FORCE_LIMITS_M_PER_S2
    wrong = (
        ((same_count >= REPEAT_COUNT).any(axis=1) & (moving | (rate > TURNING_RAD_PER_S)))
        | ((t_ns < memory.t_ns) & (t_ns > 0))
        | (is_new & moving & (share < LEAST_SHARE))
        | (rate > RATE_LIMIT_RAD_PER_S)
        | (force < low)
        | (force > high)
        | (np.abs(error) > SLEW_LIMIT_RAD_PER_S)
    )
    after = ImuMemory(
        np.maximum(t_ns, memory.t_ns),
        np.where(is_new[:, None], now, memory.numbers),
        same_count,
        share,
        error,
        force,
    )
    return after, wrong
