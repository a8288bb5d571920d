"""Start of a previewed throw: pose, turn of the cabin before a 2D throw, scattered starts."""

import math

import numpy as np

from machine.conventions import JOINT_COUNT, Array, Mode, wrap_angle_rad
from machine.kinematics import aligned_slew_rad, hanging_pitch_rad
from machine.spec import MachineSpec
from runtime.control.imu_estimator import swing_frequency_rad_per_s
from runtime.control.swing_control import ALIGN_SPEED_RAD_PER_S, ALIGN_TOLERANCE_RAD, turn_profile
from sim_twin.twin.profile import Spread


def throw_start(
    spec: MachineSpec, mode: Mode, pose_rad_m: Array, target_m: Array, frame_period_s: float
) -> tuple[Array, Array]:
    """Pose (6,) in which the throw begins, and the frames (T, 6) of the cabin's turn to it.

    The gripper hangs plumb at both ends. In 3D, and where the arm is aligned already, T is 0.

    Args:
        spec: geometry.
        mode: 2D aligns the arm plane with the target first.
        pose_rad_m: (6,) present pose.
        target_m: (3,) frame `machine`.
        frame_period_s: time between frames.
    """
    pose = np.array(pose_rad_m, dtype=np.float64)
    pose[4], pose[5] = hanging_pitch_rad(pose[:4]), 0.0
    none = np.zeros((0, JOINT_COUNT))
    if mode is Mode.SPATIAL:
        return pose, none
    turn = float(wrap_angle_rad(aligned_slew_rad(spec, target_m) - pose[0]))
    aligned = pose.copy()
    aligned[0] += turn
    if abs(turn) <= ALIGN_TOLERANCE_RAD:
        return aligned, none
    angles = turn_angles_rad(spec, turn, frame_period_s)
    frames = np.repeat(pose[None], angles.size, axis=0)
    frames[:, 0] += angles
    return aligned, frames


def turn_angles_rad(spec: MachineSpec, turn_rad: float, frame_period_s: float) -> Array:
    """Angles (T,) of the planned ALIGN motion, one per frame, from 0 towards `turn_rad`.

    The turn is not simulated, because it ends at rest.
    """
    # Ramps of one swing period leave the gripper plumb.
    ramp_s = 2.0 * math.pi / (0.5 * sum(swing_frequency_rad_per_s(spec)))
    time_s = np.arange(0.0, ramp_s + abs(turn_rad) / ALIGN_SPEED_RAD_PER_S, frame_period_s)
    return turn_profile(time_s, np.full(time_s.size, turn_rad), ramp_s)[0]


def scattered_starts(
    spec: MachineSpec, spread: Spread, start_rad_m: Array, count: int, rng: np.random.Generator
) -> Array:
    """Poses (count, 6) scattered about a start (6,), as a machine reaches it."""
    sd = np.array([*spread.start_position_sd_rad_m, *spread.start_swing_sd_rad])
    poses = start_rad_m + rng.standard_normal((count, JOINT_COUNT)) * sd
    # The gripper hangs plumb from the scattered arm pose.
    poses[:, 4] += hanging_pitch_rad(poses[:, :4]) - hanging_pitch_rad(start_rad_m[:4])
    low, high = spec.position_range_rad_m
    poses[:, :4] = np.clip(poses[:, :4], low, high)
    return poses
