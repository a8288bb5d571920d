"""The control step: pure, batched, the same lines on the machine, in the twin and in every test.

`observation -> policy -> velocity controller -> safety gate -> valves` at 100 Hz, the policy on every
eighth tick of a throw. It keeps no clock, does no I/O and decides no motion: runtime/throw/states.py does.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from machine.calibration import actuator_ratio_magnitude
from machine.conventions import (
    CONTROL_PERIOD_S,
    Array,
    BoolArray,
    IntArray,
    Mode,
    Motion,
    wrap_angle_rad,
)
from machine.kinematics import aligned_slew_rad
from machine.spec import MachineSpec
from machine.starts import is_valid_start
from machine.telemetry import CONTROL_ROW
from runtime.control import imu_estimator, safety, swing_control
from runtime.control.arm_motion import ArmMotion
from runtime.control.control_types import (
    ControlInputs,
    ControlOutputs,
    ControlParams,
    ControlState,
    Violation,
)
from runtime.control.policy_step import (
    PolicyInputs,
    PolicyOutputs,
    ThrowMemory,
    initial_throw,
    run_policies,
)
from runtime.control.velocity_controller import ControllerState, shape_with_ratio
from runtime.driver import SensorSample, ValveCommand

__all__ = [
    "ControlInputs",
    "ControlOutputs",
    "ControlParams",
    "ControlState",
    "Violation",
    "initial_state",
    "next_motion",
    "step",
]

RELEASE_WAIT_S = 0.6
"""The load leaves 0.258 s after the command (paper, III-F); a throw whose switch never says so ends here."""
IMU_AGE_MAX_S = 0.15
"""Older than any burst of lost packets that the extrapolation can bridge."""
SPEED_FILTER_S = 0.10
_HOLD, _ALIGN, _THROW, _SETTLE = (
    int(m) for m in (Motion.HOLD, Motion.ALIGN, Motion.THROW, Motion.SETTLE)
)
_CLOSING = int(safety.CLOSING)
_RELEASE_WAIT_TICKS = round(RELEASE_WAIT_S / CONTROL_PERIOD_S)
_VIOLATIONS = tuple(
    int(v)
    for v in (
        Violation.SAFETY,
        Violation.SWING,
        Violation.IMU,
        Violation.POLICY,
        Violation.RELEASE,
        Violation.LATE,
        Violation.ZONE,
    )
)
_RELEASE_REFUSED = int(safety.Intervention.RELEASE_REFUSED)
_FLIGHT_IN_ZONE = int(safety.Intervention.FLIGHT_IN_ZONE)
_CLOSING_ON_ITS_OWN = int(safety.CLOSING & ~safety.Intervention.STOPPED)


class _Sensed(NamedTuple):
    """What the sensors of one tick mean."""

    arm: ArmMotion
    imu: imu_estimator.ImuEstimate
    filtered_speed: Array
    position: Array
    """(N, 6) all joints."""
    velocity: Array
    begins: BoolArray
    any_begins: bool
    motion_tick: IntArray


class _Driven(NamedTuple):
    """What becomes of the requests of one tick."""

    controller: ControllerState
    memory: safety.SafetyMemory
    reference: Array
    valve: Array
    gated: safety.SafetyOutput


def initial_state(
    params: ControlParams, sample: SensorSample, target_m: Array, now_ns: int
) -> ControlState:
    """Memory of machines that hold, and about which nothing is known but one sample.

    Args:
        params: constants.
        sample: of this moment; the gripper is taken to be at rest.
        target_m: (N, 3); only its length is used.
        now_ns: the moment.
    """
    count = target_m.shape[0]
    arm = ArmMotion.of(params.spec, sample)
    imu, _ = imu_estimator.update(
        params.spec,
        imu_estimator.initial_imu(sample),
        sample,
        arm.velocity_rad_m_per_s,
        arm.radius_m,
        now_ns,
    )
    return ControlState(
        tick_count=0,
        motion=np.full(count, _HOLD),
        motion_tick_count=np.zeros(count, dtype=np.int64),
        aim_m=np.array(target_m, dtype=np.float64),
        speed_rad_m_per_s=sample.joint_velocity_rad_m_per_s,
        imu=imu,
        swing=swing_control.initial_swing(sample.joint_position_rad_m[:, 0]),
        throw=initial_throw(params.mode, count),
        controller=params.controller.initial(count),
        safety=safety.closed_memory(count),
    )


def step(
    params: ControlParams, state: ControlState, inputs: ControlInputs, now_ns: int
) -> tuple[ControlState, ControlOutputs]:
    """One tick of 10 ms for N machines; pure.

    Raises:
        PolicyError: a machine throws and there is no policy, or the policy cannot run.
    """
    spec, sample, motion = params.spec, inputs.sample, inputs.motion
    imu_state, sensed = _sense(params, state, inputs, now_ns)
    aim_m = _aim(params, state, inputs, sensed)
    policy = run_policies(
        spec,
        params.mode,
        params.policy,
        state.throw,
        PolicyInputs(
            sensed.position,
            sensed.velocity,
            aim_m,
            motion,
            sensed.begins,
            sensed.motion_tick,
            now_ns,
            inputs.pace_ratio,
        ),
    )
    throw = policy.memory
    swing, request, aligned, settled = _motions(params, state, inputs, sensed, throw)
    driven = _drive(params, state, inputs, sensed, throw, request, now_ns)
    gone = done = throw.released
    if np.count_nonzero(throw.released):
        gone = throw.released & ~sample.payload_held
        done = gone | (throw.released & (throw.released_tick_count >= _RELEASE_WAIT_TICKS))
    after = ControlState(
        tick_count=state.tick_count + 1,
        motion=motion,
        motion_tick_count=sensed.motion_tick,
        aim_m=aim_m,
        speed_rad_m_per_s=sensed.filtered_speed,
        imu=imu_state,
        swing=swing,
        throw=throw,
        controller=driven.controller,
        safety=driven.memory,
    )
    return after, ControlOutputs(
        command=ValveCommand(
            driven.gated.valve_ratio,
            driven.gated.gripper_open,
            supply_enabled=driven.gated.intervention_count & _CLOSING == 0,
            alive_count=state.tick_count,
        ),
        row=_row(state.tick_count, inputs, sensed, request, driven, now_ns),
        policy_row=policy.row,
        release_commanded=_commanded(throw.released, driven.gated),
        load_gone=gone,
        throw_done=done,
        aligned=aligned,
        settled=settled,
        violation_count=_violations(spec, motion, sensed, policy, driven.gated),
        motion_time_s=np.multiply(sensed.motion_tick, CONTROL_PERIOD_S, dtype=np.float64),
    )


def next_motion(motion: IntArray, outputs: ControlOutputs) -> IntArray:
    """Motion (N,) of the next tick when nobody interferes: ALIGN -> THROW -> SETTLE; for rollouts."""
    if not (np.count_nonzero(outputs.aligned) or np.count_nonzero(outputs.throw_done)):
        return motion
    starts = (motion == _ALIGN) & outputs.aligned
    ends = (motion == _THROW) & outputs.throw_done
    return np.where(starts, _THROW, np.where(ends, _SETTLE, motion))


def _sense(
    params: ControlParams, state: ControlState, inputs: ControlInputs, now_ns: int
) -> tuple[imu_estimator.ImuState, _Sensed]:
    sample = inputs.sample
    active, speed = sample.joint_position_rad_m, sample.joint_velocity_rad_m_per_s
    arm = ArmMotion.of(params.spec, sample)
    imu_state, imu = imu_estimator.update(
        params.spec, state.imu, sample, arm.velocity_rad_m_per_s, arm.radius_m, now_ns
    )
    count = active.shape[0]
    position, velocity = np.empty((count, 6)), np.empty((count, 6))
    position[:, :4], velocity[:, :4] = active, speed
    position[:, 4] = imu.swing_rad - active[:, 1] - active[:, 2]
    velocity[:, 4] = imu.swing_rate_rad_per_s - speed[:, 1] - speed[:, 2]
    position[:, 5], velocity[:, 5] = imu.roll_rad, imu.roll_rate_rad_per_s
    blend = CONTROL_PERIOD_S / SPEED_FILTER_S
    filtered = state.speed_rad_m_per_s + blend * (speed - state.speed_rad_m_per_s)
    begins: BoolArray = np.not_equal(inputs.motion, state.motion)
    any_begins = bool(np.count_nonzero(begins))
    ticks = state.motion_tick_count + 1
    if any_begins:
        ticks[begins] = 0
    return imu_state, _Sensed(arm, imu, filtered, position, velocity, begins, any_begins, ticks)


def _aim(
    params: ControlParams, state: ControlState, inputs: ControlInputs, sensed: _Sensed
) -> Array:
    """Aim points of the policies (N, 3), fixed when a motion begins: they depend on the slew angle."""
    if not sensed.any_begins:
        return state.aim_m
    aim_m = params.aim(inputs.given_target_m, sensed.position[:, 0])
    return np.where(sensed.begins[:, None], aim_m, state.aim_m)


def _motions(
    params: ControlParams,
    state: ControlState,
    inputs: ControlInputs,
    sensed: _Sensed,
    throw: ThrowMemory,
) -> tuple[swing_control.SwingState, Array, BoolArray, BoolArray]:
    """Velocity requests (N, 4) of whatever motion each machine runs, and whether it is done."""
    spec, motion = params.spec, inputs.motion
    active = inputs.sample.joint_position_rad_m
    running = set(motion.tolist())
    request = throw.request_rad_m_per_s
    if running != {_THROW}:
        request = np.where((motion == _THROW)[:, None], request, 0.0)
    aligned = settled = np.zeros(motion.shape, dtype=np.bool_)
    swing = state.swing
    if _ALIGN not in running and _SETTLE not in running:
        return swing, request, aligned, settled
    aligning, settling = motion == _ALIGN, motion == _SETTLE
    if sensed.any_begins:
        turn = np.zeros(motion.shape)
        if params.mode is Mode.PLANAR:
            target = np.where(aligning[:, None], inputs.given_target_m, (1.0, 0.0, 0.0))
            turn = wrap_angle_rad(aligned_slew_rad(spec, target) - active[:, 0])
        homing = aligning & ~is_valid_start(spec, sensed.position)
        swing = swing_control.begin(swing, sensed.begins, active[:, 0], turn, homing)
    before, amplitude = swing, swing_control.swing_amplitude_rad(spec, sensed.imu)
    if _ALIGN in running:
        swing, output = swing_control.align(spec, before, active, sensed.filtered_speed, amplitude)
        request = np.where(aligning[:, None], output.request_rad_m_per_s, request)
        aligned = aligning & output.done
    if _SETTLE in running:
        settled_swing, output = swing_control.settle(
            spec, before, active, sensed.filtered_speed, sensed.arm, sensed.imu, amplitude
        )
        request = np.where(settling[:, None], output.request_rad_m_per_s, request)
        settled = settling & output.done
        if running == {_SETTLE}:
            swing = settled_swing
        else:
            swing = swing_control.choose(settling, settled_swing, swing)
    return swing, request, aligned, settled


def _drive(
    params: ControlParams,
    state: ControlState,
    inputs: ControlInputs,
    sensed: _Sensed,
    throw: ThrowMemory,
    request: Array,
    now_ns: int,
) -> _Driven:
    """From velocity requests (N, 4) to what the safety gate lets through."""
    spec, sample, motion = params.spec, inputs.sample, inputs.motion
    active, speed = sample.joint_position_rad_m, sample.joint_velocity_rad_m_per_s
    ratio = actuator_ratio_magnitude(spec, active)
    previous = state.controller.delay_line[0]
    reference = shape_with_ratio(spec, request, previous, active, ratio, CONTROL_PERIOD_S)
    controller, valve = params.controller.update(state.controller, reference, speed, ratio)
    opening = throw.released
    if np.count_nonzero(opening):
        opening = opening & ((motion == _THROW) | (motion == _SETTLE))
    tool = safety.ToolEstimate(
        sensed.position,
        sensed.velocity,
        inputs.target_m,
        inputs.allowed_radius_m,
        inputs.zones,
    )
    memory, gated = safety.apply(spec, valve, opening, state.safety, sample, motion, now_ns, tool)
    closed: BoolArray = np.not_equal(gated.intervention_count & _CLOSING, 0)
    if np.count_nonzero(closed):
        # A machine whose valves were closed starts again from standstill, not from old wishes.
        controller = controller.forget(closed)
    return _Driven(controller, memory, reference, valve, gated)


def _commanded(released: BoolArray, gated: safety.SafetyOutput) -> BoolArray:
    """Releases (N,) that the gate did not refuse."""
    if not np.count_nonzero(released):
        return released
    return released & (gated.intervention_count & _RELEASE_REFUSED == 0)


def _violations(
    spec: MachineSpec,
    motion: IntArray,
    sensed: _Sensed,
    policy: PolicyOutputs,
    gated: safety.SafetyOutput,
) -> IntArray:
    imu, limit = sensed.imu, spec.limits.swing_rad
    swings = np.fmax(np.abs(imu.swing_rad), np.abs(imu.roll_rad)) > limit
    old = imu.age_s > IMU_AGE_MAX_S
    odd = swings | old | policy.failed
    if not (np.count_nonzero(odd) or np.count_nonzero(gated.intervention_count)):
        return np.zeros(motion.shape, dtype=np.int64)
    throws = (motion == _THROW) | (motion == _ALIGN)
    return (
        (gated.intervention_count & _CLOSING_ON_ITS_OWN > 0) * _VIOLATIONS[0]
        + (throws & swings) * _VIOLATIONS[1]
        + ((throws | (motion == _SETTLE)) & old) * _VIOLATIONS[2]
        + (policy.failed & ~policy.late) * _VIOLATIONS[3]
        + (gated.intervention_count & _RELEASE_REFUSED > 0) * _VIOLATIONS[4]
        + policy.late * _VIOLATIONS[5]
        + (gated.intervention_count & _FLIGHT_IN_ZONE > 0) * _VIOLATIONS[6]
    )


def _row(
    tick_count: int,
    inputs: ControlInputs,
    sensed: _Sensed,
    request: Array,
    driven: _Driven,
    now_ns: int,
) -> NDArray[np.void]:
    sample = inputs.sample
    row = np.empty(inputs.motion.shape[0], dtype=CONTROL_ROW)
    row["t_mono_ns"] = now_ns
    row["sensor_t_mono_ns"] = sample.t_mono_ns
    row["tick_count"] = tick_count
    row["motion_code_count"] = inputs.motion
    row["sensor_position_rad_m"] = sample.joint_position_rad_m
    row["sensor_velocity_rad_m_per_s"] = sample.joint_velocity_rad_m_per_s
    row["joint_position_rad_m"] = sensed.position
    row["joint_velocity_rad_m_per_s"] = sensed.velocity
    row["velocity_request_rad_m_per_s"] = request
    row["velocity_reference_rad_m_per_s"] = driven.reference
    row["valve_requested_ratio"] = driven.valve
    row["valve_applied_ratio"] = driven.gated.valve_ratio
    row["safety_code_count"] = driven.gated.intervention_count
    row["gripper_open_commanded"] = driven.gated.gripper_open
    row["payload_held"] = sample.payload_held
    row["supply_pressure_pa"] = sample.supply_pressure_pa
    return row
