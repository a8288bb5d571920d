"""A throw's log as time series for charts, and as a motion for the 3D view."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from machine.conventions import ACTIVE_JOINTS, CONTROL_PERIOD_S, JOINT_NAMES, Array, Motion
from machine.kinematics import swing_rad
from runtime.records.throw_log import ThrowLog
from server.schemas.history import PhaseBand, ThrowSeries
from server.viewer.replay import ThrowMotion

_PHASE_NAMES = {
    Motion.HOLD: "hold",
    Motion.ALIGN: "align",
    Motion.THROW: "swing",
    Motion.SETTLE: "settle",
    Motion.STOP: "stop",
}
_FOUR_COLUMNS = (
    ("sensor_position_rad_m", "sensor_position", ""),
    ("sensor_velocity_rad_m_per_s", "sensor_velocity", "_per_s"),
    ("velocity_request_rad_m_per_s", "velocity_request", "_per_s"),
    ("velocity_reference_rad_m_per_s", "velocity_reference", "_per_s"),
)


def _seconds(t_mono_ns: NDArray[np.int64], start_ns: int) -> Array:
    return (t_mono_ns - start_ns).astype(np.float64) * 1e-9


def _values(column: Array) -> tuple[float | None, ...]:
    return tuple(round(float(v), 6) if np.isfinite(v) else None for v in column)


def _unit(joint: str) -> str:
    return "m" if joint == "telescope" else "rad"


def _columns(log: ThrowLog) -> dict[str, Sequence[float | None]]:
    control = log.control
    columns: dict[str, Sequence[float | None]] = {}
    for index, joint in enumerate(JOINT_NAMES):
        position, velocity = control["joint_position_rad_m"], control["joint_velocity_rad_m_per_s"]
        columns[f"{joint}_position_{_unit(joint)}"] = _values(position[:, index])
        columns[f"{joint}_velocity_{_unit(joint)}_per_s"] = _values(velocity[:, index])
    for field, name, per in _FOUR_COLUMNS:
        for index, joint in enumerate(ACTIVE_JOINTS):
            columns[f"{joint}_{name}_{_unit(joint)}{per}"] = _values(control[field][:, index])
    for field in ("valve_requested_ratio", "valve_applied_ratio"):
        for index, joint in enumerate(ACTIVE_JOINTS):
            columns[f"{joint}_{field}"] = _values(control[field][:, index])
    columns["swing_rad"] = _values(swing_rad(control["joint_position_rad_m"]))
    columns["roll_swing_rad"] = columns["roll_position_rad"]
    columns["supply_pressure_pa"] = _values(control["supply_pressure_pa"])
    columns["payload_held_ratio"] = _values(control["payload_held"].astype(np.float64))
    columns["gripper_open_commanded_ratio"] = _values(
        control["gripper_open_commanded"].astype(np.float64)
    )
    columns["safety_code_count"] = _values(control["safety_code_count"].astype(np.float64))
    return columns


def _bands(log: ThrowLog, t_s: Array) -> list[PhaseBand]:
    codes = log.control["motion_code_count"]
    edges = [0, *(np.flatnonzero(np.diff(codes)) + 1).tolist(), len(codes)]
    return [
        PhaseBand(
            name=_PHASE_NAMES.get(Motion(int(codes[first])), "hold"),
            start_s=float(t_s[first]),
            end_s=float(t_s[min(last, len(codes) - 1)]),
        )
        for first, last in pairwise(edges)
    ]


def release_s(log: ThrowLog, t_s: Array) -> float | None:
    """When the load left: the gripper's switch says so after the command to open."""
    opened = np.flatnonzero(log.control["gripper_open_commanded"])
    if opened.size == 0:
        return None
    gone = np.flatnonzero(~log.control["payload_held"][opened[0] :])
    return float(t_s[opened[0] + gone[0]]) if gone.size else None


def series_of(throw_id: str, log: ThrowLog) -> ThrowSeries:
    """Columns over time since the first control tick."""
    start_ns = int(log.control["t_mono_ns"][0]) if len(log.control) else 0
    t_s = _seconds(log.control["t_mono_ns"], start_ns)
    left_s = release_s(log, t_s)
    impact_s = (log.impact_t_mono_ns - start_ns) * 1e-9 if log.impact_t_mono_ns else None
    phases = _bands(log, t_s) if len(t_s) else []
    if left_s is not None and impact_s is not None:
        phases.append(PhaseBand(name="flight", start_s=left_s, end_s=impact_s))
    ball = log.ball[np.isfinite(log.ball["position_m"]).all(axis=1)]
    return ThrowSeries(
        throw_id=throw_id,
        t_s=tuple(np.round(t_s, 4).tolist()),
        columns=_columns(log) if len(t_s) else {},
        phases=tuple(phases),
        release_s=left_s,
        impact_s=impact_s,
        ball_t_s=tuple(np.round(_seconds(ball["t_mono_ns"], start_ns), 4).tolist()),
        ball_position_m=tuple((float(x), float(y), float(z)) for x, y, z in ball["position_m"]),
    )


def motion_of(log: ThrowLog) -> ThrowMotion:
    """The recorded motion, one frame a control tick, with the load's tracked flight.

    Raises:
        ValueError: the log holds fewer than two control ticks.
    """
    frames = np.nan_to_num(log.control["joint_position_rad_m"].astype(np.float64))
    if len(frames) < 2:
        raise ValueError("the log holds no motion")
    start_ns = int(log.control["t_mono_ns"][0])
    t_s = _seconds(log.control["t_mono_ns"], start_ns)
    left_s = release_s(log, t_s)
    ball = log.ball[np.isfinite(log.ball["position_m"]).all(axis=1)]
    path, flight_s = np.zeros((0, 3)), 0.0
    if left_s is not None and len(ball) > 1:
        ball_s = _seconds(ball["t_mono_ns"], start_ns)
        in_flight = ball_s >= left_s
        if np.count_nonzero(in_flight) > 1:
            end_s = float(ball_s[in_flight][-1])
            even_s = np.linspace(left_s, end_s, max(int((end_s - left_s) / 0.02), 2))
            path = np.stack(
                [np.interp(even_s, ball_s, ball["position_m"][:, axis]) for axis in range(3)],
                axis=1,
            )
            flight_s = end_s - left_s
    return ThrowMotion(
        frames_rad_m=frames,
        frame_period_s=float(np.median(np.diff(t_s))) or CONTROL_PERIOD_S,
        ball_path_m=path,
        release_s=left_s,
        flight_s=flight_s,
    )
