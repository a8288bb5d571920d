"""Sensor noise of the twin: one table of normal numbers, read by every machine at its own offset."""

from functools import cache

import numpy as np

from machine.conventions import Array, IntArray
from sim_twin.twin.profile import TwinProfile

NOISE_TABLE_SIZE = 1 << 17
NOISE_CHANNELS = 14


@cache
def _windows() -> Array:
    """All windows of 14 consecutive numbers of the table; a view."""
    table = np.random.default_rng(20_240_519).standard_normal(NOISE_TABLE_SIZE + NOISE_CHANNELS)
    return np.lib.stride_tricks.sliding_window_view(table, NOISE_CHANNELS)


def noise_at(offset: IntArray, tick: int) -> Array:
    """Standard normal numbers (N, 14) of a tick, for machines at offsets (N,) of the table."""
    return _windows()[(offset + tick * NOISE_CHANNELS) % NOISE_TABLE_SIZE]


def noise_sd(profile: TwinProfile) -> Array:
    """Standard deviation of each noise channel (14,): positions, velocities, gyro, accelerometer."""
    n = profile.noise
    return np.asarray(
        [
            *n.joint_position_sd_rad_m,
            *n.joint_velocity_sd_rad_m_per_s,
            *[n.gyro_sd_rad_per_s] * 3,
            *[n.accel_sd_m_per_s2] * 3,
        ]
    )
