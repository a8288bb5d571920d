"""Reads anybody's CSV: finds the columns, takes times to seconds, splits runs, says what it assumed.

It repairs holes of a few samples; a file that cannot be used is refused with numbers, cause and remedy.
"""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from diagnosis.loading.clock_audit import ClockAudit, audit_clock
from machine.conventions import Array, IntArray
from machine.errors import LogError

MIN_TABLE_RATE_HZ: Final = 12.0
"""Below this a table hides dead times, and friction within a swing; tracked balls come at 15 Hz."""
MIN_ROWS: Final = 20
RUN_GAP_S: Final = 1.0
RUN_GAP_PERIODS: Final = 12.0
"""A pause of this many periods (and of 1 s) begins a new run."""
MAX_MISSING_RATIO: Final = 0.3
NUMBERS_RATIO: Final = 0.5

TIME_UNITS: Final[Mapping[str, float]] = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0, "sec": 1.0}
ANGLE_DEGREES: Final = ("deg", "degrees", "degree")


class RefusedTableError(LogError):
    """A table that cannot be used: the text says why, with numbers, and what to do."""


@dataclass(slots=True)
class Table:
    """Columns of a CSV file as text, and what had to be assumed about it."""

    path: Path
    columns: dict[str, list[str]]
    notes: list[str] = field(default_factory=list[str])

    @property
    def row_count(self) -> int:
        """Rows without the header."""
        return len(next(iter(self.columns.values()), []))

    def numbers(self, name: str) -> Array:
        """A column as numbers, (rows,); empty or unreadable cells are nan.

        Raises:
            RefusedTableError: no such column, or hardly a number in it.
        """
        values = np.array([_number(text) for text in self.columns[self.column(name)]])
        good = float(np.mean(np.isfinite(values))) if len(values) else 0.0
        if good < NUMBERS_RATIO:
            raise RefusedTableError(
                f"column {name!r} of {self.path.name} holds a number in {good:.0%} of its rows; "
                "choose another column"
            )
        return values

    def labels(self, name: str) -> list[str]:
        """A column as text, (rows,)."""
        return self.columns[self.column(name)]

    def column(self, name: str) -> str:
        """The column's own name; case and blanks do not matter.

        Raises:
            RefusedTableError: no such column.
        """
        if name in self.columns:
            return name
        matches = [own for own in self.columns if own.strip().lower() == name.strip().lower()]
        if len(matches) != 1:
            raise RefusedTableError(
                f"{self.path.name} has no column {name!r}; it has {', '.join(self.columns)}"
            )
        return matches[0]

    def guess(self, what: str, option: str, words: Sequence[str]) -> str:
        """The only column whose name begins with or holds one of `words`, noted as a guess.

        Raises:
            RefusedTableError: none or several; the text names the columns and the option to give.
        """
        found = [
            name
            for name in self.columns
            if any(part in words for part in name_words(name)) or name.strip().lower() in words
        ]
        if len(found) != 1:
            seen = "none" if not found else " and ".join(found)
            raise RefusedTableError(
                f"which column of {self.path.name} is the {what}? It has {', '.join(self.columns)} "
                f"({seen} would fit); give {option} COLUMN"
            )
        self.notes.append(f"column {found[0]!r} taken as the {what}")
        return found[0]


def read_table(path: Path) -> Table:
    """Read a CSV file with a header line; comma, semicolon, tab or blank between cells.

    Raises:
        RefusedTableError: missing, empty or without a header.
    """
    try:
        text = path.read_text(encoding="utf-8-sig", errors="replace")
    except OSError as error:
        raise RefusedTableError(f"cannot open {path}: {error.strerror}") from error
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if len(lines) < MIN_ROWS + 1:
        raise RefusedTableError(
            f"{path.name} has {len(lines)} lines, at least {MIN_ROWS + 1} are needed: empty or cut off"
        )
    separator = max(",;\t", key=lines[0].count)
    if lines[0].count(separator) == 0:
        separator = " "
    rows = list(csv.reader(lines, delimiter=separator, skipinitialspace=True))
    header = [name.strip() for name in rows[0]]
    if all(np.isfinite(_number(name)) for name in header):
        raise RefusedTableError(
            f"the first line of {path.name} holds numbers ({', '.join(header[:4])}...); the columns need "
            "names: add a header line"
        )
    if len(set(header)) != len(header):
        raise RefusedTableError(
            f"{path.name} has two columns of the same name: {', '.join(header)}"
        )
    body = [row for row in rows[1:] if len(row) >= len(header) // 2 + 1]
    table = Table(
        path,
        {
            name: [row[index] if index < len(row) else "" for row in body]
            for index, name in enumerate(header)
        },
    )
    if separator == ";" and "," in "".join(lines[1:3]):
        table.notes.append("decimal commas read as points")
    if len(body) < len(rows) - 1:
        table.notes.append(f"{len(rows) - 1 - len(body)} torn lines left out")
    return table


def time_seconds(table: Table, name: str) -> Array:
    """A time column in seconds from its first row, (rows,); the unit is in its name or in its steps.

    Raises:
        RefusedTableError: no unit makes sense of it.
    """
    values = table.numbers(name)
    finite = values[np.isfinite(values)]
    steps = np.diff(finite)
    steps = steps[steps > 0.0]
    if steps.size == 0:
        raise RefusedTableError(
            f"the times in column {name!r} never increase (all {finite[0]:.6g}): constant channel. "
            "Choose the time column"
        )
    period = float(np.median(steps))
    named = [unit for unit in TIME_UNITS if name_words(name)[-1:] == [unit]]
    if named:
        factor = TIME_UNITS[named[0]]
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


def check_rate(audit: ClockAudit, what: str, min_rate_hz: float = MIN_TABLE_RATE_HZ) -> None:
    """Refuse records that are too slow.

    Raises:
        RefusedTableError: below `min_rate_hz`.
    """
    if audit.rate_hz < min_rate_hz:
        raise RefusedTableError(
            f"{what} was recorded at {audit.rate_hz:.3g} Hz, at least {min_rate_hz:g} Hz are needed: "
            "effects of a tenth of a second hide between samples. Record faster"
        )
    if audit.rate_hz > 2e5:
        raise RefusedTableError(
            f"{what} says {audit.rate_hz:.3g} Hz: swapped units of time. Give seconds, or a column name "
            "that ends with _ms, _us or _ns"
        )


def split_runs(time_s: Array) -> IntArray:
    """Number of the run of each row, (rows,): a new one where time starts again or pauses.

    Raises:
        RefusedTableError: the clock jumps back again and again.
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
    """Rows with a time and a number, (kept,), duplicates dropped; holes are left to interpolation.

    Raises:
        RefusedTableError: too much is missing, or time goes back.
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
    if holes > MAX_MISSING_RATIO * (last - first + 1):
        raise RefusedTableError(
            f"{what} lacks {holes} of {last - first + 1} numbers (NaN or empty): the sensor dropped out. "
            "Repair it and record again"
        )
    if holes:
        notes.append(f"{what}: {holes} missing numbers inside interpolated")
    time_s, values = time_s[inside], values[inside]
    fresh = np.concatenate([[True], np.diff(time_s) > 0.0])
    if not np.all(fresh):
        notes.append(f"{what}: {int(np.sum(~fresh))} rows with a repeated time dropped")
    return time_s[fresh], values[fresh]


def audit_times(table: Table, time_s: Array, what: str) -> ClockAudit:
    """Audit a time column's rows that have a time, and refuse what is too slow."""
    audit = audit_clock(time_s[np.isfinite(time_s)])
    check_rate(audit, what)
    if audit.gap_count:
        table.notes.append(
            f"{audit.missing_count} samples missing in {audit.gap_count} gaps, the longest "
            f"{audit.longest_gap_s:.3g} s"
        )
    return audit


def has_degrees(name: str) -> bool | None:
    """Whether a column's name says degrees; None when it says nothing about its unit."""
    words = name_words(name)
    if any(word in ANGLE_DEGREES for word in words):
        return True
    return False if any(word in ("rad", "radians", "radian") for word in words) else None


def name_words(name: str) -> list[str]:
    """Lower-case words of a column name: ``Boom pos [deg]`` is boom, pos, deg."""
    text = "".join(c.lower() if c.isalnum() else " " for c in name)
    return text.split()


def _number(text: str) -> float:
    cleaned = text.strip().replace(",", ".")
    try:
        return float(cleaned)
    except ValueError:
        return float("nan")
