"""Cross-checks of sensors and valves: what cannot be true together; batched, pure, for the safety gate.

Each check has a bound and a time, tabled in docs/safety_gate.md. What they cannot see: sensors that lie in a
consistent way (position and velocity together, slower than the bounds), and a sensor's offset at start.
"""

from enum import IntFlag
from typing import NamedTuple

import numpy as np

from machine.conventions import CONTROL_PERIOD_S, Array, IntArray
from machine.spec import MachineSpec
from runtime.driver import SensorSample
from runtime.guard.drive_envelope import DriveMemory, follow, initial_drives, speed_bounds
from runtime.guard.imu_plausibility import ImuMemory, check_imu, imu_numbers, initial_imu


class Contradiction(IntFlag):
    """What contradicts what; bits."""

    JUMP = 1
    """Position against integrated velocity: an encoder slipped, jumped, or one of the two is frozen."""
    FROZEN = 2
    """A joint's values repeat exactly under fresh time stamps while it moves or its valve is open."""
    FOLLOWING = 4
    """Motion against valve: a joint moves that should not, or does not move that should."""
    IMU = 8
    """The gripper IMU contradicts itself or the arm's motion, or its time goes back."""
    CLOCK = 16
    """The time of the joint sensors, or of the ticks, goes back."""


DRIFT_LIMIT_RAD_M = 0.025
"""Integrated velocity may miss the position by so much within about 0.8 s: three times the largest of
healthy throws (0.0085), whose sensors are 1 to 2 mrad noisy."""
DRIFT_MEMORY_S = 0.8
MOVING_RAD_M_PER_S = 0.03
"""Four standard deviations of a joint's velocity noise."""
FROZEN_MOVING_NS = 50_000_000
"""A moving joint repeats position and velocity for so long: at 0.03 rad/s 14 bits have then changed."""
STILL_MOVING_NS = 100_000_000
"""A moving joint repeats its position for so long: noise of 1 mrad in steps of 0.4 mrad repeats one in seven
times, ten times in a row never."""
FROZEN_OPEN_NS = np.array([[210_000_000, 140_000_000, 140_000_000, 140_000_000]])
"""A joint whose valve is open repeats position and velocity for so long: dead time and 60 ms."""
OPEN_RATIO = 0.12
"""A valve well beyond the dead band of 0.04, also that of a worn one."""
VALUE_LIMIT = 1e6
"""Joint values beyond it are no measurements."""
GAP_LIMIT_NS = 110_000_000
"""After a longer gap between ticks the integrals begin anew: the machine's controller has closed the valves,
and the control loop has aborted the throw. With less, a loop that is always late would run unchecked."""


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
    still_ns: IntArray
    """(N, 4) how long the joint's position has repeated."""
    same_ns: IntArray
    """(N, 4) how long its position and velocity have repeated."""
    open_ns: IntArray
    """(N, 4) how long its valve has been open."""
    drives: DriveMemory
    imu: ImuMemory


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
        still_ns=whole,
        same_ns=whole,
        open_ns=whole,
        drives=initial_drives(none, np.zeros((2, count, 4))),
        imu=initial_imu(whole[:, 0], np.zeros((count, 6))),
    )


def check(
    spec: MachineSpec,
    memory: GuardMemory,
    sample: SensorSample,
    valve: Array,
    now_ns: int,
    gripper_rad: Array | None = None,
) -> tuple[GuardMemory, IntArray]:
    """One tick.

    Args:
        spec: machine type.
        memory: of the last tick.
        sample: of this tick; joint values that are no numbers count as unchanged (the gate closes on them).
        valve: (N, 4) what was let through in the last tick, -1..1.
        now_ns: the tick.
        gripper_rad: (N, 2) swing of the gripper from the vertical, and roll; None = not known.

    Returns:
        Memory, and bits (N,) of `Contradiction`.
    """
    position, velocity = sample.joint_position_rad_m, sample.joint_velocity_rad_m_per_s
    valve = np.minimum(np.maximum(valve, -1.0), 1.0)
    # What `nan_to_num` does with bounded numbers, at a tenth of its cost.
    valve = np.where(np.isnan(valve), 0.0, valve)
    finite = np.abs(position) + np.abs(velocity) < VALUE_LIMIT
    if np.count_nonzero(finite) < finite.size:
        position = np.where(finite, position, memory.position)
        velocity = np.where(finite, velocity, memory.velocity)
    steady = speed_bounds(spec, valve, position)
    gap_ns = now_ns - memory.now_ns
    if memory.now_ns == 0 or not 0 < gap_ns <= GAP_LIMIT_NS:
        after, bits = _begin(sample, position, velocity, steady, now_ns)
        return after, bits + int(Contradiction.CLOCK) * (gap_ns < 0)
    since_ns = sample.t_mono_ns - memory.sample_ns
    drift, still_ns, same_ns = memory.drift, memory.still_ns, memory.same_ns
    bits = np.zeros(len(position), dtype=np.int64)
    if since_ns > 0:
        since_s = since_ns * 1e-9
        moved = position - memory.position
        drift = drift * np.exp(-since_s / DRIFT_MEMORY_S)
        drift = drift + moved - 0.5 * since_s * (velocity + memory.velocity)
        still = moved == 0.0
        still_ns = np.where(still, still_ns + since_ns, 0)
        same_ns = np.where(still & (velocity == memory.velocity), same_ns + since_ns, 0)
    else:
        # No new sample: what was compared last stays what the next one is compared with.
        position, velocity = memory.position, memory.velocity
        if since_ns < 0:
            bits += int(Contradiction.CLOCK)
    open_ns = np.where(np.abs(valve) > OPEN_RATIO, memory.open_ns + gap_ns, 0)
    frozen = (same_ns >= FROZEN_MOVING_NS) | (still_ns >= STILL_MOVING_NS)
    frozen &= np.abs(velocity) > MOVING_RAD_M_PER_S
    frozen |= np.minimum(same_ns, open_ns) >= FROZEN_OPEN_NS
    ticks = max(round(gap_ns * 1e-9 / CONTROL_PERIOD_S), 1)
    drives, unexplained = follow(
        spec, memory.drives, steady, position, velocity, memory.velocity, ticks
    )
    for joints, bit in (
        (np.abs(drift) > DRIFT_LIMIT_RAD_M, Contradiction.JUMP),
        (frozen, Contradiction.FROZEN),
        (unexplained, Contradiction.FOLLOWING),
    ):
        if np.count_nonzero(joints):
            bits += joints.any(axis=1) * int(bit)
    swing, roll = np.full((2, len(position)), np.nan) if gripper_rad is None else gripper_rad.T
    imu, imu_wrong = check_imu(memory.imu, sample, velocity, swing, roll)
    sample_ns = max(sample.t_mono_ns, memory.sample_ns)
    after = GuardMemory(
        now_ns, sample_ns, position, velocity, drift, still_ns, same_ns, open_ns, drives, imu
    )
    return after, bits + imu_wrong * int(Contradiction.IMU)


def _begin(
    sample: SensorSample, position: Array, velocity: Array, steady: Array, now_ns: int
) -> tuple[GuardMemory, IntArray]:
    """The first tick, or the first after a gap: the joints are taken to do what they are seen to do."""
    count = len(position)
    after = initial_guard(count)._replace(
        now_ns=now_ns,
        sample_ns=sample.t_mono_ns,
        position=position,
        velocity=velocity,
        drives=initial_drives(velocity, steady),
        imu=initial_imu(sample.imu_t_mono_ns, imu_numbers(sample)),
    )
    return after, np.zeros(count, dtype=np.int64)
