"""What the control step is given, remembers and gives; no behaviour."""

import math
from dataclasses import dataclass
from enum import IntFlag
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from machine.calibration import ValveCalibration
from machine.conventions import DEFAULT_PACE_RATIO, Array, BoolArray, IntArray, Mode
from machine.errors import PolicyError
from machine.spec import MachineSpec
from runtime.control.imu_estimator import ImuState
from runtime.control.policy import PolicyRunner
from runtime.control.policy_step import ThrowMemory
from runtime.control.safety import SafetyMemory
from runtime.control.swing_control import SwingState
from runtime.control.velocity_controller import ControllerState, VelocityController
from runtime.driver import SensorSample, ValveCommand
from runtime.guard.zones import Prisms


class Violation(IntFlag):
    """Why a motion must not go on; bits of `ControlOutputs.violation_count`."""

    SAFETY = 1
    """The safety gate closed all valves."""
    SWING = 2
    """The gripper swung beyond `spec.limits.swing_rad`."""
    IMU = 4
    """No usable gripper IMU sample for too long while it is needed."""
    POLICY = 8
    """The policy gave a number that is not finite."""
    RELEASE = 16
    """The gate refused the release: the load would come down outside the plan's region."""
    LATE = 32
    """The policy took too long for its tick."""
    ZONE = 64
    """The gate refused the release: the load would fly through an exclusion zone."""


@dataclass(frozen=True)
class ControlParams:
    """What stays constant while machines are controlled."""

    spec: MachineSpec
    calibration: ValveCalibration
    mode: Mode
    policy: PolicyRunner | None
    """Needed for THROW only."""

    def __post_init__(self) -> None:
        """Refuse a policy of the other mode."""
        if self.policy is not None and self.policy.card.mode is not self.mode:
            raise PolicyError(
                f"policy {self.policy.card.policy_id} is for mode {self.policy.card.mode.value}, "
                f"the control step runs mode {self.mode.value}; load the policy of that mode"
            )

    def aim(self, target_m: Array, slew_rad: Array) -> Array:
        """Aim point of the policy (N, 3): the target, corrected by the machine's registration.

        Args:
            target_m: (N, 3) frame `machine`.
            slew_rad: (N,) where the cabin stands when the throw begins.
        """
        if self.policy is None:
            return target_m
        return self.calibration.aim(self.policy.card.policy_sha256, target_m, slew_rad)

    def with_calibration(self, calibration: ValveCalibration) -> "ControlParams":
        """The same with another calibration."""
        return ControlParams(self.spec, calibration, self.mode, self.policy)

    @cached_property
    def controller(self) -> VelocityController:
        """Velocity controller with this machine's tables inverted."""
        return VelocityController(self.spec, self.calibration)


@dataclass(frozen=True, slots=True)
class ControlInputs:
    """What one tick is given."""

    sample: SensorSample
    motion: IntArray
    """(N,) conventions.Motion"""
    target_m: Array
    """(N, 3) frame `machine`; NaN where there is none."""
    pace_ratio: Array | float = DEFAULT_PACE_RATIO
    """(N,), or one for all machines; 0 careful .. 1 fast."""
    allowed_radius_m: float = math.inf
    """Of the region around the target in which a load may come down; infinite = no plan says so."""
    zones: Prisms | None = None
    """Exclusion zones of the machine."""
    aim_target_m: Array | None = None
    """(N, 3) what the policy and the cabin are given instead of the target; None = the target. The region in
    which a load may come down lies around the target."""

    @property
    def given_target_m(self) -> Array:
        """(N, 3) point that policy and cabin are given."""
        return self.target_m if self.aim_target_m is None else self.aim_target_m


@dataclass(frozen=True, slots=True)
class ControlOutputs:
    """What one tick gives."""

    command: ValveCommand
    row: NDArray[np.void]
    """(N,) telemetry.CONTROL_ROW; tick_count counts from `initial_state`."""
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
    motion_time_s: Array
    """(N,) since the present motion began."""


@dataclass(frozen=True, slots=True)
class ControlState:
    """What the control step remembers from tick to tick; opaque, made by `initial_state`."""

    tick_count: int
    motion: IntArray
    motion_tick_count: IntArray
    aim_m: Array
    """(N, 3) aim point of the policy, fixed when the present motion began."""
    speed_rad_m_per_s: Array
    """(N, 4) filtered."""
    imu: ImuState
    swing: SwingState
    throw: ThrowMemory
    controller: ControllerState
    safety: SafetyMemory
