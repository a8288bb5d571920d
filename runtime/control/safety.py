"""The last gate before the valves: trusts nobody; knows the spec, the sensors and its own last output.

It shares no helper with the policy and the controller, does its own arithmetic, and clips or closes. It is
a permission: outside a motion that may move the machine, valves only brake; the gripper opens only where the
load would come down in the plan's region. It never opens a valve that was not asked for, and it is no
safety-rated function (docs/safety.md).
"""

from enum import IntFlag
from functools import cache
from typing import NamedTuple

import numpy as np

from machine.conventions import Array, BoolArray, IntArray, Motion
from machine.spec import MachineSpec
from runtime.driver import SensorSample
from runtime.guard.plausibility import Contradiction, GuardMemory, check, initial_guard
from runtime.guard.release_window import exceeds_tool_limits, is_allowed
from runtime.guard.zones import Prisms, arm_enters, flight_enters


class Intervention(IntFlag):
    """Why the applied command differs from the requested one; bits of `safety_code_count`."""

    NOT_FINITE = 1
    """A request, the last output or a joint sensor was not a number: all valves closed."""
    STALE_SENSORS = 2
    """Joint sensors older than 50 ms, or from the future: all valves closed."""
    LOCAL_DISABLED = 4
    """The enable switch at the machine is off: all valves closed."""
    EMERGENCY_STOP = 8
    """The hardwired emergency stop is pressed: all valves closed."""
    OVER_SPEED = 16
    """A joint moves faster than 1.5 times its limit: all valves closed."""
    STOPPED = 32
    """The motion is STOP or unknown: all valves closed."""
    POSITION_LIMIT = 64
    """A joint would run into its limit: its valve closed in that direction."""
    RANGE_CLIPPED = 128
    """A request beyond -1..1."""
    RATE_CLIPPED = 256
    """A request that moved faster than a valve may."""
    GRIPPER_KEPT_CLOSED = 512
    """Opening was asked for outside a throw."""
    NOT_PERMITTED = 1024
    """A valve was asked for in a hold that has ended its braking: all valves closed."""
    SENSOR_JUMP = 2048
    """Joint position against integrated velocity, or sensor time going back: all valves closed."""
    SENSOR_FROZEN = 4096
    """Joint values repeat under fresh time stamps: all valves closed."""
    VALVE_CONTRADICTED = 8192
    """A joint does not do what its valve says: all valves closed."""
    IMU_CONTRADICTED = 16384
    """The gripper IMU contradicts itself or the arm: all valves closed."""
    TOOL_LIMIT = 32768
    """Tool speed or overturning moment beyond their limits: all valves closed."""
    HOLD_CLIPPED = 65536
    """A hold asked for more than braking needs."""
    RELEASE_REFUSED = 131072
    """The load would come down outside the plan's allowed region: the gripper stays closed."""
    ARM_IN_ZONE = 262144
    """Arm or gripper are in an exclusion zone, or could no longer stop before it: all valves closed."""
    FLIGHT_IN_ZONE = 524288
    """The load would fly through an exclusion zone: the gripper stays closed, as RELEASE_REFUSED says."""


CLOSING = (
    Intervention.NOT_FINITE
    | Intervention.STALE_SENSORS
    | Intervention.LOCAL_DISABLED
    | Intervention.EMERGENCY_STOP
    | Intervention.OVER_SPEED
    | Intervention.STOPPED
    | Intervention.NOT_PERMITTED
    | Intervention.SENSOR_JUMP
    | Intervention.SENSOR_FROZEN
    | Intervention.VALVE_CONTRADICTED
    | Intervention.IMU_CONTRADICTED
    | Intervention.TOOL_LIMIT
    | Intervention.ARM_IN_ZONE
)
"""Bits that close all valves."""
LATCHING = CLOSING & ~(
    Intervention.LOCAL_DISABLED | Intervention.EMERGENCY_STOP | Intervention.STOPPED
)
"""Bits that no operator causes on purpose: they latch FAULT."""

SENSOR_AGE_MAX_NS = 50_000_000
"""Five control ticks without joint sensors."""
OVER_SPEED_RATIO = 1.5
VALVE_STEP_RATIO = 0.2
"""Change of a valve a tick of 10 ms: end to end in 0.1 s, faster than a spool moves (A)."""
TICK_S = 0.01
STOP_DELAY_S = 0.10
"""From closing a valve until the joint begins to slow: dead time of the arm's valves, with reserve."""
LIMIT_MARGIN_RAD_M = 0.01
"""Kept before a position limit."""
HOLD_TICKS = 200
"""A hold may brake for 2 s: the slew's valve closes 1.3 s after a throw is broken off."""
HOLD_RESERVE_RATIO = 0.1
"""A braking valve may exceed what was open when the hold began by so much: lead of the controller."""


# Enum members cost 0.1 us at each look-up, and the gate looks 20 times a tick.
_NOT_FINITE = int(Intervention.NOT_FINITE)
_STALE_SENSORS = int(Intervention.STALE_SENSORS)
_LOCAL_DISABLED = int(Intervention.LOCAL_DISABLED)
_EMERGENCY_STOP = int(Intervention.EMERGENCY_STOP)
_OVER_SPEED = int(Intervention.OVER_SPEED)
_STOPPED = int(Intervention.STOPPED)
_POSITION_LIMIT = int(Intervention.POSITION_LIMIT)
_RANGE_CLIPPED = int(Intervention.RANGE_CLIPPED)
_RATE_CLIPPED = int(Intervention.RATE_CLIPPED)
_GRIPPER_KEPT_CLOSED = int(Intervention.GRIPPER_KEPT_CLOSED)
_NOT_PERMITTED = int(Intervention.NOT_PERMITTED)
_TOOL_LIMIT = int(Intervention.TOOL_LIMIT)
_HOLD_CLIPPED = int(Intervention.HOLD_CLIPPED)
_RELEASE_REFUSED = int(Intervention.RELEASE_REFUSED)
_ARM_IN_ZONE = int(Intervention.ARM_IN_ZONE)
_FLIGHT_IN_ZONE = int(Intervention.FLIGHT_IN_ZONE)
_CLIP_BITS = (_RANGE_CLIPPED, _RATE_CLIPPED, _HOLD_CLIPPED, _POSITION_LIMIT)
_CONTRADICTIONS = (
    (Contradiction.JUMP | Contradiction.CLOCK, int(Intervention.SENSOR_JUMP)),
    (Contradiction.FROZEN, int(Intervention.SENSOR_FROZEN)),
    (Contradiction.FOLLOWING, int(Intervention.VALVE_CONTRADICTED)),
    (Contradiction.IMU, int(Intervention.IMU_CONTRADICTED)),
)
_FADE = TICK_S / STOP_DELAY_S
_HOLD, _THROW, _SETTLE, _STOP = (
    int(m) for m in (Motion.HOLD, Motion.THROW, Motion.SETTLE, Motion.STOP)
)


class ToolEstimate(NamedTuple):
    """Where the tool is and what a release is meant to hit."""

    position_rad_m: Array
    """(N, 6) all joints."""
    velocity_rad_m_per_s: Array
    """(N, 6)"""
    target_m: Array
    """(N, 3) frame `machine`."""
    allowed_radius_m: float
    """Of the plan's region around the target; infinite where there is no plan."""
    zones: Prisms | None = None
    """Exclusion zones; None where there are none."""

    @property
    def gripper_rad(self) -> Array:
        """(N, 2) swing from the vertical in the arm plane, and roll."""
        position = self.position_rad_m
        swing = position[:, 1] + position[:, 2] + position[:, 4]
        angles = np.empty((len(position), 2))
        angles[:, 0], angles[:, 1] = swing, position[:, 5]
        return angles


class SafetyMemory(NamedTuple):
    """What the gate remembers: what it let through, and what its cross-checks saw."""

    valve_ratio: Array
    """(N, 4) last."""
    recent_up_ratio: Array
    """(N, 4) highest valve of the last 0.1 s: what is still on its way to the joint; none below 0."""
    recent_down_ratio: Array
    """(N, 4) the same in the negative direction."""
    gripper_open: BoolArray
    """(N,)"""
    hold_start_ratio: Array
    """(N, 4) valves, without sign, when the present hold began."""
    hold_tick_count: IntArray
    """(N,) ticks of the present hold; 0 in every other motion."""
    guard: GuardMemory
    """Of the cross-checks."""


class SafetyOutput(NamedTuple):
    """What goes to the machine, and why."""

    valve_ratio: Array
    """(N, 4) within -1..1"""
    gripper_open: BoolArray
    """(N,)"""
    intervention_count: IntArray
    """(N,) bits of `Intervention`; 0 = as requested."""


class _Limits(NamedTuple):
    """All (1, 4)."""

    low: Array
    high: Array
    speed_positive: Array
    speed_negative: Array
    speed_negative_size: Array
    speed_gain: Array
    """What a joint may gain until a closed valve acts."""
    stop_per_speed_squared: Array


@cache
def _limits(spec: MachineSpec) -> _Limits:
    low = [-np.inf if v is None else v for v in spec.limits.position_min_rad_m]
    high = [np.inf if v is None else v for v in spec.limits.position_max_rad_m]
    speed_negative_size = OVER_SPEED_RATIO * np.asarray([spec.limits.speed_negative_rad_m_per_s])
    acceleration = np.asarray([spec.limits.acceleration_rad_m_per_s2])
    return _Limits(
        low=np.asarray([low]) + LIMIT_MARGIN_RAD_M,
        high=np.asarray([high]) - LIMIT_MARGIN_RAD_M,
        speed_positive=OVER_SPEED_RATIO * np.asarray([spec.limits.speed_positive_rad_m_per_s]),
        speed_negative=-speed_negative_size,
        speed_negative_size=speed_negative_size,
        speed_gain=STOP_DELAY_S * acceleration,
        stop_per_speed_squared=0.5 / acceleration,
    )


def closed_memory(count: int) -> SafetyMemory:
    """Memory of `count` machines at start-up: everything closed."""
    shut = np.zeros((count, 4))
    return SafetyMemory(
        shut,
        shut,
        shut,
        np.zeros(count, dtype=np.bool_),
        shut,
        np.zeros(count, dtype=np.int64),
        initial_guard(count),
    )


def apply(
    spec: MachineSpec,
    requested_ratio: Array,
    open_requested: BoolArray,
    memory: SafetyMemory,
    sample: SensorSample,
    motion: IntArray,
    now_ns: int,
    tool: ToolEstimate | None = None,
) -> tuple[SafetyMemory, SafetyOutput]:
    """Clip or close what the controller asks for.

    Args:
        spec: limits of position, speed and acceleration.
        requested_ratio: (N, 4) valves, -1..1.
        open_requested: (N,) gripper.
        memory: what this gate let through one tick ago.
        sample: joint sensors and switches of this tick.
        motion: (N,) conventions.Motion.
        now_ns: the tick, same clock as the sample.
        tool: for the limits of the tool and the release window; neither is checked without it.

    Returns:
        The memory for the next tick, and what may be written. A closing intervention resets the memory,
        so that the valves open again only through the rate limit.
    """
    limits = _limits(spec)
    hold_start, hold_ticks, hold_limit = _hold(memory, motion)
    with np.errstate(invalid="ignore", over="ignore"):
        gripper = None if tool is None else tool.gripper_rad
        guard, found = check(spec, memory.guard, sample, memory.valve_ratio, now_ns, gripper)
        bits = _closing_bits(limits, requested_ratio, memory, sample, motion, now_ns)
        bits = bits + _contradiction_bits(found)
        bits = bits + _permission_bits(requested_ratio, hold_limit, hold_ticks)
        if tool is not None:
            wild = exceeds_tool_limits(spec, tool.position_rad_m, tool.velocity_rad_m_per_s)
            bits = bits + wild * _TOOL_LIMIT
            if tool.zones is not None:
                entered = arm_enters(
                    spec, tool.zones, tool.position_rad_m, tool.velocity_rad_m_per_s
                )
                bits = bits + entered * _ARM_IN_ZONE
        closed: BoolArray = np.not_equal(bits, 0)
        any_closed = np.count_nonzero(closed) > 0
        if any_closed:
            # Nothing is wanted of machines that are closed; their numbers may be NaN.
            requested_ratio = np.where(closed[:, None], 0.0, requested_ratio)
        valve, clip_bits = _clip_valves(limits, requested_ratio, sample, memory, hold_limit)
    if any_closed:
        valve = np.where(closed[:, None], 0.0, valve)
        clip_bits = np.where(closed, bits, clip_bits)
    bits = clip_bits
    opened = open_requested
    if np.count_nonzero(open_requested):
        may_open = (motion == _THROW) | ((motion == _SETTLE) & memory.gripper_open)
        beginning = open_requested & may_open & ~memory.gripper_open
        strays = _strays(spec, beginning, tool)
        refused = strays | _refused_release(spec, beginning, tool)
        opened = open_requested & may_open & ~closed & ~refused
        bits = bits + (open_requested & ~opened) * _GRIPPER_KEPT_CLOSED + refused * _RELEASE_REFUSED
        bits = bits + strays * _FLIGHT_IN_ZONE
    after = SafetyMemory(
        valve_ratio=valve,
        recent_up_ratio=np.fmax(valve, memory.recent_up_ratio - _FADE),
        recent_down_ratio=np.fmax(-valve, memory.recent_down_ratio - _FADE),
        gripper_open=opened,
        hold_start_ratio=hold_start,
        hold_tick_count=hold_ticks,
        guard=guard,
    )
    return after, SafetyOutput(valve, opened, bits)


def _hold(memory: SafetyMemory, motion: IntArray) -> tuple[Array, IntArray, Array]:
    """Valves (N, 4) at the hold's start, its ticks (N,), and the opening (N, 4) that it may still ask for.

    A hold is no permission to move: it may brake, from what was open, for two seconds.
    """
    holding = motion == _HOLD
    ticks = np.where(holding, memory.hold_tick_count + 1, 0)
    start = np.where((ticks == 1)[:, None], np.abs(memory.valve_ratio), memory.hold_start_ratio)
    begun = start + HOLD_RESERVE_RATIO * (start > 0.0).any(axis=1, keepdims=True)
    left = np.maximum(1.0 - ticks / HOLD_TICKS, 0.0)[:, None]
    return start, ticks, np.where(holding[:, None], begun * left, 1.0)


def _permission_bits(requested_ratio: Array, hold_limit: Array, hold_ticks: IntArray) -> IntArray:
    """Holds (N,) that ask for a valve when nothing is left to brake."""
    forbidden = (hold_limit <= 0.0) & (requested_ratio != 0.0)
    if not np.count_nonzero(forbidden):
        return np.zeros(hold_ticks.shape, dtype=np.int64)
    return forbidden.any(axis=1) * _NOT_PERMITTED


def _contradiction_bits(found: IntArray) -> IntArray:
    """Bits of `Intervention` (N,) from those of the cross-checks."""
    bits = np.zeros_like(found)
    if np.count_nonzero(found):
        for cause, bit in _CONTRADICTIONS:
            bits = bits + (found & int(cause) != 0) * bit
    return bits


def _refused_release(spec: MachineSpec, opening: BoolArray, tool: ToolEstimate | None) -> BoolArray:
    """Machines (N,) that begin to open now although the load would come down elsewhere."""
    if tool is None or not np.count_nonzero(opening) or np.isinf(tool.allowed_radius_m):
        return np.zeros(opening.shape, dtype=np.bool_)
    allowed = is_allowed(
        spec,
        tool.position_rad_m,
        tool.velocity_rad_m_per_s,
        tool.target_m,
        tool.allowed_radius_m,
    )
    return opening & ~allowed


def _strays(spec: MachineSpec, opening: BoolArray, tool: ToolEstimate | None) -> BoolArray:
    """Machines (N,) that begin to open now although the load would fly through an exclusion zone."""
    if tool is None or tool.zones is None or not np.count_nonzero(opening):
        return np.zeros(opening.shape, dtype=np.bool_)
    return opening & flight_enters(
        spec,
        tool.zones,
        tool.position_rad_m,
        tool.velocity_rad_m_per_s,
        tool.target_m[:, 2],
    )


def _closing_bits(
    limits: _Limits,
    requested_ratio: Array,
    memory: SafetyMemory,
    sample: SensorSample,
    motion: IntArray,
    now_ns: int,
) -> IntArray:
    """Every reason (N,) to close all valves of a machine."""
    position, velocity = sample.joint_position_rad_m, sample.joint_velocity_rad_m_per_s
    finite = np.isfinite(requested_ratio + memory.valve_ratio + position + velocity)
    fast = (velocity > limits.speed_positive) | (velocity < limits.speed_negative)
    age_ns = now_ns - sample.t_mono_ns
    stale = age_ns > SENSOR_AGE_MAX_NS or age_ns < 0
    disabled, stopped = ~sample.local_enable, (motion < _HOLD) | (motion >= _STOP)
    # Sorting out the reasons costs more than seeing that there is none, as in nearly every tick.
    odd_joint_count = np.count_nonzero(fast | ~finite)
    odd_machine_count = np.count_nonzero(disabled | sample.emergency_stop | stopped)
    if not (stale or odd_joint_count or odd_machine_count):
        return np.zeros(motion.shape, dtype=np.int64)
    return (
        ~finite.all(axis=1) * _NOT_FINITE
        + stale * _STALE_SENSORS
        + disabled * _LOCAL_DISABLED
        + sample.emergency_stop * _EMERGENCY_STOP
        + fast.any(axis=1) * _OVER_SPEED
        + stopped * _STOPPED
    )


def _clip_valves(
    limits: _Limits,
    wanted: Array,
    sample: SensorSample,
    memory: SafetyMemory,
    hold_limit: Array,
) -> tuple[Array, IntArray]:
    """Range, rate, the hold's limit, and last the position limits, which may close faster than the rate."""
    position, velocity = sample.joint_position_rad_m, sample.joint_velocity_rad_m_per_s
    ranged = np.minimum(np.maximum(wanted, -1.0), 1.0)
    last = np.minimum(np.maximum(memory.valve_ratio, -1.0), 1.0)
    rated = np.minimum(np.maximum(ranged, last - VALVE_STEP_RATIO), last + VALVE_STEP_RATIO)
    held = np.minimum(np.maximum(rated, -hold_limit), hold_limit)
    # Where each joint would come to rest if its valve closed now, seen in both directions. What is still
    # on its way to the joint may speed it up until then.
    up, down = np.maximum(velocity, 0.0), np.maximum(-velocity, 0.0)
    up_coming = memory.recent_up_ratio * limits.speed_positive
    down_coming = memory.recent_down_ratio * limits.speed_negative_size
    up = np.fmax(up, np.fmin(up + limits.speed_gain, up_coming))
    down = np.fmax(down, np.fmin(down + limits.speed_gain, down_coming))
    slowing = limits.stop_per_speed_squared
    over = position + up * STOP_DELAY_S + slowing * up * up >= limits.high
    under = position - down * STOP_DELAY_S - slowing * down * down <= limits.low
    stops = ((held > 0.0) & over) | ((held < 0.0) & under)
    clipped = ranged != wanted, rated != ranged, held != rated, stops
    bits = np.zeros(wanted.shape[0], dtype=np.int64)
    for joints, bit in zip(clipped, _CLIP_BITS, strict=True):
        if np.count_nonzero(joints):
            bits += joints.any(axis=1) * bit
    return np.where(stops, 0.0, held), bits
