"""Lag of the driven joints' velocity sensors behind their position sensors, from throws alone.

A velocity sensor has a filter, its position sensor has none. A filter of time constant tau reports v - tau
dv/dt, so that position minus the integral of the reported velocity is a constant plus tau times the
reported velocity. A delay of both sensors alike does not show here; it is an effect (joint_sensor_latency).
"""

from collections.abc import Sequence

import numpy as np

from diagnosis.loading.measured import new_samples, white_noise_sd
from diagnosis.loading.throw_data import ThrowData
from machine.conventions import ACTIVE_COUNT, Array

LARGEST_SD_S = 0.002
"""A lag with a larger standard deviation counts as 0, s; 12 throws determine it to 0.5 ms."""


def velocity_lag_s(throws: Sequence[ThrowData]) -> Array:
    """Lag (4,) of the driven joints' velocity sensors behind their position sensors.

    Least squares per throw, weighted by precision. A scale error of either sensor is fitted beside the lag.
    """
    weight = np.zeros(ACTIVE_COUNT)
    weighed = np.zeros(ACTIVE_COUNT)
    for throw in throws:
        lag_s, precision = _of_throw(throw)
        weight += precision
        weighed += precision * lag_s
    is_known = weight * LARGEST_SD_S**2 >= 1.0
    return np.where(is_known, weighed / np.where(is_known, weight, 1.0), 0.0)


def _of_throw(throw: ThrowData) -> tuple[Array, Array]:
    """Lags (4,), s, and their precisions (4,), 1/s2, of one throw; precision 0 where it is not determined.

    The noise of a velocity sensor integrates to a random walk. Weighting by it would use the fastest motion
    alone, where noise hides the lag; all samples have equal weight, and the walk enters the precision.
    """
    keep = new_samples(throw.sensor_t_s)
    velocity = throw.sensor_velocity_rad_m_per_s[keep]
    position = throw.sensor_position_rad_m[keep]
    step_s = np.diff(throw.sensor_t_s[keep])[:, None]
    way = np.cumsum(0.5 * step_s * (velocity[1:] + velocity[:-1]), axis=0)
    walk_sd = white_noise_sd(velocity) * float(np.median(step_s)) if step_s.size else np.zeros(4)
    lag_s, precision = np.zeros(ACTIVE_COUNT), np.zeros(ACTIVE_COUNT)
    for joint in range(ACTIVE_COUNT):
        columns = np.column_stack([np.ones(way.shape[0]), way[:, joint], velocity[1:, joint]])
        free = columns.shape[0] - columns.shape[1]
        if free < 1 or np.linalg.matrix_rank(columns) < columns.shape[1]:
            continue
        inverse = np.linalg.pinv(columns)
        known = inverse @ position[1:, joint]
        left = position[1:, joint] - columns @ known
        white = float(inverse[2] @ inverse[2]) * max(float(left @ left), 1e-12) / free
        walked = np.cumsum(inverse[2, ::-1])
        lag_s[joint] = known[2]
        precision[joint] = 1.0 / (white + walk_sd[joint] ** 2 * float(walked @ walked))
    return lag_s, precision
