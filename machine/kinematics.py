"""Forward kinematics of the chain, batched; shapes (..., 6) in joint order, frame `machine`.

Arrays are of numpy or JAX: functions use the namespace of their arguments, so that training and runtime
share the code.

The planar chain gives the tool pin in the arm plane (x outward, z up); the slew rotates that plane, which
is ``arm_plane_offset_m`` beside the slew axis. With e(a) = (cos a, sin a), n(a) = (-sin a, cos a) and
a = boom + dipper, lengths in m:

    P_dipper = P_boom + 2.85 e(boom), P_boom = (0.698, 1.927)
    P_pin    = P_dipper + 0.366 e(a) - (1.47 + telescope + 0.87) n(a)
"""

from typing import Any, NamedTuple

import numpy as np

from machine.conventions import Array
from machine.spec import CylinderSpec, MachineSpec


def namespace(array: Any) -> Any:
    """Array library of an array: numpy, or jax.numpy in training."""
    return array.__array_namespace__() if hasattr(array, "__array_namespace__") else np


def components(array: Array) -> Any:
    """The K components of (K, N): rows (N,), or plain numbers if N is 1.

    Plain numbers are ten times as fast as arrays of one number, with bit-identical results.
    """
    return array if array.shape[1] != 1 else array[:, 0].tolist()


class ToolState(NamedTuple):
    """Position and velocity of a point, shape (..., 3), m and m/s, frame `machine`."""

    position_m: Array
    velocity_m_per_s: Array


def swing_rad(joint_position_rad_m: Array) -> Array:
    """Absolute swing of the gripper from the vertical in the arm plane, positive outward, shape (...)."""
    return (
        joint_position_rad_m[..., 1] + joint_position_rad_m[..., 2] + joint_position_rad_m[..., 4]
    )


def hanging_pitch_rad(active_position_rad_m: Array) -> Array:
    """Pitch joint angle of a plumb gripper, for active joints (..., 4)."""
    return -(active_position_rad_m[..., 1] + active_position_rad_m[..., 2])


def pin_in_plane(spec: MachineSpec, joint_position_rad_m: Array) -> Array:
    """Tool pin in the arm plane, shape (..., 2): x from the slew axis, z above ground, metres."""
    xp = namespace(joint_position_rad_m)
    g = spec.geometry
    boom = joint_position_rad_m[..., 1]
    tube = boom + joint_position_rad_m[..., 2]
    length = g.dipper_to_telescope_m + g.telescope_to_pin_m + joint_position_rad_m[..., 3]
    x = (
        g.boom_pivot_m[0]
        + g.boom_length_m * xp.cos(boom)
        + g.telescope_axis_offset_m * xp.cos(tube)
        + length * xp.sin(tube)
    )
    z = (
        g.slew_frame_height_m
        + g.boom_pivot_m[2]
        + g.boom_length_m * xp.sin(boom)
        + g.telescope_axis_offset_m * xp.sin(tube)
        - length * xp.cos(tube)
    )
    return xp.stack([x, z], axis=-1)


def grip_centre_in_plane_frame(
    spec: MachineSpec, joint_position_rad_m: Array, joint_velocity_rad_m_per_s: Array
) -> ToolState:
    """Grip centre in the frame of the arm plane, which rotates with the cabin (x outward, y left, z up).

    The origin is the foot of the slew axis, shifted by the arm-plane offset. Velocities are relative to the
    rotating frame: the slew rate does not enter.
    """
    xp = namespace(joint_position_rad_m)
    g = spec.geometry
    q, v = joint_position_rad_m, joint_velocity_rad_m_per_s
    boom, boom_rate = q[..., 1], v[..., 1]
    tube, tube_rate = boom + q[..., 2], boom_rate + v[..., 2]
    swing, swing_rate = tube + q[..., 4], tube_rate + v[..., 4]
    roll, roll_rate = q[..., 5], v[..., 5]
    length = g.dipper_to_telescope_m + g.telescope_to_pin_m + q[..., 3]
    pin = pin_in_plane(spec, q)
    pin_vx = (
        -g.boom_length_m * xp.sin(boom) * boom_rate
        - g.telescope_axis_offset_m * xp.sin(tube) * tube_rate
        + length * xp.cos(tube) * tube_rate
        + xp.sin(tube) * v[..., 3]
    )
    pin_vz = (
        g.boom_length_m * xp.cos(boom) * boom_rate
        + g.telescope_axis_offset_m * xp.cos(tube) * tube_rate
        + length * xp.sin(tube) * tube_rate
        - xp.cos(tube) * v[..., 3]
    )
    below = g.pitch_to_roll_m + g.roll_to_grip_centre_m * xp.cos(roll)
    below_rate = -g.roll_to_grip_centre_m * xp.sin(roll) * roll_rate
    position = xp.stack(
        [
            pin[..., 0] + below * xp.sin(swing),
            g.roll_to_grip_centre_m * xp.sin(roll),
            pin[..., 1] - below * xp.cos(swing),
        ],
        axis=-1,
    )
    velocity = xp.stack(
        [
            pin_vx + below * xp.cos(swing) * swing_rate + below_rate * xp.sin(swing),
            g.roll_to_grip_centre_m * xp.cos(roll) * roll_rate,
            pin_vz + below * xp.sin(swing) * swing_rate - below_rate * xp.cos(swing),
        ],
        axis=-1,
    )
    return ToolState(position, velocity)


def rotate_z(vector_m: Array, angle_rad: Array) -> Array:
    """Rotate vectors (..., 3) about z by angles (...)."""
    xp = namespace(angle_rad)
    c, s = xp.cos(angle_rad), xp.sin(angle_rad)
    x, y = vector_m[..., 0], vector_m[..., 1]
    return xp.stack([c * x - s * y, s * x + c * y, vector_m[..., 2]], axis=-1)


def grip_centre(
    spec: MachineSpec, joint_position_rad_m: Array, joint_velocity_rad_m_per_s: Array
) -> ToolState:
    """Grip centre in frame `machine`: position and velocity of a released load."""
    xp = namespace(joint_position_rad_m)
    local = grip_centre_in_plane_frame(spec, joint_position_rad_m, joint_velocity_rad_m_per_s)
    offset = xp.asarray([0.0, spec.geometry.arm_plane_offset_m, 0.0])
    slew = joint_position_rad_m[..., 0]
    position = rotate_z(local.position_m + offset, slew)
    turning = joint_velocity_rad_m_per_s[..., 0]
    carried = xp.stack(
        [-turning * position[..., 1], turning * position[..., 0], xp.zeros_like(turning)], axis=-1
    )
    return ToolState(position, rotate_z(local.velocity_m_per_s, slew) + carried)


def aligned_slew_rad(spec: MachineSpec, target_m: Array) -> Array:
    """Slew angle at which the arm plane contains targets (..., 3), frame `machine`.

    A target nearer to the slew axis than the plane's offset cannot be aligned; its bearing is returned.
    """
    xp = namespace(target_m)
    range_m = xp.hypot(target_m[..., 0], target_m[..., 1])
    bearing = xp.arctan2(target_m[..., 1], target_m[..., 0])
    ratio = xp.clip(spec.geometry.arm_plane_offset_m / xp.maximum(range_m, 1e-9), -1.0, 1.0)
    return bearing - xp.arcsin(ratio)


def to_throw_frame(vector_m: Array, target_m: Array) -> Array:
    """Rotate vectors (..., 3) from frame `machine` to `throw` (x downrange, y crossrange left)."""
    xp = namespace(target_m)
    return rotate_z(vector_m, -xp.arctan2(target_m[..., 1], target_m[..., 0]))


def cylinder_length_m(cylinder: CylinderSpec, angle_rad: Array) -> Array:
    """Pin-to-pin length of a cylinder at joint angles (...): |R(q) rod - base|."""
    xp = namespace(angle_rad)
    c, s = xp.cos(angle_rad), xp.sin(angle_rad)
    rod_x = c * cylinder.rod_xz_m[0] - s * cylinder.rod_xz_m[1]
    rod_z = s * cylinder.rod_xz_m[0] + c * cylinder.rod_xz_m[1]
    return xp.hypot(rod_x - cylinder.base_xz_m[0], rod_z - cylinder.base_xz_m[1])


def cylinder_arm_m(cylinder: CylinderSpec, angle_rad: Array) -> Array:
    """Signed lever arm dL/dq of a cylinder, m: cylinder speed per joint speed."""
    xp = namespace(angle_rad)
    c, s = xp.cos(angle_rad), xp.sin(angle_rad)
    rod_x = c * cylinder.rod_xz_m[0] - s * cylinder.rod_xz_m[1]
    rod_z = s * cylinder.rod_xz_m[0] + c * cylinder.rod_xz_m[1]
    dx, dz = rod_x - cylinder.base_xz_m[0], rod_z - cylinder.base_xz_m[1]
    return (dx * -rod_z + dz * rod_x) / xp.hypot(dx, dz)
