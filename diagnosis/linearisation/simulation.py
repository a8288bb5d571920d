"""One batch of replays, each by the shortest simulation that its view needs.

The drives alone for the actuation view; the whole twin until shortly after the opening for the swing; for
the flight, whose joints are all measured, some ticks about the opening and then the load alone. The only
approximation is that the drives do not react to the arm (sim_twin.replay.drives).
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from diagnosis.linearisation.parameters import ReplayKind
from diagnosis.loading.prepared import IMU_UNTIL_AFTER_OPENING_S
from machine.calibration import ValveCalibration
from machine.conventions import ACTIVE_COUNT, ACTIVE_JOINTS, CONTROL_PERIOD_S, Array
from sim_twin.effects.effect import Effect, acting_effect, resolve
from sim_twin.effects.table import EFFECTS
from sim_twin.replay.drives import replay_drives
from sim_twin.replay.motion import shifted
from sim_twin.replay.replay import ReplayElement, ReplayInput, ReplayOutput, fly, replay
from sim_twin.twin.profile import TwinProfile

LATEST_SENSOR_S = 0.2
"""Upper bound of sensor latencies, s: measured motion is needed this far ahead."""
BEFORE_OPENING_TICKS = 3
"""Ticks simulated before the opening in the flight view."""

Track = tuple[float, Array]
"""Start of a load's track (s after the throw's start) and its points (K, 3) every control tick."""


class Simulated(NamedTuple):
    """Results of M elements; rows of views that an element does not have are zero or NaN."""

    joint_velocity_rad_m_per_s: Array
    """(M, T, 4) true velocity."""
    joint_latency_s: Array
    """(M, 4) latency of the joint sensors."""
    gyro_rad_per_s: Array
    """(M, T, 3)"""
    accel_m_per_s2: Array
    """(M, T, 3)"""
    ball: list[Track | None]
    impact_m: Array
    """(M, 3)"""
    release_t_s: Array
    """(M,)"""
    release_position_m: Array
    release_velocity_m_per_s: Array


def simulate(
    inputs: Sequence[ReplayInput],
    elements: Sequence[ReplayElement],
    views: Sequence[ReplayKind],
    profile: TwinProfile,
    calibration: ValveCalibration,
) -> Simulated:
    """Simulate all elements, each in its view.

    Args:
        inputs: recorded throws.
        elements: M of them.
        views: of each element.
        profile: of the machine.
        calibration: of its valves.
    """
    count, ticks = len(elements), max(t.valve_ratio.shape[0] for t in inputs)
    out = Simulated(
        np.zeros((count, ticks, ACTIVE_COUNT)),
        np.array(
            [joint_latency_s((*profile.effects, *e.effects), inputs[e.throw]) for e in elements]
        ),
        np.full((count, ticks, 3), np.nan),
        np.full((count, ticks, 3), np.nan),
        [None] * count,
        *(np.full(shape, np.nan) for shape in ((count, 3), (count,), (count, 3), (count, 3))),
    )

    def rows_of(*chosen: bool) -> list[int]:
        return [row for row, is_one in enumerate(chosen) if is_one]

    drives = rows_of(*(view is ReplayKind.ACTUATION for view in views))
    swings = rows_of(*(view is ReplayKind.SWING for view in views))
    slow = [
        view is ReplayKind.FLIGHT and _has_memory((*profile.effects, *element.effects))
        for view, element in zip(views, elements, strict=True)
    ]
    quick = [view is ReplayKind.FLIGHT and not one for view, one in zip(views, slow, strict=True)]
    if drives:
        chosen = [elements[r] for r in drives]
        velocity = replay_drives(inputs, chosen, profile, calibration, as_measured=True)
        out.joint_velocity_rad_m_per_s[drives, : velocity.shape[1]] = velocity
    if swings:
        _swing(out, inputs, elements, swings, profile, calibration)
    for rows, is_cut in ((rows_of(*slow), False), (rows_of(*quick), True)):
        if rows:
            _flight(out, inputs, elements, rows, profile, calibration, is_cut=is_cut)
    return out


def joint_latency_s(effects: Sequence[Effect], one: ReplayInput) -> Array:
    """Latency (4,) of the joint sensors of a machine with these effects in one throw."""
    sizes = resolve(effects, one.progress_ratio)
    return np.array(
        [
            sizes.get(("joint_sensor_latency", joint, "extra_latency_s"), 0.0)
            for joint in ACTIVE_JOINTS
        ]
    )


def late(track: Array, latency_s: float) -> Array:
    """A track (T,) of control ticks as a sensor with this latency reports it; at rest before."""
    if latency_s <= 0.0:
        return track
    return shifted(track, np.asarray(-latency_s / CONTROL_PERIOD_S))


def _has_memory(effects: Sequence[Effect]) -> bool:
    return any(EFFECTS[acting_effect(e)].has_memory for e in effects)


def _swing(
    out: Simulated,
    inputs: Sequence[ReplayInput],
    elements: Sequence[ReplayElement],
    rows: list[int],
    profile: TwinProfile,
    calibration: ValveCalibration,
) -> None:
    cut = [
        sliced(one, 0, one.opening_t_s + IMU_UNTIL_AFTER_OPENING_S + LATEST_SENSOR_S)
        for one in inputs
    ]
    found = replay(cut, [elements[r] for r in rows], profile, calibration)
    ticks = found.gyro_rad_per_s.shape[1]
    out.gyro_rad_per_s[rows, :ticks] = found.gyro_rad_per_s
    out.accel_m_per_s2[rows, :ticks] = found.accel_m_per_s2


def _flight(
    out: Simulated,
    inputs: Sequence[ReplayInput],
    elements: Sequence[ReplayElement],
    rows: list[int],
    profile: TwinProfile,
    calibration: ValveCalibration,
    *,
    is_cut: bool,
) -> None:
    first = [
        max(math.floor(one.opening_t_s / CONTROL_PERIOD_S) - BEFORE_OPENING_TICKS, 0) * is_cut
        for one in inputs
    ]
    cut = [
        sliced(one, begin, one.opening_t_s + LATEST_SENSOR_S)
        for one, begin in zip(inputs, first, strict=True)
    ]
    chosen = [elements[r] for r in rows]
    found = replay(cut, chosen, profile, calibration)
    begin_s = CONTROL_PERIOD_S * np.array([first[e.throw] for e in chosen])
    out.release_t_s[rows] = found.release_t_s + begin_s
    out.release_position_m[rows] = found.release_position_m
    out.release_velocity_m_per_s[rows] = found.release_velocity_m_per_s
    out.impact_m[rows] = found.impact_m
    track = _tracks(found, cut, chosen, profile)
    for row, start_s, points in zip(rows, out.release_t_s[rows], track, strict=True):
        known = int(np.isfinite(points[:, 0]).sum())
        if known >= 2 and np.isfinite(start_s):
            out.ball[row] = float(start_s), points[:known]


def _tracks(
    found: ReplayOutput,
    inputs: Sequence[ReplayInput],
    elements: Sequence[ReplayElement],
    profile: TwinProfile,
) -> Array:
    """Points (M, K, 3) of the loads in flight, from their release on."""
    return fly(
        found.release_position_m,
        found.release_velocity_m_per_s,
        profile,
        [e.effects for e in elements],
        surface_height_m=np.array([inputs[e.throw].surface_height_m for e in elements]),
        progress_ratio=np.array([inputs[e.throw].progress_ratio for e in elements]),
    ).track_m


def sliced(one: ReplayInput, first: int, until_s: float) -> ReplayInput:
    """The ticks of a throw from row `first` to a time; times count from the new first row.

    A throw without a measured opening (NaN) is not cut.
    """
    total = one.valve_ratio.shape[0]
    last = math.ceil(until_s / CONTROL_PERIOD_S) + 1 if np.isfinite(until_s) else total
    rows, begin_s = slice(first, max(last, first + 2)), first * CONTROL_PERIOD_S
    swing, rate = one.swing_rad, one.swing_rate_rad_per_s
    gyro = one.gyro_rad_per_s
    start, start_rate = one.swing_start_rad, one.swing_rate_start_rad_per_s
    if first > 0 and swing is not None and rate is not None:
        start, start_rate = swing[first], rate[first]
    return one._replace(
        valve_ratio=one.valve_ratio[rows],
        gripper_open=one.gripper_open[rows],
        position_rad_m=one.position_rad_m[rows],
        velocity_rad_m_per_s=one.velocity_rad_m_per_s[rows],
        swing_start_rad=start,
        swing_rate_start_rad_per_s=start_rate,
        release_t_s=one.release_t_s - begin_s,
        opening_t_s=one.opening_t_s - begin_s,
        swing_rad=None if swing is None else swing[rows],
        swing_rate_rad_per_s=None if rate is None else rate[rows],
        gyro_rad_per_s=None if gyro is None else gyro[rows],
        start_force_m_per_s2=one.start_force_m_per_s2 if first == 0 else None,
    )
