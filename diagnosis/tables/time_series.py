"""Time columns and runs of a table: units of time, sampling rate, splitting into runs, missing values.

Repairs are noted. What cannot be used is refused with numbers, cause and remedy.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from diagnosis.loading.clock_audit import ClockAudit, audit_clock
from diagnosis.tables.cells import RefusedTableError
from diagnosis.tables.layouts import MIN_ROWS
from diagnosis.tables.table import Table
from machine.conventions import Array, IntArray

MIN_RATE_HZ: Final = 8.0
"""Lowest sampling rate; below it dead times, and friction within a swing, cannot be seen."""
RUN_GAP_S: Final = 1.0
"""Shortest pause between two runs, s."""
RUN_GAP_PERIODS: Final = 12.0
"""Shortest pause between two runs, in median sample periods; both limits must be exceeded."""
MAX_MISSING_RATIO: Final = 0.3
"""Largest share of missing values."""
CONTINUOUS_RATIO: Final = 0.5
"""Share of command changes followed by another in the next row above which a command moves continuously."""
UNIT_CHANGE_BLOCKS: Final = 10
"""Parts of a record whose sample periods are compared."""
UNIT_CHANGE_TOLERANCE_RATIO: Final = 0.25
"""Deviation of the ratio of two sample periods from a power of 1000, up to which the unit of time changed."""
HOLE_PERIODS: Final = 3.5
"""A step longer than this many median steps is a gap."""
MAX_STEP_DAYS: Final = 5e-6
"""Longest step of times in days, 0.4 s; as seconds it would mean 200 kHz."""
SERIAL_DAYS: Final = (3e4, 9e5)
"""Days since 1900 in spreadsheets and since year 0 in MATLAB, from 1982 on."""
TIME_UNITS: Final[Mapping[str, float]] = {
    **dict.fromkeys(("ns", "nsec", "nanosec", "nanoseconds"), 1e-9),
    **dict.fromkeys(("us", "µs", "μs", "usec", "micros", "microseconds"), 1e-6),
    **dict.fromkeys(("ms", "msec", "msecs", "millis", "milliseconds", "millisekunden"), 1e-3),
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds", "sek", "sekunden"), 1.0),
    **dict.fromkeys(("min", "minutes", "minuten"), 60.0),
    **dict.fromkeys(("h", "hr", "hrs", "hours", "stunden"), 3600.0),
}
"""Seconds per unit of time."""


def time_in_seconds(table: Table, name: str) -> Array:
    """A time column in s from its first row, (rows,); its unit is given by its name, else by its median step.

    Raises:
        RefusedTableError: the times decrease or never increase.
    """
    values = table.clock(name)
    finite = values[np.isfinite(values)]
    steps = np.diff(finite)
    down = int(np.sum(steps < 0.0))
    steps = steps[steps > 0.0]
    if down > 0.5 * (finite.size - 1):
        raise RefusedTableError(
            f"the times in column {name!r} go down in {down} of {finite.size - 1} rows: reversed or unsorted "
            "rows. Sort the rows by time"
        )
    if steps.size == 0:
        raise RefusedTableError(
            f"the times in column {name!r} never increase (all {finite[0]:.6g}): constant channel. "
            "Choose the time column"
        )
    _refuse_change_of_unit(name, steps)
    period = float(np.median(steps))
    named = [unit for unit in TIME_UNITS if table.words(name)[-1:] == [unit]]
    if named:
        factor = TIME_UNITS[named[0]]
    elif period < MAX_STEP_DAYS and SERIAL_DAYS[0] < finite[0] < SERIAL_DAYS[1]:
        factor = 86400.0
        table.notes.append(
            f"times in {name!r} taken as days, as spreadsheets and MATLAB count them"
        )
    elif period < 2.0:
        factor = 1.0
    elif period < 500.0:
        factor = 1e-3
        table.notes.append(f"times in {name!r} taken as milliseconds (median step {period:.4g})")
    elif period < 5e5:
        factor = 1e-6
        table.notes.append(f"times in {name!r} taken as microseconds (median step {period:.4g})")
    else:
        factor = 1e-9
        table.notes.append(f"times in {name!r} taken as nanoseconds (median step {period:.4g})")
    return (values - finite[0]) * factor


def _refuse_change_of_unit(name: str, steps: Array) -> None:
    """Refuse a time column whose steps grow or shrink a thousandfold, as from s to ms.

    Raises:
        RefusedTableError: the unit changes.
    """
    parts = [part for part in np.array_split(steps, UNIT_CHANGE_BLOCKS) if part.size]
    periods = [float(np.median(part)) for part in parts]
    ratio = max(periods) / min(periods)
    power = round(math.log(ratio, 1000.0))
    if power > 0 and abs(ratio / 1000.0**power - 1.0) < UNIT_CHANGE_TOLERANCE_RATIO:
        raise RefusedTableError(
            f"the times in column {name!r} go on in steps of {min(periods):.3g} in one part of the file and "
            f"of {max(periods):.3g} in another: units of time are mixed (s and ms?). Write one unit in all "
            "rows, or one file a recording"
        )


def check_rate(audit: ClockAudit, what: str, min_rate_hz: float = MIN_RATE_HZ) -> None:
    """Refuse records that are sampled too slowly, or impossibly fast.

    Raises:
        RefusedTableError: the rate is below `min_rate_hz` or above 200 kHz.
    """
    if audit.rate_hz < min_rate_hz:
        raise RefusedTableError(
            f"{what} was recorded at {audit.rate_hz:.3g} Hz, at least {min_rate_hz:g} Hz are needed: "
            "effects of a tenth of a second hide between samples. Record faster; or, if the times are in ms, "
            "call their column time_ms"
        )
    if audit.rate_hz > 2e5:
        raise RefusedTableError(
            f"{what} says {audit.rate_hz:.3g} Hz: swapped units of time. Give seconds, or a column name "
            "that ends with _ms, _us or _ns"
        )


def split_runs(time_s: Array) -> IntArray:
    """Number of the run of each row, (rows,): a run begins where time restarts or pauses.

    Raises:
        RefusedTableError: time restarts or pauses too often.
    """
    steps = np.diff(time_s)
    forward = steps[steps > 0.0]
    period = float(np.median(forward)) if forward.size else 1.0
    new = (steps < 0.0) | (steps > max(RUN_GAP_S, RUN_GAP_PERIODS * period))
    runs = np.concatenate([[0], np.cumsum(new)]).astype(np.int64)
    if runs[-1] > len(time_s) / MIN_ROWS:
        raise RefusedTableError(
            f"its clock jumps or pauses {runs[-1]} times in {len(time_s)} rows: unsorted rows or a clock "
            "that was set. Sort by time, or give --group COLUMN to tell runs apart"
        )
    return runs


def clean_series(
    time_s: Array, values: Array, what: str, notes: list[str], min_rows: int = MIN_ROWS
) -> tuple[Array, Array]:
    """Rows with a time and a value, (kept,) each, without repeated times; gaps are left to interpolation.

    Raises:
        RefusedTableError: too many values are missing.
    """
    inside = np.flatnonzero(np.isfinite(values) & np.isfinite(time_s))
    if inside.size < min_rows:
        raise RefusedTableError(
            f"{what} has {inside.size} numbers, at least {min_rows} are needed; the record is too short"
        )
    first, last = int(inside[0]), int(inside[-1])
    ends = first + len(values) - 1 - last
    holes = last - first + 1 - inside.size
    if ends:
        notes.append(f"{what}: {ends} rows without a number at the ends left out")
    is_merged = holes > MAX_MISSING_RATIO * (last - first + 1) and is_evenly_sampled(time_s[inside])
    if is_merged:
        notes.append(
            f"{what}: {holes} of {last - first + 1} rows are blank, the others come evenly: taken as rows of "
            "something else, left out"
        )
    elif holes > MAX_MISSING_RATIO * (last - first + 1):
        raise RefusedTableError(
            f"{what} lacks {holes} of {last - first + 1} numbers (NaN or empty): the sensor dropped out. "
            "Repair it and record again"
        )
    elif holes:
        notes.append(f"{what}: {holes} missing numbers inside interpolated")
    time_s, values = time_s[inside], values[inside]
    is_later = np.concatenate([[True], np.diff(time_s) > 0.0])
    if not np.all(is_later):
        notes.append(f"{what}: {int(np.sum(~is_later))} rows with a repeated time dropped")
    return time_s[is_later], values[is_later]


def estimate_noise(series: Sequence[Array], order: int = 3) -> float:
    """Standard deviation of the white noise of one sample in smooth series, (rows, ...) each; robust.

    Differences of n-th order along the rows remove smooth motion; the standard deviation of white noise grows
    by sqrt(binomial(2n, n)).
    """
    differences = np.concatenate([np.diff(one, n=order, axis=0).ravel() for one in series])
    scatter = float(np.median(np.abs(differences - np.median(differences))))
    return 1.4826 * scatter / math.sqrt(math.comb(2 * order, order))


def is_evenly_sampled(time_s: Array) -> bool:
    """Whether gaps take less than `MAX_MISSING_RATIO` of the time."""
    steps = np.diff(time_s)
    steps = steps[steps > 0.0]
    if steps.size == 0:
        return False
    holes_s = float(np.sum(steps[steps > HOLE_PERIODS * np.median(steps)]))
    return holes_s < MAX_MISSING_RATIO * float(np.sum(steps))


def is_continuous_command(commands: Array) -> bool:
    """Whether a command moves from row to row, rather than in steps that are held."""
    changed = np.diff(commands) != 0.0
    again = float(np.mean(changed[1:][changed[:-1]])) if np.any(changed[:-1]) else 0.0
    return again > CONTINUOUS_RATIO


def audit_times(table: Table, time_s: Array, what: str) -> ClockAudit:
    """Audit the clock of a time column and refuse rates that are too low."""
    audit = audit_clock(time_s[np.isfinite(time_s)])
    check_rate(audit, what)
    if audit.gap_count:
        table.notes.append(
            f"{audit.missing_count} samples missing in {audit.gap_count} gaps, the longest "
            f"{audit.longest_gap_s:.3g} s"
        )
    return audit
