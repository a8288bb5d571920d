"""Viscous and Coulomb friction and effective length of the passive joints, from free swings in the gyro.

Model of one axis (paper, equation 3): x'' = -((g + u) / L) sin x - v x' - c sign x' - p / L cos x. p and u
are the horizontal and upward acceleration of the pin, which the swing itself causes in an arm on closed
valves. The model is fitted to the angular rate with a free gyro bias.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import butter, filtfilt

from diagnosis.identification.quantity import AxisSwing, mean_quantity, unknown
from diagnosis.loading.throw_data import ThrowData
from machine.conventions import CONTROL_PERIOD_S, GRAVITY_M_PER_S2, PASSIVE_JOINTS, Array
from machine.kinematics import pin_in_plane
from machine.spec import MachineSpec
from sim_twin.child_processes import one_blas_thread

PAPER_VISCOUS_PER_S, PAPER_COULOMB_RAD_PER_S2 = 0.03, 0.1
"""Paper, section III-F."""
QUIET_VALVE_RATIO = 0.01
AFTER_VALVE_S = 1.2
"""Time after a valve closes in which arm and oil still oscillate, s."""
MIN_FREE_S = 4.0
"""Shortest usable swing, s: two periods."""
MIN_RATE_RAD_PER_S = 0.25
"""Smallest usable peak rate; below it only Coulomb friction shows."""
OTHER_AXIS_RATIO = 0.3
"""A swing whose other axis exceeds this share of its rate is left out: the axes are coupled."""
END_RATE_RAD_PER_S = 0.03
PIN_BAND_HZ = 4.0
"""Cut-off of the pin's acceleration: above twice the swing's frequency, at which a swing pulls its pin
down."""
STEP_S = CONTROL_PERIOD_S
SMOOTH_RAD_PER_S = 0.005
"""Width of the smoothed sign function of Coulomb friction."""
MIN_SWINGS = 2
NAMES = ("viscous_friction_per_s", "coulomb_friction_rad_per_s2", "length_m")
UNITS = ("1/s", "rad/s2", "m")
LOW = np.array([0.0, 0.0, 0.3])
HIGH = np.array([0.5, 1.0, 2.5])


class FreeSwing(NamedTuple):
    """A stretch of free swing with closed valves; (n,) samples of 10 ms."""

    throw_id: str
    t_s: Array
    rate_rad_per_s: Array
    pin_m_per_s2: Array
    """Horizontal acceleration of the axis, in the direction of growing angle."""
    lift_m_per_s2: Array
    """Upward acceleration of the axis."""


def identify_swing(throws: Sequence[ThrowData], spec: MachineSpec) -> tuple[AxisSwing, AxisSwing]:
    """Friction and length of pitch and roll."""
    with one_blas_thread():
        return _axis(throws, spec, 0), _axis(throws, spec, 1)


def free_swings(throw: ThrowData, spec: MachineSpec, axis: int) -> list[FreeSwing]:
    """Stretches of free swing of one axis in a log; `axis` 0 is pitch, 1 roll."""
    t = throw.t_s
    busy = np.any(np.abs(throw.valve_ratio) > QUIET_VALVE_RATIO, axis=1)
    last = np.where(busy, t, -np.inf)
    since = t - np.maximum.accumulate(np.maximum(last, t[0] - AFTER_VALVE_S))
    free = (since >= AFTER_VALVE_S) & (t < throw.open_command_t_s)
    gyro = np.stack(
        [np.interp(t, throw.imu_t_s, throw.gyro_rad_per_s[:, k]) for k in range(3)], axis=1
    )
    rates = np.stack([-gyro[:, 1], gyro[:, 0]], axis=1)
    pin = _pin_acceleration(throw, spec)
    found: list[FreeSwing] = []
    edges = np.flatnonzero(np.diff(np.concatenate([[0], free.astype(np.int8), [0]])))
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        swing_rate = rates[first:end, axis] - np.median(rates[first:end, axis])
        other = rates[first:end, 1 - axis] - np.median(rates[first:end, 1 - axis])
        big = np.flatnonzero(np.abs(swing_rate) > END_RATE_RAD_PER_S)
        if big.size == 0 or np.max(np.abs(swing_rate)) < MIN_RATE_RAD_PER_S:
            continue
        if np.max(np.abs(other)) > OTHER_AXIS_RATIO * np.max(np.abs(swing_rate)):
            continue
        stop = int(min(big[-1] + round(1.0 / STEP_S), end - first))
        if stop * STEP_S < MIN_FREE_S:
            continue
        part = slice(first, first + stop)
        found.append(
            FreeSwing(
                throw.throw_id, t[part] - t[first], rates[part, axis], pin[part, axis], pin[part, 2]
            )
        )
    return found


def simulate_swing(swing: FreeSwing, x: Array) -> tuple[Array, Array]:
    """Angle and rate (n,) for viscous friction, Coulomb friction, length, initial angle and initial rate."""
    viscous, coulomb, length, angle, rate = (float(v) for v in x[:5])
    angles, rates = np.empty(swing.t_s.size), np.empty(swing.t_s.size)
    push = (swing.pin_m_per_s2 / length).tolist()
    pull = ((GRAVITY_M_PER_S2 + swing.lift_m_per_s2) / length).tolist()
    half = 0.5 * STEP_S
    sin, cos, tanh = math.sin, math.cos, math.tanh
    for k, (p, g) in enumerate(zip(push, pull, strict=True)):
        angles[k], rates[k] = angle, rate
        # Two half steps, symplectic: friction of a narrow sign stays stable at 5 ms.
        for _ in range(2):
            a = -g * sin(angle) - viscous * rate - p * cos(angle)
            rate += half * a
            drop = half * coulomb
            rate = rate - drop * tanh(rate / max(SMOOTH_RAD_PER_S, drop))
            angle += half * rate
    return angles, rates


def _pin_acceleration(throw: ThrowData, spec: MachineSpec) -> Array:
    """Acceleration (T, 3) of the pin from the joints: outward for pitch, leftward for roll, upward.

    Low-pass filtered forward and backward: only the swing's frequency and its double matter.
    """
    position = np.stack(
        [
            np.interp(throw.t_s, throw.sensor_t_s, throw.sensor_position_rad_m[:, k])
            for k in range(4)
        ],
        axis=1,
    )
    velocity = np.stack(
        [
            np.interp(throw.t_s, throw.sensor_t_s, throw.sensor_velocity_rad_m_per_s[:, k])
            for k in range(4)
        ],
        axis=1,
    )
    coefficients: Any = butter(2, PIN_BAND_HZ * 2.0 * STEP_S)
    b, a = coefficients[0], coefficients[1]
    acceleration = np.gradient(filtfilt(b, a, velocity, axis=0), STEP_S, axis=0)
    whole = np.concatenate([position, np.zeros((position.shape[0], 2))], axis=1)
    pin = pin_in_plane(spec, whole)
    slopes: list[Array] = []
    for joint in (1, 2, 3):
        moved = whole.copy()
        moved[:, joint] += 1e-5
        slopes.append((pin_in_plane(spec, moved) - pin) / 1e-5)
    in_plane = np.sum(
        [slope * acceleration[:, [j]] for slope, j in zip(slopes, (1, 2, 3), strict=True)], axis=0
    )
    leftward = pin[:, 0] * acceleration[:, 0]
    return np.stack([in_plane[:, 0], leftward, in_plane[:, 1]], axis=1)


def _axis(throws: Sequence[ThrowData], spec: MachineSpec, axis: int) -> AxisSwing:
    swings = [swing for throw in throws for swing in free_swings(throw, spec, axis)]
    name = PASSIVE_JOINTS[axis]
    if len(swings) < MIN_SWINGS:
        why = f"{len(swings)} free swings in {name} longer than {MIN_FREE_S:g} s, {MIN_SWINGS} are needed"
        a, b, c = (unknown(unit, why, count=len(swings)) for unit in UNITS)
        return AxisSwing(
            joint=name,
            viscous_friction_per_s=a,
            coulomb_friction_rad_per_s2=b,
            length_m=c,
            swing_count=len(swings),
        )
    fits = [_fit(swing) for swing in swings]
    values = np.stack([x for x, _ in fits])
    a, b, c = (mean_quantity(values[:, k], unit) for k, unit in enumerate(UNITS))
    longest = max(range(len(swings)), key=lambda k: swings[k].t_s.size)
    return AxisSwing(
        joint=name,
        viscous_friction_per_s=a,
        coulomb_friction_rad_per_s2=b,
        length_m=c,
        residual_rad_per_s=float(np.sqrt(np.mean([error**2 for _, error in fits]))),
        swing_count=len(swings),
        plot=_plot(swings[longest], values[longest]),
    )


def _fit(swing: FreeSwing) -> tuple[Array, float]:
    """Viscous and Coulomb friction, length, initial angle and rate, gyro bias; and the residual, rad/s."""
    rate = swing.rate_rad_per_s - np.median(swing.rate_rad_per_s)
    angle = np.cumsum(rate) * STEP_S
    first = -float(np.mean(angle))

    def residual(x: Array) -> Array:
        return simulate_swing(swing, x)[1] + x[5] - swing.rate_rad_per_s

    bias = float(np.median(swing.rate_rad_per_s))
    start = np.array([0.03, 0.1, 0.9, first, float(rate[0]), bias])
    # The period fixes the length before anything else is fitted.
    lengths = np.linspace(0.6, 1.4, 17)
    start[2] = min(
        lengths, key=lambda v: float(np.sum(residual(np.array([*start[:2], v, *start[3:]])) ** 2))
    )
    low = np.concatenate([LOW, [-1.5, -6.0, -0.2]])
    high = np.concatenate([HIGH, [1.5, 6.0, 0.2]])
    scale = [0.01, 0.03, 0.02, 0.02, 0.1, 0.01]
    found = least_squares(residual, start, bounds=(low, high), x_scale=scale, max_nfev=25)
    return np.asarray(found.x), float(np.sqrt(np.mean(found.fun**2)))


def _plot(swing: FreeSwing, x: Array) -> dict[str, list[float]]:
    angle, _ = simulate_swing(swing, x)
    measured = np.cumsum(swing.rate_rad_per_s - x[5]) * STEP_S
    measured += float(np.mean(angle - measured))
    return {
        "t_s": swing.t_s.round(3).tolist(),
        "measured_rad": measured.round(5).tolist(),
        "predicted_rad": angle.round(5).tolist(),
    }
