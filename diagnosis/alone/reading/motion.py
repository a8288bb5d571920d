"""One joint's record out of a table: command and output, cleaned, in SI, runs one after the other.

Between two runs the command rests and nothing is compared; a clock that was set back is refused.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from diagnosis.alone.reading.layout import MIN_ROWS, RefusedTableError
from diagnosis.alone.reading.runs import (
    MAX_MISSING_RATIO,
    audit_times,
    clean_series,
    is_even,
    moves_on,
    split_runs,
    time_seconds,
)
from diagnosis.alone.reading.tables import Table
from diagnosis.alone.reading.units import motion_in_si
from diagnosis.loading.clock_audit import ClockAudit
from machine.conventions import Array, IntArray

REST_BETWEEN_RUNS_S: Final = 3.0
RESTART_RATIO: Final = 0.1
"""A new run starts within this part of the span from the first time of all; else the clock was set back."""


class Motion(NamedTuple):
    """One joint's record, cleaned; times from its first row."""

    time_s: Array
    command: Array
    """(rows,) as given."""
    output: Array
    """(rows,) position or speed; rad, rad/s, m, m/s, or the unit of the file."""
    run: IntArray
    """(rows,) number of the run."""
    is_speed: bool
    unit: str
    told_period_s: float = 0.0
    """How often a command was logged that came evenly and more seldom than the joint; else 0."""


def read_motion(
    table: Table, time: str, command: str, output: str, is_speed: bool, labels: Sequence[str]
) -> tuple[Motion, ClockAudit]:
    """One joint of a table; `labels` (rows,) tell runs apart, a restart of time does it as well.

    Raises:
        RefusedTableError: unusable columns.
    """
    raw_s = time_seconds(table, time)
    values, unit = motion_in_si(table, output, table.numbers(output), is_speed)
    commands = table.numbers(command)
    runs = _runs_of(raw_s, labels, time)
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
        own_s, position = clean_series(
            raw_s[inside], values[inside], f"column {output!r}", table.notes
        )
        if not np.any(known):
            raise RefusedTableError(f"the command {command!r} has no number in run {number + 1}")
        shift = start_s - own_s[0] if parts else 0.0
        u = _between_rows(raw_s[known], commands[known], own_s)
        parts.append((own_s + shift, u, position))
        start_s = float(parts[-1][0][-1]) + REST_BETWEEN_RUNS_S
    if not parts:
        raise RefusedTableError(
            f"no run of {table.path.name} has {MIN_ROWS} rows with {command!r} and {output!r}"
        )
    time_s, u, position = (np.concatenate(column) for column in zip(*parts, strict=True))
    longest_run = runs == int(np.argmax(np.bincount(runs)))
    longest = longest_run
    if np.mean(np.isfinite(values[longest])) < 1.0 - MAX_MISSING_RATIO:
        longest = longest & np.isfinite(values)  # rows of other topics are no samples of the joint
    audit = audit_times(table, raw_s[longest], f"{table.path.name}")
    if len(parts) > 1:
        table.notes.append(f"{len(parts)} runs, taken one after the other with rest between")
    run = np.repeat(np.arange(len(parts)), [len(part[0]) for part in parts])
    _check_changes(command, output, u, position)
    told_s = raw_s[longest_run & np.isfinite(commands)]
    is_slow = len(told_s) < 0.5 * np.sum(longest) and is_even(told_s)
    # What was told counts from the nearest row of the joint on.
    told_period_s = float(np.median(np.diff(told_s))) + 1.0 / audit.rate_hz if is_slow else 0.0
    return Motion(time_s, u, position, run, is_speed, unit, told_period_s), audit


def _between_rows(told_s: Array, told: Array, own_s: Array) -> Array:
    """(rows,) commands at the rows of the joint: held, or a line where they are seldom, even and moving on.

    A command that is written only when it changes comes unevenly.
    """
    is_slow = len(told_s) < 0.5 * len(own_s)
    if is_slow and is_even(told_s) and moves_on(told):
        return np.interp(own_s, told_s, told)
    # Between two rows of the joint the nearer one takes it over: the next one would add half a period.
    near_s = own_s + (0.49 * float(np.median(np.diff(own_s))) if is_slow else 0.0)
    return told[np.clip(np.searchsorted(told_s, near_s, side="right") - 1, 0, None)]


def _check_changes(command: str, output: str, u: Array, position: Array) -> None:
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


def _runs_of(time_s: Array, labels: Sequence[str], time: str) -> IntArray:
    """Number of the run of each row, (rows,): another label, or times that start again.

    Raises:
        RefusedTableError: times that go back into the middle of a run.
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
