"""Columns of a table: exact numbers, times, labels, words of their names, and the notes about them."""

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from diagnosis.tables.cells import (
    MAX_MAGNITUDE,
    POINT,
    Decimal,
    NumberForm,
    RefusedTableError,
    find_form,
    has_other_minus,
    is_blank,
    is_number,
    parse_cells,
    parse_times_s,
    settle_form,
)
from diagnosis.tables.layouts import read_raw_table
from diagnosis.tables.repairs import find_stand_ins, restore_sign
from diagnosis.tables.topics import TopicField, is_recording, read_topics
from machine.conventions import Array

MIN_NUMBERS_RATIO: Final = 0.5
"""Smallest share of numeric cells, of those that are not blank, in a numeric column."""
DEGREE_WORDS: Final = ("deg", "degs", "degrees", "degree", "grad")
"""Words that mean degrees; ``grad`` as in German tables, gradians do not occur."""
MAX_LABELS_COUNT: Final = 60
"""Most distinct texts in a column of labels."""


class ReadOptions(NamedTuple):
    """What the user says about the cells."""

    decimal: Decimal = "auto"
    missing: tuple[str, ...] = ()
    """Cells that hold no value."""
    topics: tuple[TopicField, ...] = ()
    """Columns of recorded messages."""


DEFAULT_OPTIONS: Final = ReadOptions()


class Parsed(NamedTuple):
    """A column as numbers."""

    values: Array
    """(rows,) nan where a cell is blank or holds a stand-in for no value."""
    notes: tuple[str, ...]
    refusal: str
    """Why the column cannot be used as numbers; empty if it can."""


@dataclass(slots=True)
class Table:
    """Columns of a file as text, with the assumptions made about it."""

    path: Path
    columns: dict[str, list[str]]
    notes: list[str] = field(default_factory=list[str])
    """Assumptions and repairs, for the user."""
    units: dict[str, str] = field(default_factory=dict[str, str])
    """By column name, from a row of units."""
    derived: dict[str, Array] = field(default_factory=dict[str, Array])
    """Columns computed from others, by name, (rows,) each."""
    options: ReadOptions = DEFAULT_OPTIONS
    line_numbers: Sequence[int] = ()
    """Line of the file of each row."""
    _parsed: dict[str, Parsed] = field(default_factory=dict[str, Parsed])
    _form: list[NumberForm | None] = field(default_factory=list[NumberForm | None])

    @property
    def row_count(self) -> int:
        """Rows without the header."""
        return len(next(iter(self.columns.values()), []))

    def numbers(self, name: str) -> Array:
        """A column as numbers, (rows,); nan where a cell is blank or holds a stand-in for no value.

        Raises:
            RefusedTableError: there is no such column, or a cell holds text.
        """
        if name in self.derived:
            return self.derived[name].copy()
        parsed = self._parse(self.column(name))
        if parsed.refusal:
            raise RefusedTableError(parsed.refusal)
        self.note(*parsed.notes)
        return parsed.values.copy()

    def note(self, *notes: str) -> None:
        """Add notes that are not there yet."""
        self.notes += [note for note in notes if note not in self.notes]

    def _parse(self, name: str) -> Parsed:
        if name not in self._parsed:
            try:
                self._parsed[name] = self._read_numbers(name)
            except RefusedTableError as error:
                nothing = np.full(self.row_count, np.nan)
                self._parsed[name] = Parsed(nothing, (), str(error))
        return self._parsed[name]

    def _read_numbers(self, name: str) -> Parsed:
        """Parse a column; numbers are restored and stand-ins left out by rule."""
        cells = self.columns[name]
        if self.options.missing:
            cells = ["" if text in self.options.missing else text for text in cells]
        form = self._form_of(name, cells)
        values = parse_cells(cells, form)
        filled = np.array([not is_blank(text) for text in cells])
        is_text = filled & np.isnan(values)
        values[~(np.abs(values) < MAX_MAGNITUDE)] = np.nan
        if not np.any(np.isfinite(values)) or np.sum(is_text) > MIN_NUMBERS_RATIO * np.sum(filled):
            raise RefusedTableError(
                f"column {name!r} of {self.path.name} holds a number in "
                f"{np.mean(np.isfinite(values)):.0%} of its rows; choose another column"
            )
        if np.any(is_text):
            first = int(np.argmax(is_text))
            row = self.line_numbers[first] if self.line_numbers else first + 2
            raise RefusedTableError(
                f"row {row} of {self.path.name}, column {name!r}: {cells[first]!r} is no number "
                f"({form.describe()}), nor {int(np.sum(is_text)) - 1} more cells below. Correct them; "
                f"if they stand for no value, give --missing {cells[first].strip()}"
            )
        notes = [f"{name!r}: {form.describe()}"] if form != POINT and _has_sign(cells) else []
        if any(has_other_minus(text) for text in cells):
            notes.append(f"{name!r}: typographic minus signs read as minus")
        stand_in, which = find_stand_ins(values)
        if which:
            words = " and ".join(f"{value:g}" for value in which)
            notes.append(
                f"{name!r}: {int(np.sum(stand_in))} rows hold {words}, far from all other values: no value"
            )
            values[stand_in] = np.nan
        if (signed := restore_sign(values)) is not None:
            values, bits = signed
            notes.append(
                f"{name!r}: a signed integer of {bits} bits logged as unsigned, sign restored"
            )
        return Parsed(values, tuple(notes), "")

    def _form_of(self, name: str, cells: Sequence[str]) -> NumberForm:
        given = {"point": NumberForm(".", ","), "comma": NumberForm(",", ".")}
        if self.options.decimal != "auto":
            return given[self.options.decimal]
        return find_form(cells) or settle_form(cells, self._usual_form(), name)

    def _usual_form(self) -> NumberForm | None:
        """The form of the columns that show one, if it is the same for all."""
        if not self._form:
            shown = [
                form.decimal
                for cells in self.columns.values()
                if sum(is_number(text) for text in cells) > MIN_NUMBERS_RATIO * len(cells)
                and _has_sign(cells)
                and (form := find_form(cells)) is not None
            ]
            self._form.append(NumberForm(shown[0]) if len(set(shown)) == 1 else None)
        return self._form[0]

    def clock(self, name: str) -> Array:
        """A column of times, (rows,): numbers, or dates and times of day in s from the first one.

        Raises:
            RefusedTableError: a cell is neither.
        """
        if name in self.derived or not self._parse(self.column(name)).refusal:
            return self.numbers(name)
        cells = self.columns[self.column(name)]
        values = parse_times_s(cells)
        good = np.isfinite(values)
        filled = np.array([not is_blank(text) for text in cells])
        if np.sum(good) < MIN_NUMBERS_RATIO * max(np.sum(filled), 1.0):
            return self.numbers(name)
        if np.any(filled & ~good):
            first = int(np.argmax(filled & ~good))
            row = self.line_numbers[first] if self.line_numbers else first + 2
            raise RefusedTableError(
                f"row {row} of {self.path.name}, column {name!r}: {cells[first]!r} is no date or time of day"
            )
        self.note(f"{name!r} read as dates or times of day")
        return values - values[good][0]

    def values_if_numeric(self, name: str) -> Array | None:
        """A column as numbers without notes, (rows,); None if it cannot be used as numbers."""
        if name in self.derived:
            return self.derived[name]
        parsed = self._parse(name)
        return None if parsed.refusal else parsed.values

    def is_numeric(self, name: str) -> bool:
        """Whether a column holds mostly numbers that vary; cells that are none do not matter."""
        values = self.values_if_numeric(name)
        if values is None:
            values = parse_cells(self.columns[name], find_form(self.columns[name]) or POINT)
        good = np.isfinite(values)
        filled = sum(not is_blank(text) for text in self.columns.get(name, []))
        return bool(np.sum(good) > MIN_NUMBERS_RATIO * filled) and bool(np.ptp(values[good]) > 0.0)

    def words(self, name: str) -> list[str]:
        """Lower-case words of a column's name and of its unit, the unit last."""
        if name in self.derived:
            return split_name(name)
        unit = self.units.get(self.column(name), "")
        return split_name(name) + split_name(unit)

    def text_columns(self) -> list[str]:
        """Names of label columns: mostly not numeric, 2 to `MAX_LABELS_COUNT` distinct texts."""
        found: list[str] = []
        for name, cells in self.columns.items():
            some = set(cells[:: max(1, len(cells) // 5000)]) - {""}
            numbers = sum(is_number(text) or is_blank(text) for text in some)
            if 1 < len(some) <= MAX_LABELS_COUNT and numbers < MIN_NUMBERS_RATIO * len(some):
                found.append(name)
        return found

    def labels(self, name: str) -> list[str]:
        """A column as text, (rows,)."""
        return self.columns[self.column(name)]

    def column(self, name: str) -> str:
        """The exact name of a column; case and surrounding blanks are ignored.

        Raises:
            RefusedTableError: there is no such column, or there are several of that name.
        """
        if f"{name} (2)" in self.columns:
            raise RefusedTableError(
                f"{self.path.name} has several columns called {name!r}: rename them in the file"
            )
        if name in self.columns or name in self.derived:
            return name
        matches = [own for own in self.columns if own.strip().lower() == name.strip().lower()]
        if len(matches) != 1:
            seen = ", ".join(repr(own) if "," in own else own for own in self.columns)
            raise RefusedTableError(f"{self.path.name} has no column {name!r}; it has {seen}")
        return matches[0]

    def guess(
        self, what: str, option: str, words: Sequence[str], without: Collection[str] = ()
    ) -> str:
        """The only column whose name contains one of `words`; the guess is noted.

        Args:
            what: quantity that is searched, for the message.
            option: command-line option that names the column, for the message.
            words: candidate words.
            without: columns that are already in use.

        Raises:
            RefusedTableError: no column fits, or several do; the message names them and the option.
        """
        found = [
            name
            for name in self.columns
            if name not in without
            and (any(part in words for part in split_name(name)) or name.strip().lower() in words)
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


def read_table(path: Path, options: ReadOptions = DEFAULT_OPTIONS) -> Table:
    """Read a delimited text file with a header line, or fields of recorded messages.

    Raises:
        RefusedTableError: see `read_raw_table` and `read_topics`.
    """
    if is_recording(path):
        found = read_topics(path, options.topics)
        return Table(path, found.cells, found.notes, found.units, options=options)
    if options.topics:
        raise RefusedTableError(
            f"{path.name} holds no recorded messages: --topic and --field are for ROS bags and MCAP files"
        )
    header, rows, units, notes, numbers = read_raw_table(path)
    columns = dict(zip(header, (list(cells) for cells in zip(*rows, strict=True)), strict=True))
    return Table(path, columns, notes, units, options=options, line_numbers=numbers)


def _has_sign(cells: Sequence[str]) -> bool:
    return any("," in text or "." in text for text in cells)


def says_degrees(words: Sequence[str]) -> bool | None:
    """Whether a column's words mean degrees (True) or radians (False); None if they name neither."""
    if any(word in DEGREE_WORDS for word in words):
        return True
    return False if any(word in ("rad", "radians", "radian") for word in words) else None


def split_name(name: str) -> list[str]:
    """Lower-case words of a column name: ``Boom pos [deg]`` and ``BoomPos_deg`` give boom, pos, deg."""
    text = re.sub(r"([a-z]{2,})([A-Z])", r"\1 \2", name.replace("°", " deg ").replace("%", " pct "))
    return "".join(c.lower() if c.isalnum() else " " for c in text).split()
