"""A joint's record from a table: command and output, cleaned, in SI units, and the scale of the command.

Several runs are put one after the other with rest in between, where nothing is compared.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from diagnosis.loading.clock_audit import ClockAudit
from diagnosis.tables.cells import RefusedTableError
from diagnosis.tables.column_units import joint_output_in_si
from diagnosis.tables.layouts import MIN_ROWS
from diagnosis.tables.table import Table
from diagnosis.tables.time_series import (
    MAX_MISSING_RATIO,
    audit_times,
    clean_series,
    is_continuous_command,
    is_evenly_sampled,
    split_runs,
    time_in_seconds,
)
from machine.conventions import Array, IntArray

REST_BETWEEN_RUNS_S: Final = 3.0
"""Pause put between two runs, s."""
RESTART_RATIO: Final = 0.1
"""A run starts within this share of the time span from the earliest time; else the clock was set back."""
MIN_CHANGES_COUNT: Final = 20
"""Fewest command changes from which its sample period can be estimated."""
MAX_COMMAND_PERIOD_S: Final = 0.2
"""Changes further apart than this, s, are steps by the operator, not a slow log."""
FULL_SCALES: Final = {
    **dict.fromkeys((1.0, 100.0), 0.7),
    **dict.fromkeys((127.0, 255.0, 1023.0, 1024.0, 32767.0), 0.9),
}
"""Full scale of usual levers, bus signals and duty cycles, and the share of it that a record must reach."""
MIN_PERCENT: Final = 5.0
"""Largest command of a column in percent below which it holds parts of 1 in spite of its unit."""
RESTING_RATIO: Final = 0.3
"""Largest speed at rest, as a share of the top speed."""


class JointRecord(NamedTuple):
    """One joint's record, cleaned; times from its first row."""

    time_s: Array
    command: Array
    """(rows,) in the unit of the file."""
    output: Array
    """(rows,) position or velocity in rad, rad/s, m, m/s, or the unit of the file."""
    run: IntArray
    """(rows,) number of the run."""
    is_speed: bool
    unit: str
    command_period_s: float = 0.0
    """Sample period of a command that was logged evenly but less often than the joint; else 0."""


def read_joint_record(
    table: Table, time: str, command: str, output: str, is_speed: bool, labels: Sequence[str]
) -> tuple[JointRecord, ClockAudit]:
    """Read one joint from a table.

    Args:
        table: the table; notes are added.
        time: name of the time column.
        command: name of the command column.
        output: name of the position or velocity column.
        is_speed: whether `output` is a velocity.
        labels: (rows,) labels of runs; a restart of time also begins a run.

    Returns:
        The record and the audit of its clock.

    Raises:
        RefusedTableError: the columns cannot be used.
    """
    raw_s = time_in_seconds(table, time)
    values, unit = joint_output_in_si(table, output, table.numbers(output), is_speed)
    commands = table.numbers(command)
    runs = _number_runs(raw_s, labels, time)
    if holes := int(np.sum(~np.isfinite(commands))):
        table.notes.append(
            f"the command {command!r} has no number in {holes} of {len(commands)} rows: held from before"
        )
    parts: list[tuple[Array, Array, Array]] = []
    start_s = 0.0
    for number in np.unique(runs):
        inside = runs == number
        known = np.isfinite(commands) & np.isfinite(raw_s) & inside
        if runs[-1] > 0 and int(np.sum(np.isfinite(values) & known)) < MIN_ROWS:
            table.notes.append(f"run {number + 1}: fewer than {MIN_ROWS} rows, left out")
            continue
        row_time_s, position = clean_series(
            raw_s[inside], values[inside], f"column {output!r}", table.notes
        )
        if not np.any(known):
            raise RefusedTableError(f"the command {command!r} has no number in run {number + 1}")
        shift = start_s - row_time_s[0] if parts else 0.0
        u = _command_at_rows(raw_s[known], commands[known], row_time_s)
        parts.append((row_time_s + shift, u, position))
        start_s = float(parts[-1][0][-1]) + REST_BETWEEN_RUNS_S
    if not parts:
        raise RefusedTableError(
            f"no run of {table.path.name} has {MIN_ROWS} rows with {command!r} and {output!r}"
        )
    time_s, u, position = (np.concatenate(column) for column in zip(*parts, strict=True))
    longest_run = runs == int(np.argmax(np.bincount(runs)))
    longest = longest_run
    if np.mean(np.isfinite(values[longest])) < 1.0 - MAX_MISSING_RATIO:
        longest = longest & np.isfinite(values)  # rows of other topics are not samples of the joint
    audit = audit_times(table, raw_s[longest], f"{table.path.name}")
    if len(parts) > 1:
        table.notes.append(f"{len(parts)} runs, taken one after the other with rest between")
    run = np.repeat(np.arange(len(parts)), [len(part[0]) for part in parts])
    _refuse_constant_channels(command, output, u, position)
    command_time_s = raw_s[longest_run & np.isfinite(commands)]
    is_slow = len(command_time_s) < 0.5 * np.sum(longest) and is_evenly_sampled(command_time_s)
    # A command takes effect at the nearest row of the joint: one more joint period of uncertainty.
    command_period_s = (
        float(np.median(np.diff(command_time_s))) + 1.0 / audit.rate_hz if is_slow else 0.0
    )
    return JointRecord(time_s, u, position, run, is_speed, unit, command_period_s), audit


def _command_at_rows(command_time_s: Array, commands: Array, row_time_s: Array) -> Array:
    """The command at the joint's rows, (rows,).

    It is held from its last row; it is interpolated if it was logged evenly, less often than the joint, and
    moves continuously. A command that is logged only when it changes comes unevenly.
    """
    is_slow = len(command_time_s) < 0.5 * len(row_time_s)
    if is_slow and is_evenly_sampled(command_time_s) and is_continuous_command(commands):
        return np.interp(row_time_s, command_time_s, commands)
    # A command between two joint rows is assigned to the nearer one; the later one would add half a period.
    near_s = row_time_s + (0.49 * float(np.median(np.diff(row_time_s))) if is_slow else 0.0)
    return commands[np.clip(np.searchsorted(command_time_s, near_s, side="right") - 1, 0, None)]


def _refuse_constant_channels(command: str, output: str, u: Array, position: Array) -> None:
    if np.ptp(u) == 0.0:
        raise RefusedTableError(
            f"the command {command!r} is {u[0]:.6g} throughout: constant channel. Without a command that "
            "changes nothing can be said; record steps in both directions with rests between"
        )
    if np.ptp(position) == 0.0:
        raise RefusedTableError(
            f"{output!r} is {position[0]:.6g} throughout while the command changes: constant channel. "
            "Check the sensor, or choose another column"
        )


def _number_runs(time_s: Array, labels: Sequence[str], time: str) -> IntArray:
    """Number of the run of each row, (rows,): a run begins at another label or where time restarts.

    Raises:
        RefusedTableError: time goes back within a run, or there are too many runs.
    """
    names = np.array(labels)
    steps_s = np.diff(time_s)
    changed = names[1:] != names[:-1]
    back = np.isfinite(steps_s) & (steps_s < 0.0)
    low, high = float(np.nanmin(time_s)), float(np.nanmax(time_s))
    restart = back & (time_s[1:] <= low + RESTART_RATIO * (high - low))
    wrong = np.flatnonzero(back & ~restart & ~changed)
    if wrong.size:
        split_runs(time_s[np.isfinite(time_s)])
        raise RefusedTableError(
            f"the times in column {time!r} go back by {-steps_s[wrong[0]]:.3g} s in row {wrong[0] + 3}: "
            "unsorted rows, or a clock that was set. Sort the rows, give one file a run, or "
            "--group COLUMN if a column tells runs apart"
        )
    runs = np.concatenate([[0], np.cumsum(changed | restart)]).astype(np.int64)
    if runs[-1] > max(len(time_s) / MIN_ROWS, 1.0):
        raise RefusedTableError(
            f"{runs[-1] + 1} runs in {len(time_s)} rows: too short, or rows of several runs are mixed. "
            "Sort by run and time"
        )
    return runs


class CommandScale(NamedTuple):
    """Rest, full scale and sampling of a joint's command."""

    rest: float
    full: float
    """Distance from rest to full command, in the column's unit."""
    is_continuous: bool
    """Whether the command moves from row to row; otherwise it is held until the next row."""
    period_s: float
    """Sample period of the command, s."""
    notes: tuple[str, ...]

    def on_grid(self, record: JointRecord, grid_s: Array) -> Array:
        """Mean of the command over each tick, (ticks,), rest at 0 and full at 1.

        Between two runs it is 0; no sample is compared there.
        """
        time_s = record.time_s - record.time_s[0]
        held = np.clip(np.searchsorted(time_s, grid_s + 1e-9, side="right") - 1, 0, None)
        ahead = np.clip(held + 1, 0, len(time_s) - 1)
        if self.is_continuous:
            values = np.interp(grid_s + 0.5 * float(grid_s[1]), time_s, record.command)
        else:
            values = _mean_of_held_command(time_s, record.command, grid_s)
        inside = record.run[held] == record.run[ahead]
        return np.where(inside, values - self.rest, 0.0) / self.full


def _mean_of_held_command(time_s: Array, command: Array, grid_s: Array) -> Array:
    """Mean over each tick, (ticks,), of a command that is held until its next row."""
    passed = np.concatenate([[0.0], np.cumsum(command[:-1] * np.diff(time_s))])
    ends_s = np.append(grid_s, grid_s[-1] + grid_s[1])
    total = np.interp(ends_s, time_s, passed) + command[-1] * np.maximum(ends_s - time_s[-1], 0.0)
    mean = np.diff(total) / np.diff(ends_s)
    # Without a change within the tick the exact value is kept, so that rest is exactly 0.
    first = np.clip(np.searchsorted(time_s, grid_s + 1e-9, side="right") - 1, 0, None)
    last = np.clip(np.searchsorted(time_s, ends_s[1:] - 1e-9, side="right") - 1, 0, None)
    changes = np.concatenate([[0], np.cumsum(np.diff(command) != 0.0)])
    return np.where(changes[last] == changes[first], command[first], mean)


def read_command_scale(
    record: JointRecord, words: tuple[str, ...], period_s: float
) -> CommandScale:
    """Find rest, full scale and sample period of a joint's command.

    Args:
        record: the joint's record.
        words: of the command column's name and unit.
        period_s: median sample period of the joint.
    """
    rest, note = _find_rest(record)
    notes = [note]
    largest = float(np.max(np.abs(record.command - rest)))
    full = _find_full(largest, words) if rest == 0.0 else largest
    kind = "the largest of the record" if full == largest else f"the largest here is {largest:.4g}"
    notes.append(f"full command taken as {full:.4g} ({kind}): parts of command are of that")
    is_continuous = is_continuous_command(record.command)
    return CommandScale(
        rest, full, is_continuous, _find_command_period(record, period_s), tuple(notes)
    )


def _find_full(largest: float, words: tuple[str, ...]) -> float:
    """The nominal full scale if the largest command comes near it, else the largest command."""
    if {"pct", "percent"} & set(words) and MIN_PERCENT <= largest <= 100.0:
        return 100.0
    for end, ratio in FULL_SCALES.items():
        if ratio * end <= largest <= end:
            return end
    return largest


def _find_command_period(record: JointRecord, period_s: float) -> float:
    """Shortest usual time between two changes of the command, s; at least the sample period."""
    changes = record.time_s[1:][np.diff(record.command) != 0.0]
    period_s = max(period_s, record.command_period_s)
    if changes.size < MIN_CHANGES_COUNT:
        return period_s
    shortest = float(np.quantile(np.diff(changes), 0.1))
    return period_s if shortest > MAX_COMMAND_PERIOD_S else max(shortest, period_s)


def _find_rest(record: JointRecord) -> tuple[float, str]:
    """The command at which the joint rests, and a note with the reason."""
    u = record.command
    if np.min(u) <= 0.0 <= np.max(u) and (np.min(u) < 0.0 or np.mean(u == 0.0) > 0.02):
        return 0.0, "command 0 taken as rest"
    values, counts = np.unique(np.round(u, 9), return_counts=True)
    common = int(np.argmax(counts))
    if counts[common] > 0.05 * len(u):
        rest = float(values[common])
        if _is_at_rest(record, rest):
            return rest, f"command {rest:g} taken as rest: its most frequent value"
        turning = _find_zero_speed_command(record)
        if turning is not None:
            return turning, f"command {turning:.4g} taken as rest: the joint turns around there"
    if np.min(u) > 0.0 and np.min(u) < 0.1 * np.max(u):
        return 0.0, "command 0 taken as rest"
    middle = 0.5 * float(np.min(u) + np.max(u))
    return middle, f"command {middle:g} taken as rest: the middle of its range"


def _estimate_speed(record: JointRecord) -> Array:
    """Rough speed over about a quarter of a second, (rows,)."""
    if record.is_speed:
        return record.output
    period_s = float(np.median(np.diff(record.time_s)))
    half = max(1, round(0.125 / period_s))
    low = np.clip(np.arange(len(record.time_s)) - half, 0, None)
    high = np.clip(np.arange(len(record.time_s)) + half, None, len(record.time_s) - 1)
    moved = record.output[high] - record.output[low]
    return moved / np.maximum(record.time_s[high] - record.time_s[low], 1e-9)


def _is_at_rest(record: JointRecord, rest: float) -> bool:
    """Whether the joint hardly moves while the command is at `rest`."""
    speed = np.abs(_estimate_speed(record))
    top = float(np.quantile(speed, 0.95))
    return float(np.median(speed[np.abs(record.command - rest) < 1e-9])) < RESTING_RATIO * top


def _find_zero_speed_command(record: JointRecord) -> float | None:
    """Command at which a line of speed over command crosses zero; None outside the record's range."""
    slope, offset = np.polyfit(record.command, _estimate_speed(record), 1)
    if slope == 0.0:
        return None
    zero = float(-offset / slope)
    return zero if np.min(record.command) < zero < np.max(record.command) else None
