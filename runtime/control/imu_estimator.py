"""Angles and rates of the two free joints from the gripper's IMU, extrapolated to the present tick.

A sample is 15 to 40 ms old when it arrives, may come twice or not at all. Its gyro gives the rates at its
own time, their integral the angles; the free pendulum carries both to the present. On a pendulum the
specific force points along the pendulum, so it says nothing about the angle by itself: it corrects the
angle slowly, after the pin's own acceleration (from the driven joints) has been taken off, and at rest
the gripper hangs plumb up to friction. It refuses nothing; an old sample shows in `age_s`.

Axes of the swing frame S (cabin frame turned by the swing): e1 forward, e2 left, e3 up along the hanger.
"""

from functools import cache
from typing import NamedTuple

import numpy as np

from machine.conventions import (
    CONTROL_PERIOD_NS,
    CONTROL_PERIOD_S,
    GRAVITY_M_PER_S2,
    Array,
    BoolArray,
    IntArray,
)
from machine.kinematics import components
from machine.spec import MachineSpec
from runtime.driver import SensorSample

IMU_POSITION_M = (0.20, 0.0, -0.42)
"""IMU in the gripper's frame, from the roll axis: site `imu` of machine/m545.xml (tested)."""
TREND_SHARE = np.array([[0.3], [1.1]])
"""How much of the acceleration's last change goes on: least squares over throws of the virtual machine
(pitch is driven by the ringing boom and dipper, roll by the slower slew)."""
GRAVITY_TIME_S = 6.0
"""Time constant of the correction of a swinging gripper's angle by its specific force."""
PIN_ACCELERATION_TRUST_M_PER_S2 = 1.0
"""Pin acceleration at which that correction counts half."""
PIN_FILTER_S = 0.05
REST_WINDOW_S = 0.3
REST_RATE_SD_RAD_PER_S = 0.004
REST_RATE_MAX_RAD_PER_S = 0.04
"""Twice the gyro bias of the data sheet (1 deg/s): more is motion."""
REST_JOINT_SPEED_RAD_M_PER_S = 0.06
REST_MIN_S = 0.4
REST_ANGLE_TIME_S = 0.4
PLUMB_ZONE_RAD = 0.012
"""Coulomb friction holds the gripper within eta / omega0^2 = 9.3 mrad of plumb; a third more for spread."""
START_ANGLE_ZONE_RAD = 0.03
"""Below friction plus accelerometer bias (15 mg) a first tilt reading tells nothing."""
LONGEST_EXTRAPOLATION_S = 0.25
LONGEST_STEP_S = 0.30
"""After a longer gap the rates start afresh from the sample."""


class _Constants(NamedTuple):
    frequency: Array
    """(2, 1) small-swing angular frequency of pitch and roll, rad/s."""
    squared: Array
    """(2, 1) its square."""
    hanger: float
    """Pin to roll axis, m."""


@cache
def _constants(spec: MachineSpec) -> _Constants:
    p, a = spec.passive, spec.geometry.pitch_to_roll_m
    below = a + p.gripper_com_m
    moment = p.hanger_mass_kg * p.hanger_com_m + p.gripper_mass_kg * below
    inertia = (
        p.hanger_mass_kg * p.hanger_com_m**2
        + p.hanger_inertia_kg_m2[1]
        + p.gripper_mass_kg * below**2
        + p.gripper_inertia_kg_m2[1]
    )
    roll_moment = p.gripper_mass_kg * p.gripper_com_m
    roll_inertia = p.gripper_mass_kg * p.gripper_com_m**2 + p.gripper_inertia_kg_m2[0]
    squared = GRAVITY_M_PER_S2 * np.array([[moment / inertia], [roll_moment / roll_inertia]])
    frequency = np.sqrt(squared)
    return _Constants(frequency, frequency * frequency, a)


def swing_frequency_rad_per_s(spec: MachineSpec) -> tuple[float, float]:
    """Small-swing angular frequency about the pitch and the roll axis."""
    pitch, roll = _constants(spec).frequency[:, 0]
    return float(pitch), float(roll)


class ImuState(NamedTuple):
    """Memory of the estimator; component axis first, then machines."""

    t_ns: IntArray
    """(N,) time of the last sample used; 0 = none."""
    angle_rad: Array
    """(2, N) swing from the vertical and roll, at t_ns."""
    rate_rad_per_s: Array
    """(2, N)"""
    acceleration_rad_per_s2: Array
    """(2, N) between the last two samples."""
    trend_rad_per_s2: Array
    """(2, N) its change from the two samples before."""
    gyro_bias_rad_per_s: Array
    """(3, N)"""
    gyro_mean_rad_per_s: Array
    """(3, N) over the rest window."""
    gyro_variance_rad2_per_s2: Array
    """(N,) over the rest window, sum of the axes."""
    tilt_offset_rad: Array
    """(2, N) what the accelerometer reads for a plumb gripper."""
    rest_s: Array
    """(N,) how long machine and gripper have been at rest."""
    rest_sample_count: Array
    """(N,) samples that the bias and the offset average over."""
    pin_velocity_rad_m_per_s: Array
    """(3, N) filtered: tool pin outward and up in the arm plane, slew rate."""
    pin_acceleration_rad_m_per_s2: Array
    """(3, N) of the same, filtered."""


class ImuEstimate(NamedTuple):
    """The free joints at the present tick."""

    swing_rad: Array
    """(N,) from the vertical, in the arm plane."""
    roll_rad: Array
    """(N,)"""
    swing_rate_rad_per_s: Array
    """(N,)"""
    roll_rate_rad_per_s: Array
    """(N,)"""
    age_s: Array
    """(N,) of the newest sample; infinite before the first."""


def initial_imu(sample: SensorSample) -> ImuState:
    """Memory before the first `update`: plumb and at rest."""
    count = sample.joint_position_rad_m.shape[0]
    two, three, one = np.zeros((2, count)), np.zeros((3, count)), np.zeros(count)
    return ImuState(
        t_ns=np.zeros(count, dtype=np.int64),
        angle_rad=two,
        rate_rad_per_s=two,
        acceleration_rad_per_s2=two,
        trend_rad_per_s2=two,
        gyro_bias_rad_per_s=three,
        gyro_mean_rad_per_s=three,
        gyro_variance_rad2_per_s2=one,
        tilt_offset_rad=two,
        rest_s=one,
        rest_sample_count=one,
        pin_velocity_rad_m_per_s=three,
        pin_acceleration_rad_m_per_s2=three,
    )


def update(
    spec: MachineSpec,
    state: ImuState,
    sample: SensorSample,
    pin_velocity_rad_m_per_s: Array,
    pin_radius_m: Array,
    now_ns: int,
) -> tuple[ImuState, ImuEstimate]:
    """Take in the newest sample, if it is new, and extrapolate to the tick.

    Args:
        spec: masses and lengths of the gripper.
        state: memory.
        sample: of this tick; a non-finite IMU sample counts as missing.
        pin_velocity_rad_m_per_s: (3, N) tool pin in the arm plane (outward, up) and slew rate, measured.
        pin_radius_m: (N,) of the pin from the slew axis, in the arm plane.
        now_ns: the tick.
    """
    state = _follow_machine(state, sample, pin_velocity_rad_m_per_s)
    t_ns, gyro, accel = (
        sample.imu_t_mono_ns,
        sample.imu_gyro_rad_per_s.T,
        sample.imu_accel_m_per_s2.T,
    )
    usable = (np.isfinite(gyro) & np.isfinite(accel)).all(axis=0)
    new = usable & (t_ns > state.t_ns) & (t_ns <= now_ns)
    new_count = np.count_nonzero(new)
    if new_count == new.size:
        state = _take_sample(spec, state, t_ns, gyro, accel, pin_radius_m)
    elif new_count:
        # The machines without one work out a sample of zeros, which is thrown away.
        t_ns = np.where(new, t_ns, state.t_ns + CONTROL_PERIOD_NS)
        gyro, accel = np.where(new, gyro, 0.0), np.where(new, accel, 0.0)
        taken = _take_sample(spec, state, t_ns, gyro, accel, pin_radius_m)
        state = ImuState(
            *(np.where(new, one, other) for one, other in zip(taken, state, strict=True))
        )
    return state, _extrapolate(spec, state, now_ns)


def _follow_machine(state: ImuState, sample: SensorSample, pin_velocity: Array) -> ImuState:
    """Filter the pin's motion; the filter's lag is about the IMU's latency."""
    gain = CONTROL_PERIOD_S / PIN_FILTER_S
    moved = gain * (pin_velocity - state.pin_velocity_rad_m_per_s)
    before = state.pin_acceleration_rad_m_per_s2
    moves = ~(np.abs(sample.joint_velocity_rad_m_per_s) < REST_JOINT_SPEED_RAD_M_PER_S)
    rest_s = state.rest_s
    if np.count_nonzero(moves):
        rest_s = np.where(moves.any(axis=1), 0.0, rest_s)
    return state._replace(
        pin_velocity_rad_m_per_s=state.pin_velocity_rad_m_per_s + moved,
        pin_acceleration_rad_m_per_s2=before + gain * (moved / CONTROL_PERIOD_S - before),
        rest_s=rest_s,
    )


def _take_sample(
    spec: MachineSpec,
    state: ImuState,
    t_ns: IntArray,
    gyro: Array,
    accel: Array,
    pin_radius: Array,
) -> ImuState:
    """Take in samples of times (N,), rates and specific forces (3, N), newer than the last of each."""
    first = state.t_ns == 0
    dt: Array = np.multiply(t_ns - state.t_ns, 1e-9)
    if np.count_nonzero(first):
        dt[first] = CONTROL_PERIOD_S
        state = _begin(state, gyro, accel, first)
    gap = dt > LONGEST_STEP_S
    any_gap = np.count_nonzero(gap) > 0
    before = state.rate_rad_per_s
    turning = gyro - state.gyro_bias_rad_per_s
    rate = joint_rates(state.angle_rad, turning, state.pin_velocity_rad_m_per_s[2])
    # On the virtual machine no filter of the rate (alpha-beta-gamma, accelerometer, joint sensors) did
    # better than 15 % below these differences: what is missing after 30 ms is the drives' own jerk.
    acceleration = (rate - before) / dt
    step = 0.5 * dt
    if any_gap:
        acceleration = np.where(gap, 0.0, acceleration)
        step = np.where(gap, 0.0, step)
    trend = acceleration - state.acceleration_rad_per_s2
    moved = state._replace(
        t_ns=t_ns.copy(),
        angle_rad=state.angle_rad + step * (before + rate),
        rate_rad_per_s=rate,
        acceleration_rad_per_s2=acceleration,
        trend_rad_per_s2=np.where(gap, 0.0, trend) if any_gap else trend,
    )
    return _correct(moved, _tilt_error(spec, moved, turning, accel, pin_radius), gyro, dt)


def _begin(state: ImuState, gyro: Array, accel: Array, first: BoolArray) -> ImuState:
    """Start from one sample: a gripper that turns slowly is at rest, and its rate is the bias."""
    resting = np.abs(gyro).max(axis=0) < REST_RATE_MAX_RAD_PER_S
    bias = np.where(first & resting, gyro, state.gyro_bias_rad_per_s)
    return state._replace(
        angle_rad=np.where(first, start_angle(accel), state.angle_rad),
        gyro_bias_rad_per_s=bias,
        gyro_mean_rad_per_s=np.where(first, gyro, state.gyro_mean_rad_per_s),
    )


def start_angle(accel_m_per_s2: Array) -> Array:
    """Swing and roll (2, ...) at which a gripper begins whose first specific force is this (3, ...)."""
    x, y, z = accel_m_per_s2
    tilt = np.stack([np.arctan2(x, z), np.arctan2(y, z)])
    return tilt - np.clip(tilt, -START_ANGLE_ZONE_RAD, START_ANGLE_ZONE_RAD)


def joint_rates(angle_rad: Array, gyro_rad_per_s: Array, cabin_rad_per_s: Array) -> Array:
    """Rates (2, N) of swing and roll from the gripper's turning rate (3, N) in its own frame.

    In S the gripper turns with (cabin sin(swing) + roll', -swing', cabin cos(swing)).

    Args:
        angle_rad: (2, N) swing from the vertical and roll.
        gyro_rad_per_s: (3, N)
        cabin_rad_per_s: (N,) of the slew joint.
    """
    swing, roll = components(angle_rad)
    wx, wy, wz = components(gyro_rad_per_s)
    rates = np.empty_like(angle_rad)
    rates[0] = np.sin(roll) * wz - np.cos(roll) * wy
    rates[1] = wx - cabin_rad_per_s * np.sin(swing)
    return rates


def _tilt_error(
    spec: MachineSpec, state: ImuState, gyro: Array, accel: Array, pin_radius: Array
) -> Array:
    """How much (2, N) the angles should grow for the specific force to fit; small angles.

    The sample's specific force is carried from the IMU to the roll axis and from there to the pin, where
    it is gravity plus the pin's acceleration.
    """
    swing, roll = components(state.angle_rad)
    swing_acc, roll_acc = components(state.acceleration_rad_per_s2)
    sin_s, cos_s, sin_r, cos_r = np.sin(swing), np.cos(swing), np.sin(roll), np.cos(roll)
    x, _, z = IMU_POSITION_M
    wx, wy, wz = components(gyro)
    ax, ay, az = components(accel)
    by, bz = -cos_r * swing_acc, sin_r * swing_acc
    # accel - beta x p - w x (w x p), p = (x, 0, z) in the gripper's frame
    along = wx * x + wz * z
    square = wx * wx + wy * wy + wz * wz
    f1 = ax - by * z - wx * along + square * x
    f2 = ay - (bz * x - roll_acc * z) - wy * along
    f3 = az + by * x - wz * along + square * z
    # into S, then from the roll axis up to the pin (the hanger does not roll)
    pin_speed, _, cabin = components(state.pin_velocity_rad_m_per_s)
    o1, o3 = cabin * sin_s, cabin * cos_s
    a, (swing_rate, _) = _constants(spec).hanger, components(state.rate_rad_per_s)
    s1 = f1 - a * (swing_acc - o1 * o3)
    s2 = cos_r * f2 - sin_r * f3 - 2.0 * a * swing_rate * o3
    pin_x, pin_z, cabin_acc = components(state.pin_acceleration_rad_m_per_s2)
    (radius,) = components(pin_radius[None])
    offset = spec.geometry.arm_plane_offset_m
    pin_x = pin_x - cabin * cabin * radius - cabin_acc * offset
    pin_y = 2.0 * cabin * pin_speed + cabin_acc * radius - cabin * cabin * offset
    up = GRAVITY_M_PER_S2 + pin_z
    expected1 = pin_x * cos_s + up * sin_s
    along_hanger = np.maximum(up * cos_s - pin_x * sin_s, 0.3 * GRAVITY_M_PER_S2)
    error = np.empty_like(state.angle_rad)
    error[0], error[1] = (s1 - expected1) / along_hanger, (s2 - pin_y) / along_hanger
    return error


def _correct(state: ImuState, error: Array, gyro: Array, dt: Array) -> ImuState:
    """Slow correction by gravity; gyro bias, accelerometer offset and plumb angle while at rest."""
    window = np.minimum(dt / REST_WINDOW_S, 1.0)
    mean = state.gyro_mean_rad_per_s + window * (gyro - state.gyro_mean_rad_per_s)
    spread = ((gyro - mean) ** 2).sum(axis=0)
    variance = state.gyro_variance_rad2_per_s2
    variance = variance + window * (spread - variance)
    calm = (variance < 3.0 * REST_RATE_SD_RAD_PER_S**2) & (
        np.abs(mean).max(axis=0) < REST_RATE_MAX_RAD_PER_S
    )
    rest = np.where(calm, state.rest_s + dt, 0.0)
    resting = rest > REST_MIN_S
    if np.count_nonzero(resting):
        state = _rest(state, error, mean, dt, resting)
    else:
        state = state._replace(angle_rad=state.angle_rad + _pull_to_gravity(state, error, dt))
    return state._replace(gyro_mean_rad_per_s=mean, gyro_variance_rad2_per_s2=variance, rest_s=rest)


def _pull_to_gravity(state: ImuState, error: Array, dt: Array) -> Array:
    """Change of the angles (2, N) of a swinging gripper: small, smaller while the pin accelerates."""
    outward, up, turning = components(state.pin_acceleration_rad_m_per_s2)
    pull = (
        outward * outward + up * up + 36.0 * turning * turning
    ) / PIN_ACCELERATION_TRUST_M_PER_S2**2
    off = np.minimum(np.maximum(error - state.tilt_offset_rad, -0.3), 0.3)
    return dt / GRAVITY_TIME_S / (1.0 + pull) * off


def _rest(state: ImuState, error: Array, mean: Array, dt: Array, resting: BoolArray) -> ImuState:
    """Learn gyro bias and accelerometer offset of the machines (N,) at rest; theirs hang plumb."""
    samples = state.rest_sample_count + resting
    # A running mean that never forgets faster than 10 s: several rests average the friction's zone.
    share = np.where(resting, 1.0 / np.clip(samples, 1.0, 1000.0), 0.0)
    tilt = state.angle_rad + error
    offset = state.tilt_offset_rad + share * (tilt - state.tilt_offset_rad)
    plumb = np.clip(tilt - offset, -PLUMB_ZONE_RAD, PLUMB_ZONE_RAD)
    at_rest = np.minimum(dt / REST_ANGLE_TIME_S, 1.0) * (plumb - state.angle_rad)
    bias = state.gyro_bias_rad_per_s
    state = state._replace(
        gyro_bias_rad_per_s=bias + share * (mean - bias),
        tilt_offset_rad=offset,
        rest_sample_count=samples,
    )
    change = np.where(resting, at_rest, _pull_to_gravity(state, error, dt))
    return state._replace(angle_rad=state.angle_rad + change)


def _extrapolate(spec: MachineSpec, state: ImuState, now_ns: int) -> ImuEstimate:
    """Carry angle and rate to the tick with the free pendulum under a constant pin acceleration."""
    age: Array = np.multiply(now_ns - state.t_ns, 1e-9)
    if np.count_nonzero(state.t_ns) != age.size:
        age[state.t_ns == 0] = np.inf
    constants = _constants(spec)
    w, phase = constants.frequency, constants.frequency * np.minimum(age, LONGEST_EXTRAPOLATION_S)
    c, s = np.cos(phase), np.sin(phase) / w
    rate = state.rate_rad_per_s
    acceleration = state.acceleration_rad_per_s2 + TREND_SHARE * state.trend_rad_per_s2
    angle = state.angle_rad + rate * s + acceleration * ((1.0 - c) / constants.squared)
    now_rate = rate * c + acceleration * s
    return ImuEstimate(angle[0], angle[1], now_rate[0], now_rate[1], age)
