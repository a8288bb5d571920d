"""Effects between true motion and what sensors report: bias, latency, a crooked IMU.

The sensors' time stamps stay as they are; only the values are biased, late or turned.
"""

import math

import numpy as np

from machine.conventions import ACTIVE_COUNT, CONTROL_PERIOD_S, JOINT_COUNT, Array, IntArray
from sim_twin.effects.arrays import EffectArrays
from sim_twin.rigid_body.grip_point import rotation_zyx

_ANGLES = ("yaw", "pitch", "roll")


class DelayLine:
    """The last values of N machines, read back with a latency for each machine and channel.

    Between ticks it interpolates by a parabola through three rows. Linear interpolation would smooth away
    part of the noise that a replay of measured motion has, and rough motion would look like latency.
    """

    def __init__(self, latency_s: Array) -> None:
        """Hold as much as the longest latency needs.

        Args:
            latency_s: shape (N, C): of each channel.
        """
        ticks = np.maximum(latency_s, 0.0) / CONTROL_PERIOD_S
        self._whole: IntArray = np.floor(ticks + 1e-9).astype(np.int64)
        self._fraction = np.maximum(ticks - self._whole, 0.0)
        self._depth = math.ceil(float(ticks.max(initial=0.0))) + 3
        self._values = np.zeros((self._depth, *latency_s.shape))
        rows, channels = latency_s.shape
        self._at = np.arange(rows)[:, None], np.arange(channels)
        self._tick = 0

    def fill(self, values: Array) -> None:
        """As if the values (N, C) had always been these."""
        self._values[:] = values

    def push(self, values: Array) -> None:
        """Values (N, C) of a new tick."""
        self._tick += 1
        self._values[self._tick % self._depth] = values

    def read(self) -> Array:
        """Late values (N, C) as of the newest tick."""
        s = self._fraction
        weights = 0.5 * (s - 1.0) * (s - 2.0), s * (2.0 - s), 0.5 * s * (s - 1.0)
        late = np.zeros_like(s)
        for older, weight in enumerate(weights):
            row = (self._tick - self._whole - older) % self._depth
            late += weight * self._values[(row, *self._at)]
        return late


class SensorEffects:
    """Sensors of N machines; effects of the stage `aim` that sensors have."""

    def __init__(self, arrays: EffectArrays) -> None:
        """Look up what any of the machines has."""
        self.bias_rad_m = arrays.get("joint_sensor_bias", "bias_rad_m")
        late = arrays.get("joint_sensor_latency", "extra_latency_s")
        late_imu = arrays.get("imu_latency", "extra_latency_s")
        self._joints = None if late is None else DelayLine(np.tile(late, (1, 2)))
        self._imu = None if late_imu is None else DelayLine(_columns(late_imu, 6))
        self.latency_s: Array | None = None
        """(N, 6) of each joint's motion: the free joints' comes from the IMU."""
        if late is not None or late_imu is not None:
            self.latency_s = np.zeros((arrays.count, JOINT_COUNT))
            if late is not None:
                self.latency_s[:, :ACTIVE_COUNT] = late
            if late_imu is not None:
                self.latency_s[:, ACTIVE_COUNT:] = _columns(late_imu, 2)
        self.axes: Array | None = None
        """(N, 3, 3) from the IMU's axes to the gripper's."""
        if arrays.has("imu_misalignment"):
            angles = (arrays.filled("imu_misalignment", f"{a}_rad") for a in _ANGLES)
            self.axes = rotation_zyx(*angles)

    def start(self, joints: Array, imu: Array) -> None:
        """Begin at rest: joint positions and velocities (N, 8), gyro and accelerometer (N, 6)."""
        for line, values in ((self._joints, joints), (self._imu, imu)):
            if line is not None:
                line.fill(values)

    def push(self, joints: Array, imu: Array) -> None:
        """True values of a new tick."""
        for line, values in ((self._joints, joints), (self._imu, imu)):
            if line is not None:
                line.push(values)

    def joints(self, true: Array) -> tuple[Array, Array]:
        """Reported positions and velocities (N, 4) for the newest true ones (N, 8)."""
        values = true if self._joints is None else self._joints.read()
        position, velocity = values[:, :ACTIVE_COUNT], values[:, ACTIVE_COUNT:]
        return position if self.bias_rad_m is None else position + self.bias_rad_m, velocity

    def imu(self, true: Array) -> tuple[Array, Array]:
        """Reported turning rate and specific force (N, 3) for the newest true ones (N, 6)."""
        values = true if self._imu is None else self._imu.read()
        gyro, accel = values[:, :3], values[:, 3:]
        if self.axes is None:
            return gyro, accel
        return (
            np.einsum("nji,nj->ni", self.axes, gyro),
            np.einsum("nji,nj->ni", self.axes, accel),
        )


def _columns(values: Array, count: int) -> Array:
    """Values (N,) as (N, count)."""
    return np.repeat(values[:, None], count, axis=1)
