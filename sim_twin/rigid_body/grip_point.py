"""Position and velocity of points fixed to the gripper at an offset from the grip centre."""

import numpy as np

from machine.conventions import Array
from machine.kinematics import ToolState, grip_centre, swing_rad
from machine.spec import MachineSpec


def rotation_zyx(yaw_rad: Array, pitch_rad: Array, roll_rad: Array) -> Array:
    """Rotations (N, 3, 3) Rz(yaw) Ry(pitch) Rx(roll), angles (N,)."""
    ca, sa, cs, ss = np.cos(yaw_rad), np.sin(yaw_rad), np.cos(pitch_rad), np.sin(pitch_rad)
    cr, sr = np.cos(roll_rad), np.sin(roll_rad)
    rows = [
        [ca * cs, ca * ss * sr - sa * cr, ca * ss * cr + sa * sr],
        [sa * cs, sa * ss * sr + ca * cr, sa * ss * cr - ca * sr],
        [-ss, cs * sr, cs * cr],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def gripper_axes(joint_position_rad_m: Array) -> Array:
    """Rotation (N, 3, 3) from the gripper's frame to frame `machine`."""
    q = joint_position_rad_m
    return rotation_zyx(q[:, 0], -swing_rad(q), q[:, 5])


def gripper_rate(joint_position_rad_m: Array, joint_velocity_rad_m_per_s: Array) -> Array:
    """Angular velocity (N, 3) of the gripper in frame `machine`, rad/s."""
    q, v = joint_position_rad_m, joint_velocity_rad_m_per_s
    swing_rate, swing = swing_rad(v), swing_rad(q)
    ca, sa = np.cos(q[:, 0]), np.sin(q[:, 0])
    # The roll axis tilts with the swing, which turns about -y of the arm plane.
    outward, up = v[:, 5] * np.cos(swing), v[:, 5] * np.sin(swing)
    return np.stack(
        [ca * outward + sa * swing_rate, sa * outward - ca * swing_rate, v[:, 0] + up], axis=-1
    )


def grip_point(
    spec: MachineSpec,
    joint_position_rad_m: Array,
    joint_velocity_rad_m_per_s: Array,
    offset_m: Array | None,
) -> ToolState:
    """State of a point at an offset from the grip centre, frame `machine`.

    Args:
        spec: geometry.
        joint_position_rad_m: (N, 6).
        joint_velocity_rad_m_per_s: (N, 6).
        offset_m: (N, 3) from the nominal grip centre, gripper frame; None for none.
    """
    centre = grip_centre(spec, joint_position_rad_m, joint_velocity_rad_m_per_s)
    if offset_m is None:
        return centre
    beside = np.einsum("nij,nj->ni", gripper_axes(joint_position_rad_m), offset_m)
    rate = gripper_rate(joint_position_rad_m, joint_velocity_rad_m_per_s)
    carried: Array = np.asarray(np.cross(rate, beside), dtype=np.float64)
    return ToolState(centre.position_m + beside, centre.velocity_m_per_s + carried)
