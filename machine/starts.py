"""Start poses of throws: random valid poses, and the safe pose."""

import numpy as np

from machine.conventions import JOINT_COUNT, Array, BoolArray, Mode
from machine.kinematics import (
    aligned_slew_rad,
    grip_centre_in_plane_frame,
    hanging_pitch_rad,
    pin_in_plane,
)
from machine.spec import MachineSpec

LIMIT_MARGIN_RAD_M = np.array([0.0, 0.12, 0.12, 0.12])
"""Distance of start positions from the joints' limits, room for the policy."""
MIN_GRIP_HEIGHT_M = 0.75
"""Smallest height of the grip centre above ground; the claws extend 0.35 m below it."""
PIN_RANGE_M = (3.6, 6.9)
"""Range of the tool pin's distance from the slew axis: clear of wheels and cabin, inside the reach."""
PIN_HEIGHT_M = (1.9, 4.6)
"""Range of the tool pin's height above ground."""

SAFE_ACTIVE_RAD_M = (0.0, 0.80, 0.0, 0.50)
"""Driven joints of the safe pose: boom raised, load clear of ground and machine; the slew is unchanged."""


def safe_pose(slew_rad: float = 0.0) -> Array:
    """Safe pose (6,), gripper plumb."""
    pose = np.zeros(JOINT_COUNT)
    pose[:4] = SAFE_ACTIVE_RAD_M
    pose[0] = slew_rad
    pose[4] = hanging_pitch_rad(pose[:4])
    return pose


def is_valid_start(spec: MachineSpec, pose_rad_m: Array) -> BoolArray:
    """Whether poses (..., 6) keep the required distances from limits, ground and machine; shape (...)."""
    low, high = spec.position_range_rad_m
    active = pose_rad_m[..., :4]
    inside = np.all(
        (active >= low + LIMIT_MARGIN_RAD_M) & (active <= high - LIMIT_MARGIN_RAD_M), axis=-1
    )
    pin = pin_in_plane(spec, pose_rad_m)
    grip = grip_centre_in_plane_frame(spec, pose_rad_m, np.zeros_like(pose_rad_m)).position_m
    return (
        inside
        & (pin[..., 0] >= PIN_RANGE_M[0])
        & (pin[..., 0] <= PIN_RANGE_M[1])
        & (pin[..., 1] >= PIN_HEIGHT_M[0])
        & (pin[..., 1] <= PIN_HEIGHT_M[1])
        & (grip[..., 2] >= MIN_GRIP_HEIGHT_M)
    )


def sample_starts(
    spec: MachineSpec, mode: Mode, target_m: Array, rng: np.random.Generator
) -> Array:
    """Random valid poses at rest with a plumb gripper, one for each target (N, 3); shape (N, 6).

    In 2D the arm plane is aligned with the target; in 3D the slew angle is random.
    """
    count = target_m.shape[0]
    low, high = spec.position_range_rad_m
    poses = np.empty((count, JOINT_COUNT))
    missing = np.arange(count)
    while missing.size:
        draw = np.zeros((missing.size, JOINT_COUNT))
        draw[:, 1:4] = rng.uniform(low[1:], high[1:], (missing.size, 3))
        draw[:, 4] = hanging_pitch_rad(draw[:, :4])
        good = is_valid_start(spec, draw)
        poses[missing[good]] = draw[good]
        missing = missing[~good]
    if mode is Mode.PLANAR:
        poses[:, 0] = aligned_slew_rad(spec, target_m)
    else:
        poses[:, 0] = rng.uniform(-np.pi, np.pi, count)
    return poses
