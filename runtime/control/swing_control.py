"""Motions without a policy: align the cabin, damp the swing, go to the safe pose; batched.

The gripper is a pendulum: a velocity profile averaged over one swing period leaves no swing behind, and a
pin that follows the swing takes energy out of it. It gives velocity requests only; limits, pump flow and
valves are dealt with where every request is.
"""

from typing import NamedTuple

import numpy as np

from machine.conventions import CONTROL_PERIOD_S, Array, BoolArray
from machine.spec import MachineSpec
from machine.starts import SAFE_ACTIVE_RAD_M
from runtime.control.arm_motion import ArmMotion
from runtime.control.follow_through import LEAD_S, follow_through
from runtime.control.imu_estimator import ImuEstimate, swing_frequency_rad_per_s

ALIGN_SPEED_RAD_PER_S = 0.45
"""Cruise of the cabin: the gripper then leans outward by 8 degrees at 6 m."""
ALIGN_GAIN_PER_S = 0.5
"""Position feedback around the planned turn; low, because the slew answers late and rings."""
ALIGN_RESPONSE_S = 0.45
"""The turn seen by the filtered sensor comes this much after its plan: dead time, lag, filter."""
ALIGN_REST_S = 0.8
"""From the end of a plan until the slew stands and its angle can be judged."""
ALIGN_TOLERANCE_RAD = 0.0025
"""25 mm across the line at 10 m."""
SMALL_TURN_RAD = 0.05
SMALL_TURN_RAD_PER_S = 0.03
"""Corrections go in two halves, half a swing period apart, so that the second takes the swing of the
first away; a slower one would stay inside the valve's dead band."""
TINY_TURN_RAD = 0.008
"""A correction that swings the gripper by less than a throw may start with goes at once."""
BREAKAWAY_S = 0.03
"""Friction and the valve's hysteresis swallow about this much of every pulse."""
ALIGNED_SWING_RAD = 0.030
"""Residual swing a throw may start with: three times what friction holds."""
STILL_RAD_M_PER_S = 0.03
DWELL_S = 0.30
"""How long a motion's end must hold before it counts."""
POSITION_FILTER_S = 0.10

DAMPING_M_PER_S_PER_RAD = 1.4
"""Pin speed a radian of swing: damping ratio k / (2 L omega0) = 0.23 with L = 0.92 m."""
DAMPING_DEAD_ZONE_RAD = 0.012
"""Swing that friction holds by itself is left alone."""
DAMPING_LEAD_S = (0.12, 0.25)
"""The swing is taken this much ahead, to meet the arm's (pitch) and the slew's (roll) delay."""
DAMPING_SPEED_M_PER_S = 0.6
TELESCOPE_WEIGHT = 0.5
"""Of a metre of the telescope against a radian of the dipper, squared."""
RETURN_GAIN_PER_S = 0.8
RETURN_SPEED_RAD_M_PER_S = (0.0, 0.15, 0.22, 0.15)
RETURN_SWING_RAD = 0.15
"""Swing at which the return to the safe pose runs at half speed."""
HOMED_RAD_M = 0.03
_ARM = np.array([False, True, True, True])
"""The axes of the arm plane."""
SETTLED_POSITION_RAD_M = 0.05
SETTLED_SWING_RAD = 0.05


class SwingState(NamedTuple):
    """Memory of the motions."""

    time_s: Array
    """(N,) since the motion began."""
    start_slew_rad: Array
    """(N,) where the present turn of ALIGN began."""
    turn_rad: Array
    """(N,) how far it goes, signed; the line is always start + turn."""
    slew_rad: Array
    """(N,) filtered slew angle."""
    homing: BoolArray
    """(N,) ALIGN also brings the arm to the safe pose, because no throw may start from where it was."""
    quiet_s: Array
    """(N,) how long the end condition of ALIGN or SETTLE has held."""


class SwingOutput(NamedTuple):
    """What a motion wants, and whether it is done."""

    request_rad_m_per_s: Array
    """(N, 4)"""
    done: BoolArray
    """(N,)"""


def initial_swing(slew_rad: Array) -> SwingState:
    """Memory of machines at slew angles (N,) that run no motion yet."""
    zero = np.zeros_like(slew_rad)
    return SwingState(zero, slew_rad, zero, slew_rad, zero.astype(np.bool_), zero)


def begin(
    state: SwingState, begins: BoolArray, slew_rad: Array, turn_rad: Array, homing: BoolArray
) -> SwingState:
    """Restart the memory of the machines (N,) whose motion begins; turn and homing (N,) are for ALIGN."""
    return SwingState(
        time_s=np.where(begins, 0.0, state.time_s),
        start_slew_rad=np.where(begins, slew_rad, state.start_slew_rad),
        turn_rad=np.where(begins, turn_rad, state.turn_rad),
        slew_rad=np.where(begins, slew_rad, state.slew_rad),
        homing=np.where(begins, homing, state.homing),
        quiet_s=np.where(begins, 0.0, state.quiet_s),
    )


def choose(first: BoolArray, one: SwingState, other: SwingState) -> SwingState:
    """Memory `one` for the machines (N,) where `first`, `other` for the rest."""
    return SwingState(*(np.where(first, a, b) for a, b in zip(one, other, strict=True)))


def swing_amplitude_rad(spec: MachineSpec, imu: ImuEstimate) -> Array:
    """Amplitude (N,) of a free swing through the present angles and rates, both axes together."""
    pitch, roll = swing_frequency_rad_per_s(spec)
    return np.sqrt(
        imu.swing_rad**2
        + (imu.swing_rate_rad_per_s / pitch) ** 2
        + imu.roll_rad**2
        + (imu.roll_rate_rad_per_s / roll) ** 2
    )


def turn_profile(time_s: Array, turn_rad: Array, period_s: float) -> tuple[Array, Array, Array]:
    """Angle (N,), rate (N,) and length (N,) in seconds of a turn that leaves no swing of `period_s`.

    Two pulses of the same area: for small turns half a period apart (tiny ones: together), for others a
    cruise that is moving-averaged over the period (ramps of one period; shorter turns have shorter ramps).
    """
    size = np.abs(turn_rad)
    small = size < SMALL_TURN_RAD
    short_s = 0.5 * size / SMALL_TURN_RAD_PER_S + BREAKAWAY_S
    pulse = np.where(small, short_s, size / ALIGN_SPEED_RAD_PER_S)
    apart = np.where(small, 0.5 * period_s, period_s) * (size > TINY_TURN_RAD)
    edges = np.maximum(
        np.stack([time_s, time_s - pulse, time_s - apart, time_s - apart - pulse]), 0
    )
    begun, squares = np.sign(edges), 0.5 * edges * edges
    ramp = ALIGN_SPEED_RAD_PER_S / period_s
    rate = np.where(
        small,
        SMALL_TURN_RAD_PER_S * (begun[0] - begun[1] + begun[2] - begun[3]),
        ramp * (edges[0] - edges[1] - edges[2] + edges[3]),
    )
    angle = np.where(
        small,
        SMALL_TURN_RAD_PER_S * (edges[0] - edges[1] + edges[2] - edges[3]),
        ramp * (squares[0] - squares[1] - squares[2] + squares[3]),
    )
    sign = np.sign(turn_rad)
    return sign * angle, sign * rate, np.where(size > 0.0, apart + pulse, 0.0)


def align(
    spec: MachineSpec, state: SwingState, active_position: Array, speed: Array, amplitude: Array
) -> tuple[SwingState, SwingOutput]:
    """Turn the cabin along its planned profile while the arm stands, or goes to the safe pose.

    Positions and filtered speeds are (N, 4), the swing's amplitude (N,). When a turn has come to rest off
    the line, another begins. Done when the line is held and the swing has died down.
    """
    period_s = 4.0 * np.pi / sum(swing_frequency_rad_per_s(spec))
    time_s = state.time_s + CONTROL_PERIOD_S
    share = CONTROL_PERIOD_S / POSITION_FILTER_S
    slew = state.slew_rad + share * (active_position[:, 0] - state.slew_rad)
    _, rate, length_s = turn_profile(time_s, state.turn_rad, period_s)
    due, _, _ = turn_profile(time_s - ALIGN_RESPONSE_S, state.turn_rad, period_s)
    follows = (time_s < length_s + ALIGN_RESPONSE_S) & (np.abs(state.turn_rad) >= SMALL_TURN_RAD)
    feedback = np.where(follows, ALIGN_GAIN_PER_S * (state.start_slew_rad + due - slew), 0.0)
    turning = time_s < length_s + ALIGN_REST_S * (length_s > 0.0)
    off_line = state.start_slew_rad + state.turn_rad - slew
    again = ~turning & (np.abs(off_line) > ALIGN_TOLERANCE_RAD)
    gap = np.asarray(SAFE_ACTIVE_RAD_M) - active_position
    fastest = np.asarray(RETURN_SPEED_RAD_M_PER_S)
    homing = state.homing & (np.abs(gap[:, 1:]).max(axis=1) > HOMED_RAD_M)
    home = np.minimum(np.maximum(RETURN_GAIN_PER_S * gap, -fastest), fastest)
    request = np.where(homing[:, None], home, 0.0)
    request[:, 0] = rate + feedback
    quiet = (
        ~turning
        & ~again
        & ~homing
        & (np.abs(speed).max(axis=1) < STILL_RAD_M_PER_S)
        & (amplitude < ALIGNED_SWING_RAD)
    )
    quiet_s = np.where(quiet, state.quiet_s + CONTROL_PERIOD_S, 0.0)
    after = SwingState(
        time_s=np.where(again, 0.0, time_s),
        start_slew_rad=np.where(again, slew, state.start_slew_rad),
        turn_rad=np.where(again, off_line, state.turn_rad),
        slew_rad=slew,
        homing=homing,
        quiet_s=quiet_s,
    )
    return after, SwingOutput(request, quiet_s >= DWELL_S)


def settle(
    spec: MachineSpec,
    state: SwingState,
    active_position: Array,
    speed: Array,
    arm: ArmMotion,
    imu: ImuEstimate,
    amplitude: Array,
) -> tuple[SwingState, SwingOutput]:
    """Damp the swing with dipper and slew while going to the safe pose, the calmer the faster.

    After a throw the large swing is first led away from the arm (runtime/control/follow_through.py).

    Args:
        spec: machine.
        state: memory.
        active_position: (N, 4).
        speed: (N, 4) joint velocities, filtered.
        arm: tool pin.
        imu: free joints.
        amplitude: (N,) of the swing.
    """
    time_s = state.time_s + CONTROL_PERIOD_S
    gap = np.asarray(SAFE_ACTIVE_RAD_M) - active_position
    request = _settle_request(spec, time_s, active_position, gap, arm, imu, amplitude)
    quiet = (
        (np.abs(gap[:, 1:]).max(axis=1) < SETTLED_POSITION_RAD_M)
        & (np.abs(speed).max(axis=1) < STILL_RAD_M_PER_S)
        & (amplitude < SETTLED_SWING_RAD)
    )
    quiet_s = np.where(quiet, state.quiet_s + CONTROL_PERIOD_S, 0.0)
    after = SwingState(
        time_s,
        state.start_slew_rad,
        state.turn_rad,
        active_position[:, 0],
        state.homing,
        quiet_s,
    )
    return after, SwingOutput(request, quiet_s >= DWELL_S)


def _settle_request(
    spec: MachineSpec,
    time_s: Array,
    active_position: Array,
    gap: Array,
    arm: ArmMotion,
    imu: ImuEstimate,
    amplitude: Array,
) -> Array:
    """Requests (N, 4) that damp the swing and close the gap (N, 4) to the safe pose."""
    pitch, roll = swing_frequency_rad_per_s(spec)
    swing = _ahead(imu.swing_rad, imu.swing_rate_rad_per_s, pitch, DAMPING_LEAD_S[0])
    lean = _ahead(imu.roll_rad, imu.roll_rate_rad_per_s, roll, DAMPING_LEAD_S[1])
    calm = 1.0 / (1.0 + (amplitude / RETURN_SWING_RAD) ** 2)
    fastest = np.asarray(RETURN_SPEED_RAD_M_PER_S)
    back = np.minimum(np.maximum(RETURN_GAIN_PER_S * gap, -fastest), fastest)
    request = back * calm[:, None]
    request[:, 0] = _pin_speed(lean, amplitude) / np.maximum(arm.radius_m, 2.0)
    # Outward speed by the dipper while the tube stands, by the telescope while it lies (least effort).
    dipper, telescope = arm.dipper_arm_m, TELESCOPE_WEIGHT * arm.telescope_arm_ratio
    outward = _pin_speed(swing, amplitude) / (
        dipper * dipper + telescope * arm.telescope_arm_ratio + 0.1
    )
    request[:, 2] += dipper * outward
    request[:, 3] += telescope * outward
    ahead = _ahead(imu.swing_rad, imu.swing_rate_rad_per_s, pitch, LEAD_S)
    first = follow_through(spec, time_s, active_position, ahead, amplitude)
    arm_axes = first.runs[:, None] & _ARM
    return np.where(arm_axes, first.request_rad_m_per_s, request)


def _ahead(angle: Array, rate: Array, frequency: float, lead_s: float) -> Array:
    """Angle of a free swing `lead_s` later."""
    phase = frequency * lead_s
    return angle * np.cos(phase) + rate * (np.sin(phase) / frequency)


def _pin_speed(angle: Array, amplitude: Array) -> Array:
    """Speed of the pin towards the load; nothing once friction will hold the rest."""
    wanted = np.maximum(DAMPING_M_PER_S_PER_RAD * angle, -DAMPING_SPEED_M_PER_S)
    wanted = np.minimum(wanted, DAMPING_SPEED_M_PER_S)
    return np.where(amplitude > 2.0 * DAMPING_DEAD_ZONE_RAD, wanted, 0.0)
