"""Motion that valve commands cannot explain: drives modelled by bounds instead of values; batched, pure.

A joint answers a valve after a dead time and a lag, with an opening and a gain; of each only a range is known
(`DRIVE_BOUNDS`, `DEAD_BANDS_RATIO`). Together they bound the speed that the commands of the last moments can
give, from above and below. Speed beyond a bound, integrated, is uncommanded motion (rad or m): of a valve
stuck open, a joint that does not follow, a joint that is moved from outside. A machine within the bounds,
whatever its values, accumulates none (one-sided CUSUM, E. S. Page, Biometrika 41, 1954).
"""

from functools import cache
from typing import Final, NamedTuple

import numpy as np

from machine.conventions import CONTROL_PERIOD_S, Array, BoolArray
from machine.spec import CylinderSpec, MachineSpec


class DriveBounds(NamedTuple):
    """What is known of one joint's drive; gains are relative to a nominal machine."""

    dead_time_s: tuple[float, float]
    """Shortest and longest, from valve command to motion, sensors included."""
    lag_s: tuple[float, float]
    """Shortest for a speed that leaves zero, longest for one that dies away."""
    gain_positive: tuple[float, float]
    """Lowest and highest steady speed in the positive direction."""
    gain_negative: tuple[float, float]
    limit_rad_or_m: float
    """Uncommanded motion that closes the gate."""


DRIVE_BOUNDS: Final = (
    DriveBounds((0.08, 0.20), (0.05, 0.30), (0.65, 1.25), (0.65, 1.25), 0.022),
    DriveBounds((0.04, 0.14), (0.03, 0.06), (0.7, 1.25), (0.7, 1.3), 0.036),
    DriveBounds((0.04, 0.14), (0.03, 0.13), (0.15, 1.3), (0.4, 1.6), 0.024),
    DriveBounds((0.04, 0.14), (0.03, 0.06), (0.7, 1.25), (0.7, 1.25), 0.018),
)
"""Slew, boom, dipper, telescope.

Dead times and lags: docs/machine.md (0.05 to 0.15 s, slew 0.1 to 0.4 s with its lag), 10 ms for sensors and
tick. The slew coasts: its inertia on the motor's relief valve needs 0.3 s. Gains, of a valve with the nominal
metering curve: orifices of 0.875 to 1.125, curves from 0.1 to 0.3, and the pressure that the load takes or
gives; the dipper is driven by its load on its way in (1.6) and held back by it at full reach (0.15). Limits:
1.5 times what healthy throws reach on two plants, the virtual machine and benchmarks/plants/ring, whose boom
rings (`benchmarks/gate_faults.py`).
"""
DEAD_BANDS_RATIO: Final = (0.01, 0.10)
"""Smallest and largest share of the stroke in which a spool opens nothing: 0.04 with its spread, hysteresis,
and what wear adds (docs/machine.md). A relative gain would have to be as wide as the smallest valve needs."""
METERING_CURVE_RATIO: Final = 0.2
"""c of the nominal opening curve a (1 - c + c a): fine metering at small openings."""
SPEED_MARGIN_RAD_OR_M_PER_S: Final = 0.01
"""Of the bounds: noise of a joint's velocity (0.008), ringing at rest."""
MEMORY_S: Final = 2.0
"""Uncommanded motion is forgotten with this time constant."""
END_ZONE_RAD_OR_M: Final = 0.06
"""So close to its position limit a joint need not follow: end cushions and stops (0.05 m of stroke)."""
MIDDLE_RAD: Final = (0.5, 0.0)
"""Boom and dipper angle at which the spec's speed limits are stated."""


_TICKS: Final = np.rint(np.array([b.dead_time_s for b in DRIVE_BOUNDS]) / CONTROL_PERIOD_S).astype(
    np.int64
)
"""(4, 2) shortest and longest dead times."""


class DriveMemory(NamedTuple):
    """What the envelope remembers; leading axis of `bound` and `motion`: positive and negative direction."""

    steady: Array
    """(D, 2, N, 4) `speed_bounds` of the valves of the last ticks, newest first."""
    bound: Array
    """(2, N, 4) highest speed in either direction that they explain now; negative: it must move away."""
    motion: Array
    """(2, N, 4) uncommanded motion in either direction, rad or m."""


class _Drives(NamedTuple):
    """Constants over joints."""

    windows: tuple[tuple[slice, slice], ...]
    """Ticks of the delay line between shortest and longest dead time, and the joints that have them."""
    speed_high: Array
    """(2, 1, 4) highest speed of a full valve in a direction, where the spec's speed limits hold."""
    speed_low: Array
    """(2, 1, 4) lowest."""
    rise: Array
    """(1, 1, 4) share a tick."""
    fall: Array
    limit: Array
    fade: float
    end_low: Array
    """(1, 4) positions beyond which a joint need not follow downwards."""
    end_high: Array
    boom: CylinderSpec
    dipper: CylinderSpec
    middle_arm_m: tuple[float, float]
    """Moment arms of boom and dipper where the speed limits hold."""


@cache
def _drives(spec: MachineSpec) -> _Drives:
    boom, dipper = spec.hydraulics.boom_cylinder, spec.hydraulics.dipper_cylinder
    up = (
        np.array([b.gain_positive for b in DRIVE_BOUNDS]).T * spec.limits.speed_positive_rad_m_per_s
    )
    down = (
        np.array([b.gain_negative for b in DRIVE_BOUNDS]).T * spec.limits.speed_negative_rad_m_per_s
    )
    lag = np.array([b.lag_s for b in DRIVE_BOUNDS])
    share = 1.0 - np.exp(-CONTROL_PERIOD_S / lag)
    low = [-np.inf if v is None else v for v in spec.limits.position_min_rad_m]
    high = [np.inf if v is None else v for v in spec.limits.position_max_rad_m]
    return _Drives(
        windows=_windows(),
        speed_high=np.stack([up[1], down[1]])[:, None],
        speed_low=np.stack([up[0], down[0]])[:, None],
        rise=share[None, None, :, 0],
        fall=share[None, None, :, 1],
        limit=np.array([[[b.limit_rad_or_m for b in DRIVE_BOUNDS]]]),
        fade=float(np.exp(-CONTROL_PERIOD_S / MEMORY_S)),
        end_low=np.asarray([low]) + END_ZONE_RAD_OR_M,
        end_high=np.asarray([high]) - END_ZONE_RAD_OR_M,
        boom=boom,
        dipper=dipper,
        middle_arm_m=(
            float(moment_arm_m(boom, np.array([MIDDLE_RAD[0]]))[0]),
            float(moment_arm_m(dipper, np.array([MIDDLE_RAD[1]]))[0]),
        ),
    )


def _windows() -> tuple[tuple[slice, slice], ...]:
    """Neighbouring joints with the same dead times share a window."""
    found: list[tuple[slice, slice]] = []
    for joint, (first, last) in enumerate(_TICKS.tolist()):
        window, begin = slice(first, last + 1), joint
        if found and found[-1][0] == window:
            begin = found.pop()[1].start
        found.append((window, slice(begin, joint + 1)))
    return tuple(found)


def moment_arm_m(cylinder: CylinderSpec, angle_rad: Array) -> Array:
    """Magnitude of a cylinder's moment arm at joint angles (...), m: |rod x (rod - base)| / length."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    x = cos * cylinder.rod_xz_m[0] - sin * cylinder.rod_xz_m[1]
    z = sin * cylinder.rod_xz_m[0] + cos * cylinder.rod_xz_m[1]
    base_x, base_z = cylinder.base_xz_m
    return np.abs(x * base_z - z * base_x) / np.hypot(x - base_x, z - base_z)


def initial_drives(velocity: Array, steady: Array) -> DriveMemory:
    """Memory of machines whose joints are taken to do what they are seen to do.

    Args:
        velocity: (N, 4) measured.
        steady: (2, N, 4) `speed_bounds` of the present valves, which are taken to have been open for long.
    """
    return DriveMemory(
        np.repeat(steady[None], _TICKS.max() + 1, axis=0),
        np.stack([velocity, -velocity]),
        np.zeros((2, *velocity.shape)),
    )


def speed_bounds(spec: MachineSpec, valve: Array, position: Array) -> Array:
    """Highest speeds (2, N, 4) in positive and negative direction that valves give in the end.

    A negative one is the lowest speed of the other direction: the joint must move away.

    Args:
        spec: machine type.
        valve: (N, 4), -1..1.
        position: (N, 4) of the joints.
    """
    drives = _drives(spec)
    least, most = DEAD_BANDS_RATIO
    size, is_up = np.abs(valve), valve > 0.0
    ratio = np.ones_like(valve)
    boom = moment_arm_m(drives.boom, position[:, 1])
    dipper = moment_arm_m(drives.dipper, position[:, 2])
    ratio[:, 1] = drives.middle_arm_m[0] / np.maximum(boom, 1e-3)
    ratio[:, 2] = drives.middle_arm_m[1] / np.maximum(dipper, 1e-3)
    high, low = _opening(size, least) * ratio, _opening(size, most) * ratio
    bounds = np.empty((2, *valve.shape))
    bounds[0] = np.where(is_up, drives.speed_high[0] * high, -drives.speed_low[1] * low)
    bounds[1] = np.where(is_up, -drives.speed_low[0] * low, drives.speed_high[1] * high)
    return bounds


def _opening(size: Array, dead_band: float) -> Array:
    """Open share of a metering edge at valve commands without sign."""
    share = np.maximum(size - dead_band, 0.0) / (1.0 - dead_band)
    return share * (1.0 - METERING_CURVE_RATIO + METERING_CURVE_RATIO * share)


def follow(
    spec: MachineSpec,
    memory: DriveMemory,
    steady: Array,
    position: Array,
    velocity: Array,
    before: Array,
    tick_count: int,
) -> tuple[DriveMemory, BoolArray]:
    """One tick, or several at once, over which the velocity is taken to change evenly.

    Args:
        spec: machine type.
        memory: of the last tick.
        steady: (2, N, 4) `speed_bounds` of what was let through in the last tick.
        position: (N, 4) measured.
        velocity: (N, 4) measured.
        before: (N, 4) velocity at the last call.
        tick_count: ticks since then.

    Returns:
        Memory, and joints (N, 4) that moved further than any command explains.
    """
    drives = _drives(spec)
    line, bound, motion = memory
    seen = np.empty_like(bound)
    low, high = position < drives.end_low, position > drives.end_high
    is_at_end = np.count_nonzero(low) + np.count_nonzero(high) > 0
    for left in range(tick_count - 1, -1, -1):
        speed = velocity if left == 0 else velocity + left / tick_count * (before - velocity)
        np.subtract(speed, SPEED_MARGIN_RAD_OR_M_PER_S, out=seen[0])
        np.subtract(-SPEED_MARGIN_RAD_OR_M_PER_S, speed, out=seen[1])
        line = np.concatenate([steady[None], line[:-1]])
        explained = np.empty_like(bound)
        for window, joints in drives.windows:
            explained[:, :, joints] = line[window, :, :, joints].max(axis=0)
        if is_at_end:
            np.maximum(explained[0], 0.0, out=explained[0], where=low)
            np.maximum(explained[1], 0.0, out=explained[1], where=high)
        change = explained - bound
        bound = bound + np.where(change > 0.0, drives.rise, drives.fall) * change
        motion = np.maximum(drives.fade * motion + CONTROL_PERIOD_S * (seen - bound), 0.0)
    over: BoolArray = np.greater(motion, drives.limit)
    return DriveMemory(line, bound, motion), over[0] | over[1]


def motion_ratio(spec: MachineSpec, memory: DriveMemory) -> Array:
    """Uncommanded motion (N, 4) as a share of its limit, the larger of both directions."""
    return (memory.motion / _drives(spec).limit).max(axis=0)
