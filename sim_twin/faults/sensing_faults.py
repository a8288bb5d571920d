"""Faults of the virtual machine's sensors: new zero errors, values older than they claim.

A late sensor stamps its values with the time of the report, not of the measurement.
"""

import numpy as np

from machine.conventions import ACTIVE_COUNT, Array
from sim_twin.faults.fault import EffectSizes


class SensorDelay:
    """Delay line of N machines, one delay for each column, linear between physics steps."""

    def __init__(self, delay_s: Array, step_s: float) -> None:
        """Delays (N, width)."""
        whole, self._share = np.divmod(delay_s / step_s, 1.0)
        self._back = whole.astype(np.int64)
        self._ring = np.zeros((int(self._back.max()) + 2, *delay_s.shape))
        self._rows, self._columns = np.indices(delay_s.shape)
        self._head = -1

    def push(self, values: Array) -> None:
        """Take the newest values (N, width); the first ones fill the past."""
        if self._head < 0:
            self._ring[:] = values
        self._head = (self._head + 1) % self._ring.shape[0]
        self._ring[self._head] = values

    def clear(self) -> None:
        """Forget the past."""
        self._head = -1

    def delayed(self) -> Array:
        """Values (N, width) as late as they are seen."""
        near = (self._head - self._back) % self._ring.shape[0]
        newer = self._ring[near, self._rows, self._columns]
        older = self._ring[near - 1, self._rows, self._columns]
        return newer + self._share * (older - newer)


class FaultySensing:
    """Joint sensors and IMUs of N machines."""

    def __init__(self, sizes: EffectSizes, step_s: float) -> None:
        self.bias_rad_m = sizes.joints("joint_sensor_bias", "bias_rad_m")
        self._scale = 1.0 + sizes.joints("encoder_scale", "error_ratio")
        late = sizes.joints("joint_sensor_latency", "extra_latency_s")
        self._joints = SensorDelay(np.concatenate([late, late], axis=1), step_s)
        late_imu = sizes.machine("imu_latency", "extra_latency_s")
        self._imu = SensorDelay(np.tile(late_imu[:, None], (1, 6)), step_s)
        angles = [sizes.machine("imu_misalignment", f"{n}_rad") for n in ("roll", "pitch", "yaw")]
        self._turn = rotation(*angles)

    def clear(self) -> None:
        """A reset: the machines have stood where they are for a while."""
        self._joints.clear()
        self._imu.clear()

    def follow(self, position: Array, filtered_velocity: Array, gyro: Array, accel: Array) -> None:
        """Take true positions, filtered velocities (N, 4), IMU rates and forces (N, 3) of a physics step."""
        self._joints.push(np.concatenate([position, filtered_velocity], axis=1))
        self._imu.push(np.concatenate([gyro, accel], axis=1))

    def joints(self) -> tuple[Array, Array]:
        """Positions and velocities (N, 4) that the sensors see now, before their nominal errors."""
        seen = self._joints.delayed()
        return self._scale * seen[:, :ACTIVE_COUNT], self._scale * seen[:, ACTIVE_COUNT:]

    def imu(self) -> tuple[Array, Array]:
        """Rates and specific forces (N, 3) that the IMU sees now, in the IMU's axes."""
        seen = self._imu.delayed()
        gyro = np.einsum("nji,nj->ni", self._turn, seen[:, :3])
        return gyro, np.einsum("nji,nj->ni", self._turn, seen[:, 3:])


def rotation(roll_rad: Array, pitch_rad: Array, yaw_rad: Array) -> Array:
    """Rotations (N, 3, 3) Rz(yaw) Ry(pitch) Rx(roll)."""
    cr, sr = np.cos(roll_rad), np.sin(roll_rad)
    cp, sp = np.cos(pitch_rad), np.sin(pitch_rad)
    cy, sy = np.cos(yaw_rad), np.sin(yaw_rad)
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
