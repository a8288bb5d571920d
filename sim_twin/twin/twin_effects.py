"""Effects of a twin's machines, grouped by where in a tick they act, and prescribed motion."""

from typing import Any, NamedTuple

import numpy as np

from machine.conventions import ACTIVE_COUNT, Array, BoolArray, IntArray
from machine.kinematics import ToolState
from machine.spec import MachineSpec
from sim_twin.effects.arrays import EffectArrays
from sim_twin.effects.body_effects import BodyEffects
from sim_twin.effects.sensor_effects import SensorEffects
from sim_twin.rigid_body.grip_point import grip_point
from sim_twin.rigid_body.model import twin_model
from sim_twin.twin.base_pose import BasePose


class PrescribedMotion(NamedTuple):
    """Joint states (N, 6) at the end of the next tick, for joints with prescribed motion."""

    mask: BoolArray
    """(N, 6) joints with prescribed motion."""
    position_rad_m: Array
    velocity_rad_m_per_s: Array


class Readings(NamedTuple):
    """Sensor values before noise."""

    position_rad_m: Array
    velocity_rad_m_per_s: Array
    gyro_rad_per_s: Array
    accel_m_per_s2: Array


class TwinEffects:
    """Effects on body, base and sensors of N machines; a part without effects is None."""

    def __init__(self, spec: MachineSpec, arrays: EffectArrays, batch: Any) -> None:
        """Group the effects, and change the models of a `mujoco.batch.Batch`."""
        self._spec = spec
        self.body = BodyEffects(arrays) if arrays.acts_in("swing") else None
        self._base = BasePose(spec, arrays) if arrays.acts_on("base") else None
        self._sensors = SensorEffects(arrays) if arrays.acts_on("joint_sensor", "imu") else None
        if self.body is not None:
            self.body.change_models(batch)
        if self._base is not None and self._base.sway is not None:
            boom = twin_model()[0].body("boom").id
            self._base.arm_kg = np.array(batch.expand("body_subtreemass")[:, boom])
        leans = self._base is not None and self._base.leans
        self._gravity: Array | None = batch.expand("opt.gravity") if leans else None
        self._turning: Array | None = None
        self._rest = np.zeros((arrays.count, 2))

    def true_pose(self, reported_rad_m: Array, hangs: BoolArray | bool = True) -> Array:
        """True joint positions (N, 6) for positions reported at rest.

        The free joints are reported relative to plumb, from the IMU's gravity and the joint sensors.

        Args:
            reported_rad_m: (N, 6).
            hangs: (N,) whether plumb is the direction of gravity; else it is the machine's vertical.
        """
        pose = reported_rad_m.copy()
        if self._sensors is not None and self._sensors.bias_rad_m is not None:
            bias = self._sensors.bias_rad_m
            pose[:, :ACTIVE_COUNT] -= bias
            pose[:, ACTIVE_COUNT] += bias[:, 1] + bias[:, 2]
        if self._base is not None and self._base.leans:
            shift = self._base.plumb_shift(pose)
            pose[:, ACTIVE_COUNT:] += np.where(np.reshape(hangs, (-1, 1)), shift, 0.0)
        return pose

    def latency_s(self) -> Array | None:
        """Latencies (N, 6) of joint sensors and IMU; None if all are zero."""
        return None if self._sensors is None else self._sensors.latency_s

    def imu_axes(self) -> Array | None:
        """Rotations (N, 3, 3) from the IMU's axes to the gripper's; None if all are aligned."""
        return None if self._sensors is None else self._sensors.axes

    def begin(self, position: Array, velocity: Array) -> None:
        """Start from true states (N, 6), before the first physics step."""
        self._rest = position[:, ACTIVE_COUNT:].copy()
        if self._base is not None:
            self._base.start(position)
            self._lean(self._base, position, velocity)

    def fill_sensors(self, imu: Array, position: Array, velocity: Array) -> None:
        """Fill the sensors' delay lines with a state and IMU values (N, 6)."""
        if self._sensors is not None:
            self._sensors.start(np.concatenate([position, velocity], axis=1), self._felt(imu))

    def before_step(self, position: Array, velocity: Array, sensed: Array) -> Array | None:
        """Set gravity for the base's pose; return accelerations (N, 2) by base and hoses, rad/s2.

        Args:
            position: (N, 6) true joint positions.
            velocity: (N, 6)
            sensed: MuJoCo's sensors of the previous step.
        """
        pull = None
        if self._base is not None and (self._base.sway is not None):
            self._base.move(sensed)
            self._lean(self._base, position, velocity)
            pull = self._base.free_joint_pull(position)
        if self.body is not None:
            hose = self.body.hose_acceleration(position[:, ACTIVE_COUNT:], self._rest)
            if hose is not None:
                pull = hose if pull is None else hose + pull
        return pull

    def _lean(self, base: BasePose, position: Array, velocity: Array) -> None:
        if self._gravity is not None:
            self._gravity[:] = base.gravity(position, velocity)
        if base.sway is not None:
            self._turning = base.imu_turning(position)

    def after_step(self, imu: Array, position: Array, velocity: Array) -> None:
        """Pass the states (N, 6) after a step, and the IMU values (N, 6) before it, to the sensors."""
        if self._sensors is not None:
            joints = (position[:, :ACTIVE_COUNT], velocity[:, :ACTIVE_COUNT])
            self._sensors.push(np.concatenate(joints, axis=1), self._felt(imu))

    def _felt(self, imu: Array) -> Array:
        """True IMU values (N, 6), including the rotation of a moving base."""
        if self._turning is None:
            return imu
        return np.concatenate([imu[:, :3] + self._turning, imu[:, 3:]], axis=1)

    def readings(self, imu: Array, position: Array, velocity: Array) -> Readings:
        """Reported values for true joint states (N, 6) and IMU values (N, 6)."""
        true, felt = (position[:, :ACTIVE_COUNT], velocity[:, :ACTIVE_COUNT]), self._felt(imu)
        if self._sensors is None:
            return Readings(*true, felt[:, :3], felt[:, 3:])
        return Readings(
            *self._sensors.joints(np.concatenate(true, axis=1)), *self._sensors.imu(felt)
        )

    def load_state(
        self, rows: IntArray, position: Array, velocity: Array, ahead_s: float
    ) -> ToolState:
        """States of the held loads of machines `rows` (K,), survey frame.

        Args:
            rows: indices.
            position: (K, 6) true joint positions.
            velocity: (K, 6)
            ahead_s: time after the base's state.
        """
        offset = None if self.body is None else self.body.offset_m
        beside = None if offset is None else offset[rows]
        point = grip_point(self._spec, position, velocity, beside)
        return point if self._base is None else self._base.to_survey(rows, point, ahead_s)
