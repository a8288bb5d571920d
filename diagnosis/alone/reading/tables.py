"""A table of anybody's: its columns by name, as numbers or as labels, and what had to be assumed about it.

A column that is not there, or holds hardly a number, is refused with what there is instead.
"""

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import numpy as np

from diagnosis.alone.reading.layout import RefusedTableError, number, read_layout
from machine.conventions import Array

NUMBERS_RATIO: Final = 0.5
BLANKS: Final = frozenset(["", "nan", "na", "n/a", "null", "none"])
"""Cells of a row that tells nothing of a column."""
ANGLE_DEGREES: Final = ("deg", "degs", "degrees", "degree", "grad")
"""``grad`` as German tables have it; gradians are not measured in."""
LARGEST: Final = 1e20
"""No measurement is larger in any unit; nanoseconds since 1970 come near 2e18."""
FEW_LABELS_COUNT: Final = 60
"""A column with more different texts does not tell runs apart."""


@dataclass(slots=True)
class Table:
    """Columns of a CSV file as text, and what had to be assumed about it."""

    path: Path
    columns: dict[str, list[str]]
    notes: list[str] = field(default_factory=list[str])
    units: dict[str, str] = field(default_factory=dict[str, str])
    """From a row of units below the header."""
    derived: dict[str, Array] = field(default_factory=dict[str, Array])
    """Columns that were made of others, (rows,) each."""

    @property
    def row_count(self) -> int:
        """Rows without the header."""
        return len(next(iter(self.columns.values()), []))

    def numbers(self, name: str) -> Array:
        """A column as numbers, (rows,); empty or unreadable cells are nan.

        Raises:
            RefusedTableError: no such column, or hardly a number in the cells that are not blank.
        """
        if name in self.derived:
            return self.derived[name].copy()
        cells = self.columns[self.column(name)]
        try:
            values = np.array(cells, dtype=np.float64)
        except ValueError:
            values = np.array([number(text) for text in cells])
        values[~(np.abs(values) < LARGEST)] = np.nan
        good = np.isfinite(values)
        if (share := float(np.mean(good)) if len(values) else 0.0) < NUMBERS_RATIO:
            # Topics merged into one table leave each other's cells blank: those speak against no column.
            filled = np.array([text.strip().lower() not in BLANKS for text in cells])
            if not np.any(good) or np.sum(good) < NUMBERS_RATIO * np.sum(filled):
                raise RefusedTableError(
                    f"column {name!r} of {self.path.name} holds a number in {share:.0%} of its rows; "
                    "choose another column"
                )
        return values

    def clock(self, name: str) -> Array:
        """A column of times, (rows,): numbers, or dates and times of day in s from the first."""
        try:
            return self.numbers(name)
        except RefusedTableError:
            values = np.array([_time_of_day_s(text) for text in self.columns[self.column(name)]])
            if np.mean(np.isfinite(values)) < NUMBERS_RATIO:
                raise
            self.notes.append(f"{name!r} read as dates or times of day")
            return values - values[np.isfinite(values)][0]

    def is_numeric(self, name: str) -> bool:
        """Whether a column holds numbers that change."""
        try:
            values = self.numbers(name)
        except RefusedTableError:
            return False
        return bool(np.nanmax(values) > np.nanmin(values))

    def words(self, name: str) -> list[str]:
        """Words of a column's name, its unit from a row of units last."""
        if name in self.derived:
            return name_words(name)
        unit = self.units.get(self.column(name), "")
        return name_words(name) + name_words(unit)

    def text_columns(self) -> list[str]:
        """Columns of labels: hardly a number in them, few different texts, at least two."""
        found: list[str] = []
        for name, cells in self.columns.items():
            some = set(cells[:: max(1, len(cells) // 5000)]) - {""}
            numbers = sum(bool(np.isfinite(number(text))) for text in some)
            if 1 < len(some) <= FEW_LABELS_COUNT and numbers < NUMBERS_RATIO * len(some):
                found.append(name)
        return found

    def labels(self, name: str) -> list[str]:
        """A column as text, (rows,)."""
        return self.columns[self.column(name)]

    def column(self, name: str) -> str:
        """The column's own name; case and blanks do not matter.

        Raises:
            RefusedTableError: no such column.
        """
        if name in self.columns or name in self.derived:
            return name
        matches = [own for own in self.columns if own.strip().lower() == name.strip().lower()]
        if len(matches) != 1:
            raise RefusedTableError(
                f"{self.path.name} has no column {name!r}; it has {', '.join(self.columns)}"
            )
        return matches[0]

    def guess(
        self, what: str, option: str, words: Sequence[str], without: Collection[str] = ()
    ) -> str:
        """The only column whose name holds one of `words`, noted as a guess.

        Args:
            what: that is looked for, for the text.
            option: that gives the column.
            words: of which one is in its name.
            without: columns that are something else.

        Raises:
            RefusedTableError: none or several; the text names the columns and the option to give.
        """
        found = [
            name
            for name in self.columns
            if name not in without
            and (any(part in words for part in name_words(name)) or name.strip().lower() in words)
        ]
        if len(found) > 1:
            found = [name for name in found if self.is_numeric(name)] or found
        exact = [name for name in found if name.strip().lower() in words]
        found = exact if len(exact) == 1 else found
        if len(found) != 1:
            seen = "none" if not found else " and ".join(found)
            raise RefusedTableError(
                f"which column of {self.path.name} is the {what}? It has {', '.join(self.columns)} "
                f"({seen} would fit); give {option} COLUMN"
            )
        self.notes.append(f"column {found[0]!r} taken as the {what}")
        return found[0]


def read_table(path: Path) -> Table:
    """Read a CSV file with a header line; comma, semicolon, tab or blanks between cells.

    Raises:
        RefusedTableError: missing, empty or without a header.
    """
    header, rows, units, notes = read_layout(path)
    width = len(header)
    if not all(len(row) == width for row in rows):
        rows = [(row + [""] * width)[:width] for row in rows]
    columns = dict(zip(header, (list(cells) for cells in zip(*rows, strict=True)), strict=True))
    return Table(path, columns, notes, units)


def has_degrees(words: Sequence[str]) -> bool | None:
    """Whether a column's words say degrees; None when they say nothing about its unit."""
    if any(word in ANGLE_DEGREES for word in words):
        return True
    return False if any(word in ("rad", "radians", "radian") for word in words) else None


def name_words(name: str) -> list[str]:
    """Lower-case words of a column name: ``Boom pos [deg]`` and ``BoomPos_deg`` are boom, pos, deg."""
    text = re.sub(r"([a-z]{2,})([A-Z])", r"\1 \2", name.replace("°", " deg ").replace("%", " pct "))
    return "".join(c.lower() if c.isalnum() else " " for c in text).split()


_CLOCK = re.compile(r"(?:(\d+):)?(\d+):(\d+(?:[.,]\d+)?)\s*([AaPp][Mm])?")
_DAY = re.compile(r"^\D*(\d{1,2})[./](\d{1,2})[./](\d{4})")


def _time_of_day_s(text: str) -> float:
    """Seconds of a date and time, or of a time of day; nan if it is none."""
    try:
        # Differences alone are used: a time without a zone may be taken as UTC.
        stamp = datetime.fromisoformat(text.strip())
        return stamp.replace(tzinfo=stamp.tzinfo or UTC).timestamp()
    except ValueError:
        pass
    found = _CLOCK.search(text)
    if found is None:
        return float("nan")
    hours, minutes, seconds, half = found.groups()
    hour = int(hours or 0) % 12 + 12 * (half.lower() == "pm") if half else int(hours or 0)
    day = _DAY.match(text)
    # Which of the two numbers is the month does not matter within one record.
    days = 0 if day is None else int(day.group(1)) + int(day.group(2))
    return 86400.0 * days + 3600.0 * hour + 60.0 * int(minutes) + float(seconds.replace(",", "."))
