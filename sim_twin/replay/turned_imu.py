"""Swing of the gripper from its gyro, for an IMU with mounting misalignment."""

import numpy as np

from machine.conventions import CONTROL_PERIOD_S, Array
from runtime.control.imu_estimator import joint_rates


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
    turning = np.moveaxis(rate_rad_per_s, -1, 1)
    angle = np.empty((ticks, *start_rad.T.shape))
    rates = np.empty_like(angle)
    angle[0] = start_rad.T
    for k in range(ticks):
        rates[k] = joint_rates(angle[k], turning[k], cabin_rad_per_s[k])
        if k + 1 < ticks:
            # Trapezoid with the next sample's rate at the present angles.
            ahead = joint_rates(angle[k], turning[k + 1], cabin_rad_per_s[k + 1])
            angle[k + 1] = angle[k] + 0.5 * CONTROL_PERIOD_S * (rates[k] + ahead)
    return np.moveaxis(angle, 1, -1), np.moveaxis(rates, 1, -1)
