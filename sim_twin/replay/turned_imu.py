"""The swing of a gripper from its gyro, and what it was if the IMU is mounted askew."""

import numpy as np

from machine.conventions import CONTROL_PERIOD_S, Array
from runtime.control.imu_estimator import START_ANGLE_ZONE_RAD


def swing_from_gyro(
    rate_rad_per_s: Array, cabin_rad_per_s: Array, start_rad: Array
) -> tuple[Array, Array]:
    """Swing from the machine's vertical and roll, and their rates, (T, N, 2) each.

    In the swing frame the gripper turns with (cabin sin(swing) + roll', -swing', cabin cos(swing)).

    Args:
        rate_rad_per_s: (T, N, 3) turning rate in the gripper's frame, at control ticks.
        cabin_rad_per_s: (T, N) of the slew joint.
        start_rad: (N, 2) swing and roll at row 0.
    """
    ticks = rate_rad_per_s.shape[0]
    angle = np.empty((ticks, *start_rad.shape))
    rates = np.empty_like(angle)
    angle[0] = start_rad
    for k in range(ticks):
        rates[k] = _joint_rates(rate_rad_per_s[k], cabin_rad_per_s[k], angle[k])
        if k + 1 < ticks:
            # Trapezoid with the next sample's rate at the present angles.
            ahead = _joint_rates(rate_rad_per_s[k + 1], cabin_rad_per_s[k + 1], angle[k])
            angle[k + 1] = angle[k] + 0.5 * CONTROL_PERIOD_S * (rates[k] + ahead)
    return angle, rates


def _joint_rates(rate: Array, cabin: Array, angle: Array) -> Array:
    """Rates (N, 2) of swing and roll from turning rates (N, 3) at angles (N, 2)."""
    swing, roll = angle.T
    return np.stack(
        [
            np.sin(roll) * rate[:, 2] - np.cos(roll) * rate[:, 1],
            rate[:, 0] - cabin * np.sin(swing),
        ],
        axis=1,
    )


def tilt_at_start(force_m_per_s2: Array) -> Array:
    """Swing and roll (..., 2) at which the machine lets a gripper begin that feels this (..., 3).

    As `runtime.control.imu_estimator` does at its first sample: a small tilt is taken for plumb.
    """
    x, y, z = np.moveaxis(force_m_per_s2, -1, 0)
    tilt = np.stack([np.arctan2(x, z), np.arctan2(y, z)], axis=-1)
    return tilt - np.clip(tilt, -START_ANGLE_ZONE_RAD, START_ANGLE_ZONE_RAD)
