"""Resampling of a throw log onto the grid of control ticks, with notes of every repair.

Small gaps are interpolated (commands are held) and duplicates dropped; larger defects are refused.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diagnosis.loading.clock_audit import MIN_RATE_HZ, ClockAudit, audit_clock
from diagnosis.loading.log_checks import (
    CLOCK_JUMP_S,
    MAX_MISSING_RATIO,
    MAX_REPAIRED_TICKS,
    RefusedLogError,
    check_finite,
    is_number,
)
from machine.conventions import CONTROL_PERIOD_S, Array, BoolArray, Motion

HISTORY_S: Final = 2.0
"""Time before the throw that is kept, s; valves and swing have no longer memory."""
GRID_TOLERANCE_S: Final = 0.003
"""A row this close to its tick counts as the tick, s; the jitter of control loops is smaller."""

_CLOCK_SET: Final = (
    "the control computer's clock was set, or two logs were joined. Record with the monotonic clock"
)


class ControlGrid(NamedTuple):
    """Control rows on ticks of 10 ms; 0 s is the first tick of `Motion.THROW`."""

    t_s: Array
    valve_ratio: Array
    gripper_open: BoolArray
    payload_held: BoolArray
    motion_code_count: NDArray[np.int8]
    sensor_t_s: Array
    sensor_position_rad_m: Array
    sensor_velocity_rad_m_per_s: Array
    joint_position_rad_m: Array
    joint_velocity_rad_m_per_s: Array
    supply_pressure_pa: Array
    start_ns: int
    audit: ClockAudit
    notes: tuple[str, ...]


def grid_control(rows: NDArray[np.void]) -> ControlGrid:
    """Grid the control rows of one throw.

    Args:
        rows: (rows,) telemetry.CONTROL_ROW as logged.

    Raises:
        RefusedLogError: too slow, too many holes, a clock that jumps, or no throw in it.
    """
    if len(rows) < 10:
        raise RefusedLogError(
            f"it holds {len(rows)} control rows: truncated, or recorded without /control"
        )
    time_s = (rows["t_mono_ns"] - rows["t_mono_ns"][0]).astype(np.float64) * 1e-9
    audit = audit_clock(time_s)
    notes: list[str] = []
    _check_clock(time_s, rows["tick_count"].astype(np.float64), audit)
    if audit.duplicate_count:
        keep = np.concatenate([[True], np.diff(time_s) > 0.0])
        rows, time_s = rows[keep], time_s[keep]
        notes.append(f"{audit.duplicate_count} duplicate control rows dropped")
    thrown = np.flatnonzero(rows["motion_code_count"] == Motion.THROW)
    if thrown.size == 0:
        raise RefusedLogError(
            "no row of it has motion_code_count 2 (throw): the machine never threw in this log"
        )
    start = int(thrown[0])
    keep = time_s >= time_s[start] - HISTORY_S - 1e-6
    start_ns = int(rows["t_mono_ns"][start])
    rows, time_s = rows[keep], time_s[keep] - time_s[start]
    ticks = np.arange(round(time_s[0] / CONTROL_PERIOD_S), round(time_s[-1] / CONTROL_PERIOD_S) + 1)
    grid_s = ticks * CONTROL_PERIOD_S
    before = np.clip(np.searchsorted(time_s, grid_s + GRID_TOLERANCE_S) - 1, 0, None)
    measured = np.abs(time_s[before] - grid_s) <= GRID_TOLERANCE_S
    _note_holes(measured, audit, notes)
    columns = _Columns(rows, time_s, grid_s, before, notes)
    sensor_t_s = (rows["sensor_t_mono_ns"] - start_ns).astype(np.float64) * 1e-9
    _check_sensor_clock(sensor_t_s, time_s)
    return ControlGrid(
        t_s=grid_s,
        valve_ratio=columns.held("valve_applied_ratio"),
        gripper_open=rows["gripper_open_commanded"][before],
        payload_held=rows["payload_held"][before],
        motion_code_count=rows["motion_code_count"][before],
        sensor_t_s=np.interp(grid_s, time_s, sensor_t_s),
        sensor_position_rad_m=columns.smooth("sensor_position_rad_m"),
        sensor_velocity_rad_m_per_s=columns.smooth("sensor_velocity_rad_m_per_s"),
        joint_position_rad_m=columns.smooth("joint_position_rad_m"),
        joint_velocity_rad_m_per_s=columns.smooth("joint_velocity_rad_m_per_s"),
        supply_pressure_pa=rows["supply_pressure_pa"][before],
        start_ns=start_ns,
        audit=audit,
        notes=tuple(notes),
    )


class _Columns(NamedTuple):
    """Rows, where they lie in time, and how to bring a field onto the grid."""

    rows: NDArray[np.void]
    time_s: Array
    grid_s: Array
    before: NDArray[np.int64]
    """(ticks,) the newest row at each tick."""
    notes: list[str]

    def smooth(self, name: str) -> Array:
        """A measured field, linear between its finite rows; (ticks, axes)."""
        values = self.rows[name].astype(np.float64)
        good = self._finite(name, values)
        columns = [
            np.interp(self.grid_s, self.time_s[good], values[good, axis])
            for axis in range(values.shape[1])
        ]
        return np.stack(columns, axis=1)

    def held(self, name: str) -> Array:
        """A command, held until the next finite row; (ticks, axes)."""
        values = self.rows[name].astype(np.float64)
        good = self._finite(name, values)
        last_good = np.maximum.accumulate(np.where(good, np.arange(len(good)), 0))
        return values[last_good[self.before]]

    def _finite(self, name: str, values: Array) -> BoolArray:
        missing = ~is_number(values)
        count = check_finite(name, missing)
        if count:
            self.notes.append(f"{name}: {count} missing values interpolated")
        return ~missing


def _check_clock(time_s: Array, tick_count: Array, audit: ClockAudit) -> None:
    steps, ticks = np.diff(time_s), np.diff(tick_count)
    if audit.backward_count:
        at = int(np.argmin(steps))
        raise RefusedLogError(
            f"its clock jumps back by {-steps[at]:.3f} s at row {at + 1} of {len(time_s)}: {_CLOCK_SET}"
        )
    if np.any(ticks < 0.0):
        # A writer that sorts by time interleaves the rows before and after a jump.
        at = int(np.argmax(ticks < 0.0))
        raise RefusedLogError(
            f"its clock jumps back: the tick counter goes from {tick_count[at]:.0f} to "
            f"{tick_count[at + 1]:.0f} while time goes on, {int(np.sum(ticks < 0.0))} times: {_CLOCK_SET}"
        )
    # Stamps in ns make 24.9999 Hz of 25.
    if round(audit.rate_hz, 2) < MIN_RATE_HZ:
        raise RefusedLogError(
            f"it was logged at {audit.rate_hz:.3g} Hz, at least {MIN_RATE_HZ:g} Hz are needed (a "
            "machine logs 100 Hz): thinned out or written by another recorder. Use the original log"
        )
    if audit.rate_hz > 1000.0:
        raise RefusedLogError(
            f"its clock says {audit.rate_hz:.3g} Hz: swapped units (microseconds for nanoseconds)"
        )
    if np.any(ticks > 0.0):
        # Without jitter, time advances with the tick counter; what is left is the clock's own doing.
        surprise = steps - ticks * CONTROL_PERIOD_S
        at = int(np.argmax(np.abs(surprise)))
        if abs(surprise[at]) > CLOCK_JUMP_S and ticks[at] > 0.0:
            raise RefusedLogError(
                f"its clock jumps by {surprise[at]:+.3f} s at row {at + 1} of {len(time_s)} (the tick "
                f"counter advances by {ticks[at]:.0f}): {_CLOCK_SET}"
            )
    allowed_s = (MAX_REPAIRED_TICKS + 1) * max(CONTROL_PERIOD_S, 1.0 / audit.rate_hz)
    if audit.longest_gap_s > allowed_s + GRID_TOLERANCE_S:
        at = int(np.argmax(steps))
        raise RefusedLogError(
            f"{steps[at]:.3f} s without a row after row {at} of {len(time_s)}; up to "
            f"{MAX_REPAIRED_TICKS} missing ticks are interpolated. The recorder could not keep up or "
            "its clock jumped: check the disk and record again"
        )


def _note_holes(measured: BoolArray, audit: ClockAudit, notes: list[str]) -> None:
    missing = int(np.sum(~measured))
    if not missing:
        return
    if abs(audit.rate_hz * CONTROL_PERIOD_S - 1.0) > 0.1:
        notes.append(f"resampled from {audit.rate_hz:.3g} Hz to {1 / CONTROL_PERIOD_S:g} Hz")
        return
    if missing > MAX_MISSING_RATIO * len(measured):
        raise RefusedLogError(
            f"{missing} of {len(measured)} control ticks are missing or more than "
            f"{GRID_TOLERANCE_S * 1e3:g} ms late (jitter {audit.jitter_s * 1e3:.1f} ms): the recorder "
            "could not keep up. Record again with less load on the machine's computer"
        )
    notes.append(f"{missing} missing control ticks interpolated")


def _check_sensor_clock(sensor_t_s: Array, time_s: Array) -> None:
    age_s = time_s - sensor_t_s
    # The first row may carry a sample from before the loop ran.
    low, high = float(np.min(age_s[1:])), float(np.max(age_s[1:]))
    if low < -0.02 or high > 0.25:
        raise RefusedLogError(
            f"joint samples are {low:.3f} to {high:.3f} s old when they are logged, 0 to 0.25 s is "
            "possible: sensors and control have different clocks, or the sensors hung. Synchronise them"
        )
