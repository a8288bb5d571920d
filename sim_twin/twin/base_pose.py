"""Pose of the machine's base on the ground: tilt, yaw, height, and a compliant chassis.

The survey frame is frame `machine` at the level pose of the survey.
"""

import numpy as np

from machine.conventions import GRAVITY_M_PER_S2, Array, IntArray
from machine.kinematics import ToolState, pin_in_plane, rotate_z
from machine.spec import MachineSpec
from sim_twin.effects.arrays import EffectArrays
from sim_twin.rigid_body.grip_point import gripper_axes, rotation_zyx
from sim_twin.rigid_body.model import twin_model
from sim_twin.twin.chassis_sway import ChassisSway

DIFFERENCE_S = 1e-4
"""Half of the time step of numerical derivatives."""


class BasePose:
    """Base of N machines; rotations from frame `machine` to the survey frame."""

    def __init__(self, spec: MachineSpec, arrays: EffectArrays) -> None:
        """Read the effects of the machines."""
        self._spec, self._count = spec, arrays.count
        roll, pitch = (
            arrays.filled("base_tilt", "roll_rad"),
            arrays.filled("base_tilt", "pitch_rad"),
        )
        self._level = rotation_zyx(np.zeros(arrays.count), pitch, roll)
        """(N, 3, 3) Ry(pitch) Rx(roll)."""
        # Legs and wheels tilt the chassis about its middle; it yields at the ground.
        middle = np.asarray(twin_model()[0].body("chassis").pos)
        self._shift_m = middle - self._level @ middle
        self._yaw = arrays.filled("base_yaw_drift", "yaw_rad")
        self._height = arrays.filled("base_height", "extra_height_m")
        give = arrays.get("chassis_compliance", "pitch_rad")
        self.sway = None if give is None else ChassisSway(spec, give)
        """State of the sway of a compliant chassis."""
        self.arm_kg = np.zeros(arrays.count)
        """(N,) mass of the arm with gripper and load; required for a compliant chassis."""
        self.leans = self.sway is not None or arrays.has("base_tilt")
        """Whether gravity in frame `machine` is not along -z."""

    def to_survey(self, rows: IntArray, point: ToolState, ahead_s: float) -> ToolState:
        """State of a point of the machines `rows` in the survey frame.

        Args:
            rows: (K,) indices of machines.
            point: (K, 3) frame `machine`.
            ahead_s: time after the base's state.
        """
        where, speed = point.position_m, point.velocity_m_per_s
        if self.sway is not None:
            turning = self.sway.rate_rad_per_s[rows] + ahead_s * self.sway.change_rad_per_s2[rows]
            lean = self.sway.lean_rad[rows] + ahead_s * turning
            where = _turned(where, lean)
            speed = _turned(speed, lean) + np.cross(turning, where)
        where = np.einsum("nij,nj->ni", self._level[rows], where) + self._shift_m[rows]
        where = rotate_z(where, self._yaw[rows])
        speed = rotate_z(np.einsum("nij,nj->ni", self._level[rows], speed), self._yaw[rows])
        where[:, 2] += self._height[rows]
        return ToolState(where, speed)

    def plumb_shift(self, position: Array) -> Array:
        """Pitch and roll (N, 2) of a gripper that hangs at rest relative to the machine's z axis."""
        lean = None if self.sway is None else self.sway.settled(position)
        down = rotate_z(self._down(lean), -position[:, 0])
        outward, left, below = down[:, 0], down[:, 1], -down[:, 2]
        return np.stack(
            [np.arctan2(outward, below), np.arctan2(left, np.hypot(outward, below))], -1
        )

    def start(self, position: Array) -> None:
        """Begin a throw at rest with joints (N, 6)."""
        if self.sway is not None:
            self.sway.start(position)

    def move(self, sensed: Array) -> None:
        """Advance by one tick; `sensed` are MuJoCo's sensors of a model with `sees_momentum`."""
        if self.sway is not None:
            self.sway.step(self.arm_kg, sensed[:, 6:9], sensed[:, 9:12], sensed[:, 12:15])

    def gravity(self, position: Array, velocity: Array) -> Array:
        """Gravity (N, 3) in frame `machine`, m/s2.

        Includes the inertial accelerations of a moving base at the tool pin:
        Euler and Coriolis acceleration a x p + 2 w x v; the centrifugal term is a thousandth of it.
        """
        felt = GRAVITY_M_PER_S2 * self._down(None if self.sway is None else self.sway.lean_rad)
        if self.sway is not None:
            pin, step = self._pin(position), DIFFERENCE_S * velocity
            speed = (self._pin(position + step) - self._pin(position - step)) / (2.0 * DIFFERENCE_S)
            felt -= np.cross(self.sway.change_rad_per_s2, pin)
            felt -= 2.0 * np.cross(self.sway.rate_rad_per_s, speed)
        return felt

    def free_joint_pull(self, position: Array) -> Array:
        """Angular acceleration (N, 2) of the free joints due to the base's angular acceleration."""
        if self.sway is None:
            return np.zeros((self._count, 2))
        slew, axes, spin = position[:, 0], gripper_axes(position), self.sway.change_rad_per_s2
        # The pitch axis is -y of the arm plane, the roll axis the gripper's x.
        pitch = spin[:, 1] * np.cos(slew) - spin[:, 0] * np.sin(slew)
        return np.stack([pitch, -np.einsum("ni,ni->n", axes[:, :, 0], spin)], axis=-1)

    def imu_turning(self, position: Array) -> Array | None:
        """Angular velocity (N, 3) of a moving base in the gripper's axes, rad/s."""
        if self.sway is None:
            return None
        return np.einsum("nji,nj->ni", gripper_axes(position), self.sway.rate_rad_per_s)

    def _down(self, lean_rad: Array | None) -> Array:
        """Direction of gravity (N, 3) in frame `machine`."""
        down = -self._level[:, 2, :]
        return down if lean_rad is None else _turned(down, -lean_rad)

    def _pin(self, position: Array) -> Array:
        """Tool pin (N, 3), frame `machine`."""
        plane = pin_in_plane(self._spec, position)
        offset = np.full(self._count, self._spec.geometry.arm_plane_offset_m)
        return rotate_z(np.stack([plane[:, 0], offset, plane[:, 1]], axis=-1), position[:, 0])


def _turned(vector: Array, rotation: Array) -> Array:
    """Rotate vectors (N, 3) by rotation vectors (N, 3); Rodrigues' formula."""
    angle = np.linalg.norm(rotation, axis=-1, keepdims=True)
    safe = np.where(angle > 0.0, angle, 1.0)
    axis = rotation / safe
    across = np.cross(axis, vector)
    return vector + np.sin(angle) * across + (1.0 - np.cos(angle)) * np.cross(axis, across)
