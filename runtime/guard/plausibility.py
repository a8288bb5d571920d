"""Cross-checks of sensors and valves: what cannot be true together; batched, pure, for the safety gate.

Each check has a bound and a time, tabled in docs/safety.md. What they cannot see: sensors that lie in a
consistent way (position and velocity together, slower than the bounds), and a sensor's offset at start.
"""

from enum import IntFlag
from functools import cache
from typing import NamedTuple

import numpy as np

from machine.conventions import CONTROL_PERIOD_S, Array, BoolArray, IntArray
from machine.spec import CylinderSpec, MachineSpec
from runtime.driver import SensorSample


class Contradiction(IntFlag):
    """What contradicts what; bits."""

    JUMP = 1
    """Position against integrated velocity: an encoder slipped, jumped, or one of the two is frozen."""
    FROZEN = 2
    """A joint's values repeat exactly under fresh time stamps while it moves or its valve is open."""
    FOLLOWING = 4
    """Motion against valve: a joint moves that should not, or does not move that should."""
    IMU = 8
    """The gripper IMU repeats exactly under fresh stamps while the arm moves, or its time goes back."""
    CLOCK = 16
    """The joint sensors' time goes back."""


DRIFT_LIMIT_RAD_M = 0.025
"""Integrated velocity may miss the position by so much within about 0.8 s: three times the largest of
healthy throws (0.0085), whose sensors are 1 to 2 mrad noisy."""
DRIFT_MEMORY_S = 0.8
FOLLOWING_LIMIT_RAD_M = np.array([[0.07, 0.045, 0.085, 0.045]])
"""Integrated difference between a joint's speed and what its valve should give, within about 0.4 s: one and
a half times the largest of healthy throws (0.043, 0.025, 0.058, 0.027)."""
FOLLOWING_MEMORY_S = 0.4
RESPONSE_DEAD_TICKS = (15, 8, 8, 8)
RESPONSE_LAG_S = np.array([[0.4, 0.1, 0.1, 0.1]])
"""Dead time (ticks of 10 ms) and lag of the joints' answer to a valve, which the expected speed follows."""
MOVING_RAD_M_PER_S = 0.03
"""Four standard deviations of a joint's velocity noise."""
FROZEN_MOVING_NS = 50_000_000
"""A moving joint repeats its values for so long: at 0.03 rad/s an encoder of 14 bits has then changed."""
FROZEN_OPEN_NS = np.array([[210_000_000, 140_000_000, 140_000_000, 140_000_000]])
"""A joint whose valve is open repeats its values for so long: dead time and 60 ms."""
OPEN_RATIO = 0.12
"""A valve well beyond the dead band of 0.04, also that of a worn one."""
IMU_REPEAT_COUNT = 8
"""Samples in a row with the same six numbers."""
IMU_MOVING_RAD_M_PER_S = 0.1
"""A joint faster than this shakes the gripper: a living IMU cannot repeat itself."""
VALUE_LIMIT = 1e6
"""Joint values beyond it are no measurements."""
GAP_LIMIT_NS = 35_000_000
"""After a longer gap between ticks the integrals begin anew: nothing is known of the time between."""


class GuardMemory(NamedTuple):
    """What the checks remember from tick to tick."""

    now_ns: int
    """Last tick; 0 = none."""
    sample_ns: int
    """Last joint sample."""
    position: Array
    """(N, 4) of the last joint sample."""
    velocity: Array
    """(N, 4)"""
    drift: Array
    """(N, 4) leaky integral of position change minus velocity, rad or m."""
    expected: Array
    """(N, 4) speed that the valves should give."""
    commands: Array
    """(D, N, 4) steady speeds of the valves of the last ticks, newest first."""
    following: Array
    """(N, 4) leaky integral of speed minus expected speed, rad or m."""
    same_ns: IntArray
    """(N, 4) how long the joint's values have repeated."""
    open_ns: IntArray
    """(N, 4) how long its valve has been open."""
    imu_ns: IntArray
    """(N,) last IMU sample."""
    imu: Array
    """(N, 6) its numbers."""
    imu_same_count: IntArray
    """(N,) samples in a row with these numbers."""


class _Response(NamedTuple):
    """Constants over joints, (1, 4)."""

    speed_positive: Array
    speed_negative: Array
    dead_band: float
    boom: CylinderSpec
    dipper: CylinderSpec
    middle_arm_m: tuple[float, float]
    """Moment arms of boom and dipper where the speed limits hold."""


MIDDLE_RAD = (0.5, 0.0)
"""Boom and dipper angle at which the spec's speed limits are stated."""


@cache
def _response(spec: MachineSpec) -> _Response:
    boom, dipper = spec.hydraulics.boom_cylinder, spec.hydraulics.dipper_cylinder
    return _Response(
        speed_positive=np.asarray([spec.limits.speed_positive_rad_m_per_s]),
        speed_negative=np.asarray([spec.limits.speed_negative_rad_m_per_s]),
        dead_band=spec.hydraulics.valve_dead_band_ratio,
        boom=boom,
        dipper=dipper,
        middle_arm_m=(
            float(moment_arm_m(boom, np.array([MIDDLE_RAD[0]]))[0]),
            float(moment_arm_m(dipper, np.array([MIDDLE_RAD[1]]))[0]),
        ),
    )


def moment_arm_m(cylinder: CylinderSpec, angle_rad: Array) -> Array:
    """Magnitude of a cylinder's moment arm at joint angles (...), m: |rod x (rod - base)| / length."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    x = cos * cylinder.rod_xz_m[0] - sin * cylinder.rod_xz_m[1]
    z = sin * cylinder.rod_xz_m[0] + cos * cylinder.rod_xz_m[1]
    base_x, base_z = cylinder.base_xz_m
    return np.abs(x * base_z - z * base_x) / np.hypot(x - base_x, z - base_z)


def initial_guard(count: int) -> GuardMemory:
    """Memory of `count` machines of which nothing was seen."""
    none = np.zeros((count, 4))
    whole = np.zeros((count, 4), dtype=np.int64)
    return GuardMemory(
        now_ns=0,
        sample_ns=0,
        position=none,
        velocity=none,
        drift=none,
        expected=none,
        commands=np.zeros((max(RESPONSE_DEAD_TICKS) + 1, count, 4)),
        following=none,
        same_ns=whole,
        open_ns=whole,
        imu_ns=np.zeros(count, dtype=np.int64),
        imu=np.zeros((count, 6)),
        imu_same_count=np.zeros(count, dtype=np.int64),
    )


def check(
    spec: MachineSpec, memory: GuardMemory, sample: SensorSample, valve: Array, now_ns: int
) -> tuple[GuardMemory, IntArray]:
    """One tick.

    Args:
        spec: machine type.
        memory: of the last tick.
        sample: of this tick; joint values that are no numbers count as unchanged (the gate closes on them).
        valve: (N, 4) what was let through in the last tick, -1..1.
        now_ns: the tick.

    Returns:
        Memory, and bits (N,) of `Contradiction`.
    """
    response = _response(spec)
    position, velocity = sample.joint_position_rad_m, sample.joint_velocity_rad_m_per_s
    valve = np.nan_to_num(np.minimum(np.maximum(valve, -1.0), 1.0))
    finite = np.abs(position) + np.abs(velocity) < VALUE_LIMIT
    if np.count_nonzero(finite) < finite.size:
        position = np.where(finite, position, memory.position)
        velocity = np.where(finite, velocity, memory.velocity)
    steady = _steady_speed(response, valve, position)
    gap_ns = now_ns - memory.now_ns
    if memory.now_ns == 0 or not 0 < gap_ns <= GAP_LIMIT_NS:
        return _begin(memory, sample, position, velocity, steady, now_ns)
    since_ns = sample.t_mono_ns - memory.sample_ns
    drift, same_ns = memory.drift, memory.same_ns
    bits = np.zeros(len(position), dtype=np.int64)
    if since_ns > 0:
        since_s = since_ns * 1e-9
        moved = position - memory.position
        drift = drift * np.exp(-since_s / DRIFT_MEMORY_S)
        drift = drift + moved - 0.5 * since_s * (velocity + memory.velocity)
        same = (moved == 0.0) & (velocity == memory.velocity)
        same_ns = np.where(same, same_ns + since_ns, 0)
    else:
        # No new sample: what was compared last stays what the next one is compared with.
        position, velocity = memory.position, memory.velocity
        if since_ns < 0:
            bits += int(Contradiction.CLOCK)
    open_ns = np.where(np.abs(valve) > OPEN_RATIO, memory.open_ns + gap_ns, 0)
    commands, expected = _follow(memory, steady, gap_ns)
    gap_s = gap_ns * 1e-9
    following = memory.following * np.exp(-gap_s / FOLLOWING_MEMORY_S)
    following = following + gap_s * (velocity - expected)
    frozen = (same_ns >= FROZEN_MOVING_NS) & (np.abs(velocity) > MOVING_RAD_M_PER_S)
    frozen |= np.minimum(same_ns, open_ns) >= FROZEN_OPEN_NS
    wrong = (
        (np.abs(drift) > DRIFT_LIMIT_RAD_M, Contradiction.JUMP),
        (frozen, Contradiction.FROZEN),
        (np.abs(following) > FOLLOWING_LIMIT_RAD_M, Contradiction.FOLLOWING),
    )
    for joints, bit in wrong:
        if np.count_nonzero(joints):
            bits += joints.any(axis=1) * int(bit)
    imu_bits, imu_ns, imu, imu_same_count = _check_imu(memory, sample, velocity)
    after = GuardMemory(
        now_ns,
        max(sample.t_mono_ns, memory.sample_ns),
        position,
        velocity,
        drift,
        expected,
        commands,
        following,
        same_ns,
        open_ns,
        imu_ns,
        imu,
        imu_same_count,
    )
    return after, bits + imu_bits


def _begin(
    memory: GuardMemory,
    sample: SensorSample,
    position: Array,
    velocity: Array,
    steady: Array,
    now_ns: int,
) -> tuple[GuardMemory, IntArray]:
    """The first tick, or the first after a gap: the joints are taken to do what they are seen to do."""
    commands = memory.commands.copy()
    commands[:] = steady
    fresh = initial_guard(len(position))
    after = fresh._replace(
        now_ns=now_ns,
        sample_ns=sample.t_mono_ns,
        position=position,
        velocity=velocity,
        expected=velocity,
        commands=commands,
        imu_ns=sample.imu_t_mono_ns,
        imu=_imu_numbers(sample),
    )
    return after, np.zeros(len(position), dtype=np.int64)


def _steady_speed(response: _Response, valve: Array, position: Array) -> Array:
    """Joint speeds (N, 4) that valves (N, 4) give a nominal machine in the end."""
    band = response.dead_band
    size = np.maximum(np.abs(valve) - band, 0.0) / (1.0 - band)
    speed = np.where(valve > 0.0, size * response.speed_positive, -size * response.speed_negative)
    boom = moment_arm_m(response.boom, position[:, 1])
    dipper = moment_arm_m(response.dipper, position[:, 2])
    speed[:, 1] *= response.middle_arm_m[0] / np.maximum(boom, 1e-3)
    speed[:, 2] *= response.middle_arm_m[1] / np.maximum(dipper, 1e-3)
    return speed


def _follow(memory: GuardMemory, steady: Array, gap_ns: int) -> tuple[Array, Array]:
    """Delay line and expected speeds (N, 4) after one tick, or several at once."""
    commands, expected = memory.commands, memory.expected
    share = 1.0 - np.exp(-CONTROL_PERIOD_S / RESPONSE_LAG_S)
    for _ in range(max(round(gap_ns * 1e-9 / CONTROL_PERIOD_S), 1)):
        commands = np.concatenate([steady[None], commands[:-1]])
        delayed = np.stack(
            [commands[ticks, :, joint] for joint, ticks in enumerate(RESPONSE_DEAD_TICKS)], axis=1
        )
        expected = expected + share * (delayed - expected)
    return commands, expected


def _imu_numbers(sample: SensorSample) -> Array:
    return np.concatenate([sample.imu_gyro_rad_per_s, sample.imu_accel_m_per_s2], axis=1)


def _check_imu(
    memory: GuardMemory, sample: SensorSample, velocity: Array
) -> tuple[IntArray, IntArray, Array, IntArray]:
    """Bits (N,) of the IMU, and its part of the memory."""
    imu_ns, imu = sample.imu_t_mono_ns, _imu_numbers(sample)
    is_new: BoolArray = imu_ns > memory.imu_ns
    same = (imu == memory.imu).all(axis=1)
    count = np.where(is_new, np.where(same, memory.imu_same_count + 1, 0), memory.imu_same_count)
    moving = (np.abs(velocity) > IMU_MOVING_RAD_M_PER_S).any(axis=1)
    backwards = (imu_ns < memory.imu_ns) & (imu_ns > 0)
    wrong = ((count >= IMU_REPEAT_COUNT) & moving) | backwards
    bits = wrong * int(Contradiction.IMU)
    return (
        bits,
        np.maximum(imu_ns, memory.imu_ns),
        np.where(is_new[:, None], imu, memory.imu),
        count,
    )
