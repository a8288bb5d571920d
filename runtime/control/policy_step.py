"""The policy's part of the control step: history, observation, action, latched release; batched.

Machines whose throws began at different ticks ask their policy at different ticks; only those are worked
out. It does not limit what the policy asks for: the velocity controller and the safety gate do.
"""

from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from machine.conventions import (
    DEFAULT_PACE_RATIO,
    POLICY_DECIMATION,
    RELEASE_THRESHOLD_RATIO,
    Array,
    BoolArray,
    IntArray,
    Mode,
    Motion,
)
from machine.errors import PolicyError
from machine.spec import MachineSpec
from machine.telemetry import POLICY_ROW
from runtime.control import observation
from runtime.control.policy import PolicyRunner

_ALIGN, _THROW = int(Motion.ALIGN), int(Motion.THROW)
Scalar = TypeVar("Scalar", bound=np.generic)


class ThrowMemory(NamedTuple):
    """What a throw remembers from policy step to policy step."""

    slew_turns_count: Array
    """(N,)"""
    position_history_rad_m: Array
    """(N, 4, 6) in the policy's frame, newest first."""
    velocity_history_rad_m_per_s: Array
    """(N, 4, 6)"""
    action_ratio: Array
    """(N, A) last raw action; 0 where it was not finite, or late."""
    request_rad_m_per_s: Array
    """(N, 4) held between policy steps."""
    released: BoolArray
    """(N,) the release was commanded; until the next ALIGN or THROW begins."""
    released_tick_count: IntArray
    """(N,) ticks since the release command."""


class PolicyInputs(NamedTuple):
    """What one tick offers to the policies."""

    position_rad_m: Array
    """(N, 6) joints."""
    velocity_rad_m_per_s: Array
    """(N, 6)"""
    target_m: Array
    """(N, 3) frame `machine`."""
    motion: IntArray
    """(N,)"""
    begins: BoolArray
    """(N,) the motion began at this tick."""
    motion_tick_count: IntArray
    """(N,) 0 at the motion's first tick."""
    now_ns: int
    pace_ratio: Array | float = DEFAULT_PACE_RATIO
    """(N,), or one for all machines; 0 careful .. 1 fast."""


class PolicyOutputs(NamedTuple):
    """What the policies of one tick gave."""

    memory: ThrowMemory
    row: NDArray[np.void] | None
    """(N,) POLICY_ROW; None when no policy ran."""
    failed: BoolArray
    """(N,) the policy gave a number that is not finite, or came too late."""
    late: BoolArray
    """(N,) it came too late."""


def initial_throw(mode: Mode, count: int) -> ThrowMemory:
    """Memory of `count` machines that have not thrown."""
    history = np.zeros((count, observation.HISTORY_COUNT, 6))
    return ThrowMemory(
        slew_turns_count=np.zeros(count),
        position_history_rad_m=history,
        velocity_history_rad_m_per_s=history,
        action_ratio=np.zeros((count, len(observation.ACTION_NAMES[mode]))),
        request_rad_m_per_s=np.zeros((count, 4)),
        released=np.zeros(count, dtype=np.bool_),
        released_tick_count=np.zeros(count, dtype=np.int64),
    )


def run_policies(
    spec: MachineSpec,
    mode: Mode,
    policy: PolicyRunner | None,
    memory: ThrowMemory,
    inputs: PolicyInputs,
) -> PolicyOutputs:
    """Ask the policy for the machines whose turn it is; keep what the others had.

    Raises:
        PolicyError: a machine throws and there is no policy, or it cannot run.
    """
    throws = inputs.motion == _THROW
    if np.count_nonzero(memory.released):
        memory = _wait(memory, inputs, throws)
    (due,) = (throws & (inputs.motion_tick_count % POLICY_DECIMATION == 0)).nonzero()
    failed = np.zeros(throws.shape, dtype=np.bool_)
    if due.size == 0:
        return PolicyOutputs(memory, None, failed, failed)
    if policy is None:
        raise PolicyError(
            f"a throw in mode {mode.value} needs a policy and none is loaded; "
            "see policies/active.json"
        )
    seen, memory = _observe(spec, mode, memory, inputs, due, policy.is_paced)
    raw = policy.infer(seen)
    usable: BoolArray = np.asarray(np.isfinite(raw).all(axis=1))
    late = np.zeros(throws.shape, dtype=np.bool_)
    if policy.is_late:
        # What it saw is over, a release by it above all.
        usable, late[due] = np.zeros_like(usable), True
    failed[due] = ~usable
    action = np.where(usable[:, None], raw, 0.0)
    request = np.zeros((due.size, 4))
    # 2D has no slew action: its three velocities fill the last three joints.
    request[:, 5 - action.shape[1] :] = (
        np.clip(action[:, :-1], -1.0, 1.0) * policy.action_scale_rad_m_per_s
    )
    opens = action[:, -1] > RELEASE_THRESHOLD_RATIO
    memory = memory._replace(
        action_ratio=_put(memory.action_ratio, due, action),
        request_rad_m_per_s=_put(memory.request_rad_m_per_s, due, request),
        released=_put(memory.released, due, memory.released[due] | opens),
    )
    return PolicyOutputs(memory, _row(mode, inputs, due, seen, raw), failed, late)


def _wait(memory: ThrowMemory, inputs: PolicyInputs, throws: BoolArray) -> ThrowMemory:
    """One more tick since the releases; a new ALIGN or THROW forgets its machine's."""
    released = memory.released & ~(inputs.begins & (throws | (inputs.motion == _ALIGN)))
    ticks = np.where(released, memory.released_tick_count + 1, 0)
    return memory._replace(released=released, released_tick_count=ticks)


def _observe(
    spec: MachineSpec,
    mode: Mode,
    memory: ThrowMemory,
    inputs: PolicyInputs,
    due: IntArray,
    is_paced: bool,
) -> tuple[Array, ThrowMemory]:
    """Observations (len(due), D) and the memory with their histories pushed."""
    begins, target = inputs.begins[due], inputs.target_m[due]
    position, velocity = inputs.position_rad_m[due], inputs.velocity_rad_m_per_s[due]
    turns = memory.slew_turns_count[due]
    if np.count_nonzero(begins):
        turns = np.where(begins, observation.start_turns(position[:, 0], target), turns)
    frame = observation.policy_frame(spec, mode, position, velocity, target, turns)
    positions = observation.push_history(
        memory.position_history_rad_m[due], frame.joint_position_rad_m
    )
    velocities = observation.push_history(
        memory.velocity_history_rad_m_per_s[due], frame.joint_velocity_rad_m_per_s
    )
    previous = memory.action_ratio[due]
    if np.count_nonzero(begins):
        start = begins[:, None, None]
        positions = np.where(start, frame.joint_position_rad_m[:, None], positions)
        velocities = np.where(start, frame.joint_velocity_rad_m_per_s[:, None], velocities)
        previous = np.where(begins[:, None], 0.0, previous)
    pace = np.broadcast_to(inputs.pace_ratio, inputs.motion.shape)[due] if is_paced else None
    released = memory.released[due]
    seen = observation.build(mode, frame, positions, velocities, previous, released, pace)
    return seen, memory._replace(
        slew_turns_count=_put(memory.slew_turns_count, due, turns),
        position_history_rad_m=_put(memory.position_history_rad_m, due, positions),
        velocity_history_rad_m_per_s=_put(memory.velocity_history_rad_m_per_s, due, velocities),
    )


def _put(values: NDArray[Scalar], index: IntArray, new: NDArray[Scalar]) -> NDArray[Scalar]:
    """A copy of `values` with the rows `index` replaced."""
    if index.size == values.shape[0]:
        return new
    result = values.copy()
    result[index] = new
    return result


def _row(
    mode: Mode, inputs: PolicyInputs, due: IntArray, seen: Array, raw: Array
) -> NDArray[np.void]:
    """What was seen and done; the pace, one number for the whole throw, is in the log's plan."""
    width = len(observation.OBSERVATION_NAMES[mode])
    row = np.zeros(inputs.motion.shape[0], dtype=POLICY_ROW)
    row["t_mono_ns"][due] = inputs.now_ns
    row["observation_ratio"][due, :width] = seen[:, :width]
    row["action_ratio"][due, : raw.shape[1]] = raw
    return row
