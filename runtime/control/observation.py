"""What a policy sees: 65 numbers (3D) or 56 (2D), built from joints, gripper and target; then its pace.

Runs unchanged on numpy arrays (the machine, the twin) and on JAX arrays inside `jit` (the trainer): no
in-place writes, no branches on values. Refuses to know where the numbers come from.

Source: paper, section III-C and its table of observations. Frames: `throw` in 3D; in 2D the arm-plane
frame that turns with the cabin (machine.kinematics.grip_centre_in_plane_frame).
"""

from typing import NamedTuple

import numpy as np

from machine.conventions import ACTIVE_JOINTS, JOINT_NAMES, Array, BoolArray, Mode
from machine.kinematics import grip_centre, grip_centre_in_plane_frame, namespace, rotate_z
from machine.spec import MachineSpec

HISTORY_COUNT = 4
"""The present policy step and the three before it (paper: k .. k-3), 80 ms apart."""


def _observation_names(mode: Mode) -> tuple[str, ...]:
    joints = JOINT_NAMES if mode is Mode.SPATIAL else JOINT_NAMES[1:]
    ages = ("k", "k-1", "k-2", "k-3")
    return (
        *(f"{joint}_position_{age}" for age in ages for joint in joints),
        *(f"{joint}_velocity_{age}" for age in ages for joint in joints),
        *(f"previous_{name}" for name in ACTION_NAMES[mode]),
        *(f"grip_position_{axis}" for axis in "xyz"),
        *(f"grip_velocity_{axis}" for axis in "xyz"),
        "horizontal_error",
        "error",
        *(f"target_{axis}" for axis in "xyz"),
        "opened",
    )


ACTION_NAMES: dict[Mode, tuple[str, ...]] = {
    Mode.PLANAR: (*(f"{joint}_velocity" for joint in ACTIVE_JOINTS[1:]), "release"),
    Mode.SPATIAL: (*(f"{joint}_velocity" for joint in ACTIVE_JOINTS), "release"),
}
"""Velocity references in joint order (the slew only in 3D), then the release."""

OBSERVATION_NAMES: dict[Mode, tuple[str, ...]] = {mode: _observation_names(mode) for mode in Mode}
"""Order of the observation vector; the card of every policy repeats it."""

PACE_NAME = "pace"
"""Last entry of policies that were trained with a pace (0 careful .. 1 fast); the others have none."""


def observation_names(mode: Mode, is_paced: bool) -> tuple[str, ...]:
    """Names of all entries of a policy's observation."""
    return (*OBSERVATION_NAMES[mode], *((PACE_NAME,) if is_paced else ()))


class PolicyFrame(NamedTuple):
    """One instant as the policy sees it; leading axes (...)."""

    joint_position_rad_m: Array
    """(..., 6); in 3D the slew entry is the angle from the target's bearing."""
    joint_velocity_rad_m_per_s: Array
    """(..., 6)"""
    grip_position_m: Array
    """(..., 3) grip centre."""
    grip_velocity_m_per_s: Array
    """(..., 3)"""
    target_m: Array
    """(..., 3)"""


def start_turns(slew_rad: Array, target_m: Array) -> Array:
    """Whole turns (...) between the slew angle and the target's bearing at the start of a throw.

    Kept through the throw, so that the slew entry starts in [-pi, pi) and stays continuous.
    """
    xp = namespace(slew_rad)
    bearing = xp.arctan2(target_m[..., 1], target_m[..., 0])
    return xp.floor((slew_rad - bearing + np.pi) / (2.0 * np.pi))


def policy_frame(
    spec: MachineSpec,
    mode: Mode,
    joint_position_rad_m: Array,
    joint_velocity_rad_m_per_s: Array,
    target_m: Array,
    slew_turns_count: Array,
) -> PolicyFrame:
    """Turn joints and target into the policy's frame.

    Args:
        spec: geometry of the machine.
        mode: 2D or 3D; static under `jit`.
        joint_position_rad_m: (..., 6) all joints, continuous slew.
        joint_velocity_rad_m_per_s: (..., 6).
        target_m: (..., 3) frame `machine`.
        slew_turns_count: (...) from `start_turns`; unused in 2D.
    """
    q, v = joint_position_rad_m, joint_velocity_rad_m_per_s
    xp = namespace(q)
    if mode is Mode.PLANAR:
        grip = grip_centre_in_plane_frame(spec, q, v)
        offset = xp.asarray([0.0, spec.geometry.arm_plane_offset_m, 0.0])
        target = rotate_z(target_m, -q[..., 0]) - offset
        return PolicyFrame(q, v, grip.position_m, grip.velocity_m_per_s, target)
    bearing = xp.arctan2(target_m[..., 1], target_m[..., 0])
    slew = q[..., 0] - bearing - 2.0 * np.pi * slew_turns_count
    turned = xp.concatenate([slew[..., None], q[..., 1:]], axis=-1)
    # With the slew measured from the bearing, frame `machine` of the turned joints is frame `throw`.
    grip = grip_centre(spec, turned, v)
    range_m = xp.hypot(target_m[..., 0], target_m[..., 1])
    target = xp.stack([range_m, xp.zeros_like(range_m), target_m[..., 2]], axis=-1)
    return PolicyFrame(turned, v, grip.position_m, grip.velocity_m_per_s, target)


def start_history(joint_rad_m: Array) -> Array:
    """History (..., 4, 6) of a throw that begins: every entry is the present (..., 6)."""
    xp = namespace(joint_rad_m)
    return xp.stack([joint_rad_m] * HISTORY_COUNT, axis=-2)


def push_history(history_rad_m: Array, joint_rad_m: Array) -> Array:
    """History (..., 4, 6), newest first, after one more policy step with the present (..., 6)."""
    xp = namespace(joint_rad_m)
    return xp.concatenate([joint_rad_m[..., None, :], history_rad_m[..., :-1, :]], axis=-2)


def build(
    mode: Mode,
    frame: PolicyFrame,
    position_history_rad_m: Array,
    velocity_history_rad_m_per_s: Array,
    previous_action_ratio: Array,
    opened: BoolArray,
    pace_ratio: Array | None = None,
) -> Array:
    """Observation vector (..., 65) in 3D, (..., 56) in 2D, one more with a pace.

    Order in `observation_names`.

    Args:
        mode: 2D or 3D; static under `jit`.
        frame: the present, from `policy_frame`.
        position_history_rad_m: (..., 4, 6) in the policy's frame, newest (the present) first.
        velocity_history_rad_m_per_s: (..., 4, 6).
        previous_action_ratio: (..., 5) or (..., 4), as the policy gave it; clipped to [-1, 1] here.
        opened: (...) whether the release has been commanded.
        pace_ratio: (...) for a policy that was trained with a pace.
    """
    xp = namespace(frame.joint_position_rad_m)
    first = 0 if mode is Mode.SPATIAL else 1
    lead = position_history_rad_m.shape[:-2]
    width = HISTORY_COUNT * (len(JOINT_NAMES) - first)
    delta = frame.target_m - frame.grip_position_m
    horizontal = xp.hypot(delta[..., 0], delta[..., 1])
    return xp.concatenate(
        [
            position_history_rad_m[..., first:].reshape((*lead, width)),
            velocity_history_rad_m_per_s[..., first:].reshape((*lead, width)),
            xp.clip(previous_action_ratio, -1.0, 1.0),
            frame.grip_position_m,
            frame.grip_velocity_m_per_s,
            horizontal[..., None],
            xp.hypot(horizontal, delta[..., 2])[..., None],
            frame.target_m,
            xp.where(opened, 1.0, 0.0)[..., None],
            *([] if pace_ratio is None else [pace_ratio[..., None]]),
        ],
        axis=-1,
    )
