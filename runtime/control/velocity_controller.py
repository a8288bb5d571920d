"""Joint velocity control: from a wish to a reference the machine can follow, from there to valves.

`shape_reference` runs unchanged on numpy and JAX arrays, because the trainer must see the very reference
the machine follows. The controller itself is numpy only. It knows no valve delay as a fault: feedback
compares with the velocity that a machine of nominal response would have by now.
"""

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from machine.calibration import ValveCalibration, ValveTable, actuator_ratio
from machine.conventions import ACTIVE_COUNT, CONTROL_PERIOD_S, Array, BoolArray, IntArray
from machine.kinematics import namespace
from machine.spec import MachineSpec

FLOW_SHARE_RATIO = 0.90
"""Share of the pump that references may ask for: above it axes starve each other unpredictably."""
SOFT_STOP_ACCELERATION_RATIO = 0.5
"""Share of a joint's acceleration used to stop before a position limit; the rest is reserve."""
SOFT_STOP_DELAY_RATIO = 1.25
"""Of dead time and lag together: with less the late position lets a joint overshoot its stop (tested)."""
SOFT_STOP_MARGIN_RAD_M = 0.02
"""References end this far before a position limit, so that the safety gate has nothing to do there."""


class _ShapeConstants(NamedTuple):
    speed_positive: Array
    speed_negative: Array
    acceleration: Array
    stop_acceleration: Array
    stop_delay: Array
    stop_delay_squared: Array
    low: Array
    high: Array
    area_positive: Array
    area_negative: Array
    flow: float


@cache
def _shape_constants(spec: MachineSpec, axis_count: int) -> _ShapeConstants:
    """Constants over joints with as many axes as what they meet, which numpy answers with speed."""
    h, limits = spec.hydraulics, spec.limits
    quarter_pi = 0.25 * np.pi
    bores = np.array([h.boom_cylinder.bore_m, h.dipper_cylinder.bore_m, h.telescope_bore_m])
    rods = np.array([h.boom_cylinder.rod_m, h.dipper_cylinder.rod_m, h.telescope_rod_m])
    full, annulus = quarter_pi * bores**2, quarter_pi * (bores**2 - rods**2)
    slew = h.slew_displacement_m3_per_rad
    acceleration = np.asarray(limits.acceleration_rad_m_per_s2)
    low, high = spec.position_range_rad_m
    delay = np.asarray(spec.response.dead_time_s) + np.asarray(spec.response.lag_s)
    stop_delay = SOFT_STOP_DELAY_RATIO * delay

    def shaped(values: Sequence[float] | Array) -> Array:
        return np.asarray(values).reshape((1,) * (axis_count - 1) + (ACTIVE_COUNT,))

    return _ShapeConstants(
        speed_positive=shaped(limits.speed_positive_rad_m_per_s),
        speed_negative=shaped(limits.speed_negative_rad_m_per_s),
        acceleration=shaped(acceleration),
        stop_acceleration=shaped(SOFT_STOP_ACCELERATION_RATIO * acceleration),
        stop_delay=shaped(stop_delay),
        stop_delay_squared=shaped(stop_delay * stop_delay),
        # A continuous joint has limits too far away to matter; float32 must hold their square.
        low=shaped(np.maximum(low + SOFT_STOP_MARGIN_RAD_M, -1e6)),
        high=shaped(np.minimum(high - SOFT_STOP_MARGIN_RAD_M, 1e6)),
        # The dipper's cylinder shortens as the joint opens: its annulus fills on the positive side.
        area_positive=shaped([slew, full[0], annulus[1], full[2]]),
        area_negative=shaped([slew, annulus[0], full[1], annulus[2]]),
        flow=FLOW_SHARE_RATIO * h.pump_flow_m3_per_s,
    )


def flow_demand_m3_per_s(
    spec: MachineSpec, velocity_rad_m_per_s: Array, ratio_magnitude: Array
) -> Array:
    """Pump flow (...) that joint velocities (..., 4) take: actuator speed times the side that fills.

    Boom down counts with its annulus: the load may drive the cylinder, the pump still fills it.
    """
    k = _shape_constants(spec, velocity_rad_m_per_s.ndim)
    xp = namespace(velocity_rad_m_per_s)
    return _demand(xp, k, velocity_rad_m_per_s, ratio_magnitude)


def _demand(xp: Any, k: _ShapeConstants, velocity: Array, ratio_magnitude: Array) -> Array:
    area = xp.where(velocity >= 0.0, k.area_positive, k.area_negative)
    return (xp.abs(velocity) * ratio_magnitude * area).sum(axis=-1)


def _allocate(xp: Any, k: _ShapeConstants, velocity: Array, ratio_magnitude: Array) -> Array:
    demand = _demand(xp, k, velocity, ratio_magnitude)
    scale = k.flow / xp.maximum(demand, k.flow)
    return velocity * scale[..., None]


def shape_reference(
    spec: MachineSpec,
    request_rad_m_per_s: Array,
    previous_reference_rad_m_per_s: Array,
    active_position_rad_m: Array,
    dt_s: float,
) -> Array:
    """Turn requested joint velocities into references the machine can follow; shape (..., 4).

    In this order: speed limit of the direction and soft approach to position limits, share of the pump
    flow, acceleration limit, and once more limits and flow for what the acceleration limit held back.

    Args:
        spec: limits, cylinders, pump.
        request_rad_m_per_s: (..., 4) from the policy or from the motion being run.
        previous_reference_rad_m_per_s: (..., 4) what this function returned one tick ago.
        active_position_rad_m: (..., 4) as measured.
        dt_s: the tick.
    """
    ratio = namespace(request_rad_m_per_s).abs(actuator_ratio(spec, active_position_rad_m))
    return shape_with_ratio(
        spec,
        request_rad_m_per_s,
        previous_reference_rad_m_per_s,
        active_position_rad_m,
        ratio,
        dt_s,
    )


def shape_with_ratio(
    spec: MachineSpec,
    request_rad_m_per_s: Array,
    previous_reference_rad_m_per_s: Array,
    active_position_rad_m: Array,
    ratio_magnitude: Array,
    dt_s: float,
) -> Array:
    """`shape_reference` for a caller who already has |actuator_ratio| (..., 4)."""
    k = _shape_constants(spec, request_rad_m_per_s.ndim)
    xp = namespace(request_rad_m_per_s)
    upper = xp.minimum(k.speed_positive, _approach(xp, k, k.high - active_position_rad_m))
    lower = -xp.minimum(k.speed_negative, _approach(xp, k, active_position_rad_m - k.low))
    allowed = xp.minimum(xp.maximum(request_rad_m_per_s, lower), upper)
    wanted = _allocate(xp, k, allowed, ratio_magnitude)
    change = k.acceleration * dt_s
    previous = previous_reference_rad_m_per_s
    ramped = xp.minimum(xp.maximum(wanted, previous - change), previous + change)
    return _allocate(xp, k, xp.minimum(xp.maximum(ramped, lower), upper), ratio_magnitude)


def _approach(xp: Any, k: _ShapeConstants, distance: Array) -> Array:
    """Highest speed from which distance = v delay + v^2 / (2 a) still stops; 0 at or past the limit."""
    a, delay = k.stop_acceleration, k.stop_delay
    room = xp.maximum(distance, 0.0)
    return a * (xp.sqrt(k.stop_delay_squared + 2.0 * room / a) - delay)


ECHO_RATIO = (0.25, 0.35, 0.0, 0.0)
ECHO_DELAY_S = (0.30, 0.16, 0.0, 0.0)
"""Slew and boom ring at 1.5 to 2 Hz and 3 to 4 Hz. This share of the reference is sent half a period
later and cancels most of the ringing it would start (zero-vibration shaping); measured on the virtual
machine, as is everything below (docs/control.md)."""
LEAD_TIME_S = (0.05, 0.0, 0.0, 0.0)
"""Takes back some of the slew's delay by the known acceleration of its reference."""
RESPONSE_LAG_S = (0.19, 0.12, 0.08, 0.07)
"""First-order lag that is left after the dead time: what feedback expects the machine to do."""
INTEGRAL_PER_S = (0.3, 0.3, 0.3, 0.3)
"""Feedback is slow on purpose: at the ringing frequencies dead time turns a proportional term into
negative damping (gain 0.25 doubled the tracking error of slew and boom). Speed comes from the tables."""
INTEGRAL_LIMIT_RATIO = 0.20
"""The integrator may correct a table that is wrong by this share of the speed limit, not more."""
THRESHOLD_RAD_M_PER_S = (0.012, 0.006, 0.006, 0.006)
"""Actuator speed below which the feed-forward fades through the dead band instead of jumping across it."""
STANDSTILL_RAD_M_PER_S = 0.004
"""Reference and expected speed below which a joint counts as standing: no feedback, valve closed."""


class ControllerState(NamedTuple):
    """Memory of the velocity controller."""

    delay_line: Array
    """(D, N, 4) references of the last ticks, newest first."""
    expected: Array
    """(N, 4) what a machine of nominal response does now."""
    integral: Array
    """(N, 4) correction of the speed."""

    def forget(self, machines: BoolArray) -> "ControllerState":
        """The same with the memory of some machines (N,) as at standstill."""
        keep = ~machines[:, None]
        return ControllerState(self.delay_line * keep, self.expected * keep, self.integral * keep)


class VelocityController:
    """Feed-forward by the inverse valve tables of one machine, slow I on the difference from the expected."""

    def __init__(self, spec: MachineSpec, calibration: ValveCalibration) -> None:
        """Invert the tables once; the object holds constants only."""
        limits = spec.limits
        self._inverse = [
            _inverse_table(table, THRESHOLD_RAD_M_PER_S[joint])
            for joint, table in enumerate(calibration.tables)
        ]
        self._delay_ticks = _ticks(spec.response.dead_time_s)
        self._echo_ticks = _ticks(ECHO_DELAY_S)
        self._places_of: dict[int, IntArray] = {}
        # (1, 4), which numpy combines with one machine's (1, 4) twice as fast as (4,).
        self._blend = 1.0 - np.exp(-CONTROL_PERIOD_S / np.asarray([RESPONSE_LAG_S]))
        self._echo = np.asarray([ECHO_RATIO])
        self._lead = np.asarray([LEAD_TIME_S]) / CONTROL_PERIOD_S
        self._integral_step = np.asarray([INTEGRAL_PER_S]) * CONTROL_PERIOD_S
        self._integral_high = INTEGRAL_LIMIT_RATIO * np.minimum(
            [limits.speed_positive_rad_m_per_s], [limits.speed_negative_rad_m_per_s]
        )
        self._integral_low = -self._integral_high

    def initial(self, count: int) -> ControllerState:
        """Memory of `count` machines that stand still."""
        still = np.zeros((count, ACTIVE_COUNT))
        longest = max(self._delay_ticks.max(), self._echo_ticks.max())
        line = np.zeros((int(longest) + 1, count, ACTIVE_COUNT))
        return ControllerState(line, still, still)

    def update(
        self,
        state: ControllerState,
        reference_rad_m_per_s: Array,
        velocity_rad_m_per_s: Array,
        ratio_magnitude: Array,
    ) -> tuple[ControllerState, Array]:
        """One tick: references, measured velocities, |actuator_ratio|, all (N, 4), to valves (N, 4)."""
        reference = reference_rad_m_per_s
        line = np.concatenate([reference[None], state.delay_line[:-1]])
        echo, delayed = line.reshape(-1)[self._places(reference.shape[0])]
        expected = state.expected + self._blend * (delayed - state.expected)
        error = expected - velocity_rad_m_per_s
        moves = np.fmax(np.abs(reference), np.abs(expected)) > STANDSTILL_RAD_M_PER_S
        speed = (
            reference
            + self._echo * (echo - reference)
            + self._lead * (reference - state.delay_line[0])
            + np.where(moves, state.integral, 0.0)
        )
        valve = self._valve(speed * ratio_magnitude)
        # Anti-windup: a saturated valve takes no more of the same sign; a standing joint forgets.
        grows = moves & ((np.abs(valve) < 1.0) | (error * valve < 0.0))
        integral = np.where(moves, state.integral, 0.98 * state.integral)
        np.add(integral, self._integral_step * error, out=integral, where=grows)
        integral = np.minimum(np.maximum(integral, self._integral_low), self._integral_high)
        return ControllerState(line, expected, integral), valve

    def _places(self, count: int) -> IntArray:
        """Where echo and delayed reference (2, N, 4) stand in the flat delay line of N machines."""
        if count not in self._places_of:
            ticks = np.stack([self._echo_ticks, self._delay_ticks])[:, None]
            columns = np.arange(count * ACTIVE_COUNT).reshape(1, count, ACTIVE_COUNT)
            self._places_of[count] = ticks * (count * ACTIVE_COUNT) + columns
        return self._places_of[count]

    def _valve(self, actuator_speed: Array) -> Array:
        valve = np.empty_like(actuator_speed)
        for joint, (speeds, valves) in enumerate(self._inverse):
            valve[:, joint] = np.interp(actuator_speed[:, joint], speeds, valves)
        return valve


def _ticks(delays_s: tuple[float, ...]) -> IntArray:
    return np.rint(np.asarray(delays_s) / CONTROL_PERIOD_S).astype(np.int64)


def _inverse_table(table: ValveTable, threshold: float) -> tuple[Array, Array]:
    """Speeds and valves of the inverse; inside the threshold a straight line through zero."""
    speeds = np.asarray(table.actuator_speed_rad_m_per_s)
    valves = np.asarray(table.valve_ratio)
    edge = np.array([-threshold, threshold])
    edge_valve = np.interp(edge, speeds, valves)
    slow, fast = speeds < -threshold, speeds > threshold
    return (
        np.concatenate([speeds[slow], edge[:1], [0.0], edge[1:], speeds[fast]]),
        np.concatenate([valves[slow], edge_valve[:1], [0.0], edge_valve[1:], valves[fast]]),
    )
