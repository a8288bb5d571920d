"""The control step: pure, batched, the same lines on the machine, in the twin and in every test.

`observation -> policy -> velocity controller -> safety gate -> valves` at 100 Hz, the policy on every
eighth tick of a throw. It keeps no clock, does no I/O and decides no motion: throw_states.py does.
"""

from dataclasses import dataclass
from enum import IntFlag

import numpy as np
from numpy.typing import NDArray

from machine.calibration import ValveCalibration
from machine.conventions import Array, BoolArray, IntArray, Mode
from machine.spec import MachineSpec
from runtime.driver import SensorSample, ValveCommand
from runtime.policy import PolicyRunner


class Violation(IntFlag):
    """Why a motion must not go on; bits of `ControlOutputs.violation_count`."""

    SAFETY = 1
    """The safety gate closed all valves."""
    SWING = 2
    """The gripper swung beyond `spec.limits.swing_rad`."""
    IMU = 4
    """No usable gripper IMU sample for too long while the policy drives."""
    POLICY = 8
    """The policy gave a number that is not finite."""


@dataclass(frozen=True, slots=True)
class ControlParams:
    """What stays constant while machines are controlled."""

    spec: MachineSpec
    calibration: ValveCalibration
    mode: Mode
    policy: PolicyRunner | None
    """Needed for THROW only."""


@dataclass(frozen=True, slots=True)
class ControlInputs:
    """What one tick is given."""

    sample: SensorSample
    motion: IntArray
    """(N,) conventions.Motion"""
    target_m: Array
    """(N, 3) frame `machine`; NaN where there is none."""


@dataclass(frozen=True, slots=True)
class ControlOutputs:
    """What one tick gives."""

    command: ValveCommand
    row: NDArray[np.void]
    """(N,) telemetry.CONTROL_ROW"""
    policy_row: NDArray[np.void] | None
    """(N,) telemetry.POLICY_ROW where any policy ran this tick; t_mono_ns 0 where this machine's did not."""
    release_commanded: BoolArray
    """(N,) latched from the release action until the next ALIGN or THROW begins."""
    load_gone: BoolArray
    """(N,) the release was commanded and the gripper switch says the load has left."""
    throw_done: BoolArray
    """(N,) the load has gone, or 0.6 s have passed since the release was commanded."""
    aligned: BoolArray
    """(N,) ALIGN has come to rest on the target line."""
    settled: BoolArray
    """(N,) SETTLE has come to rest in the safe pose."""
    violation_count: IntArray
    """(N,) bits of `Violation`."""


@dataclass(frozen=True, slots=True)
class ControlState:
    """What the control step remembers from tick to tick; opaque, made by `initial_state`."""


def initial_state(
    params: ControlParams, sample: SensorSample, target_m: Array, now_ns: int
) -> ControlState:
    """Memory of machines (N) about which nothing is known but one sample."""
    raise NotImplementedError


def step(
    params: ControlParams, state: ControlState, inputs: ControlInputs, now_ns: int
) -> tuple[ControlState, ControlOutputs]:
    """One tick of 10 ms for N machines; pure."""
    raise NotImplementedError


def next_motion(motion: IntArray, outputs: ControlOutputs) -> IntArray:
    """Motion (N,) of the next tick when nobody interferes: ALIGN -> THROW -> SETTLE; for rollouts."""
    raise NotImplementedError
