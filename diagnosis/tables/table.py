"""Columns of a table: exact numbers, times, labels, words of their names, and the notes about them."""

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import pandas as pd

from diagnosis.tables.cells import (
    MAX_MAGNITUDE,
    POINT,
    SWITCH_CELLS,
    Decimal,
    NumberForm,
    RefusedTableError,
    are_blank,
    clean_cells,
    find_form,
    find_units,
    parse_cells,
    parse_times_s,
    settle_form,
    split_unit,
)
from diagnosis.tables.layouts import read_raw_table
from diagnosis.tables.repairs import find_stand_ins, restore_sign
from diagnosis.tables.topics import TopicField, is_recording, read_topics
from machine.conventions import Array, BoolArray

MIN_NUMBERS_RATIO: Final = 0.5
"""Smallest share of numeric cells, of those that are not blank, in a numeric column."""
ANGLES_RAD: Final[Mapping[str, float]] = {
    **dict.fromkeys(("rad", "radian", "radians"), 1.0),
    **dict.fromkeys(("deg", "degs", "degrees", "degree", "grad"), math.pi / 180.0),
    **dict.fromkeys(("mrad", "milliradian", "milliradians"), 1e-3),
    **dict.fromkeys(("gon", "gradian", "gradians"), math.pi / 200.0),
    **dict.fromkeys(("arcmin", "arcminutes"), math.pi / 10800.0),
    "rpm": math.pi / 30.0,
    **dict.fromkeys(("rev", "revs", "revolutions", "turns"), 2.0 * math.pi),
}
"""Radians per unit of angle, or rad/s per rpm; ``grad`` is a degree, as in German tables."""
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
    columns: pd.DataFrame
    """Cells as text by column name; the index holds the line of each row in the file."""
    notes: list[str] = field(default_factory=list[str])
    """Assumptions and repairs, for the user."""
    units: dict[str, str] = field(default_factory=dict[str, str])
    """By column name, from a row of units or the cells."""
    derived: dict[str, Array] = field(default_factory=dict[str, Array])
    """Columns computed from others, by name, (rows,) each."""
    options: ReadOptions = DEFAULT_OPTIONS
    _cells: dict[str, pd.Series] = field(default_factory=dict[str, pd.Series])
    _plain: dict[str, Array | None] = field(default_factory=dict[str, Array | None])
    _parsed: dict[str, Parsed] = field(default_factory=dict[str, Parsed])
    _form: list[NumberForm | None] = field(default_factory=list[NumberForm | None])

    @property
    def row_count(self) -> int:
        """Rows without the header."""
        return len(self.columns)

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

    def cells(self, name: str) -> pd.Series:
        """A column's cells without the unit behind each number; those without a value are empty."""
        if name not in self._cells and self._plain_numbers(name) is not None:
            self._cells[name] = self.columns[name]
        if name not in self._cells:
            cells, unit = split_unit(clean_cells(self.columns[name]))
            if unit:
                self.units.setdefault(name, unit.lower())
                self.note(f"{name!r}: unit {unit!r} taken from the cells")
            nothing = are_blank(cells) | cells.isin(self.options.missing).to_numpy()
            self._cells[name] = cells.mask(nothing, "")
        return self._cells[name]

    def _plain_numbers(self, name: str) -> Array | None:
        """A column of which each cell is a number with a point or without sign, (rows,); else None."""
        if name not in self._plain:
            values = pd.to_numeric(self.columns[name], errors="coerce")
            values = values.to_numpy(np.float64, copy=True)
            self._plain[name] = values if np.all(np.isfinite(values)) else None
        return self._plain[name]

    def _read_numbers(self, name: str) -> Parsed:
        """Parse a column; numbers are restored and stand-ins left out by rule."""
        cells = self.cells(name)
        form = self._form_of(name, cells)
        plain = self._plain_numbers(name)
        if plain is not None and form == POINT:
            return self._leave_out_stand_ins(name, plain.copy(), [])
        is_filled = (cells != "").to_numpy()
        lower = cells.str.lower()
        notes: list[str] = []
        if np.any(is_filled) and lower[is_filled].isin(SWITCH_CELLS.keys()).all():
            cells = lower.map(SWITCH_CELLS).fillna("")
            notes.append(f"{name!r}: states of a switch read as 1 and 0")
        values = parse_cells(cells, form)
        is_text = is_filled & np.isnan(values)
        if np.any(is_text):
            raise RefusedTableError(self._describe_text(name, is_text, form))
        if form != POINT and _has_sign(cells):
            notes.append(f"{name!r}: {form.describe()}")
        if self.columns[name].str.contains("[\u2212\u2013\ufe63\uff0d]\\d").any():
            notes.append(f"{name!r}: typographic minus signs read as minus")
        return self._leave_out_stand_ins(name, values, notes)

    def _leave_out_stand_ins(self, name: str, values: Array, notes: list[str]) -> Parsed:
        values[~(np.abs(values) < MAX_MAGNITUDE)] = np.nan
        if np.all(np.isnan(values)):
            raise RefusedTableError(
                f"column {name!r} of {self.path.name} holds a number in 0% of its rows; choose another column"
            )
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

    def _describe_text(self, name: str, is_text: BoolArray, form: NumberForm) -> str:
        """Where a column of numbers holds text, for a refusal."""
        first = int(np.argmax(is_text))
        text = self.columns[name].iloc[first]
        place = f"row {self.columns.index[first]} of {self.path.name}, column {name!r}"
        share = float(np.mean(is_text[(self.cells(name) != "").to_numpy()]))
        if len(units := find_units(self.cells(name))) > 1:
            return (
                f"{place}: {text!r} is no number: the units {' and '.join(units)} are mixed. Write one unit "
                "in all rows"
            )
        if share > MIN_NUMBERS_RATIO:
            return (
                f"{place}: {text!r} is no number; the column holds a number in {1.0 - share:.0%} of its "
                "rows; choose another column"
            )
        more = int(np.sum(is_text)) - 1
        below = f", nor are {more} more cells below" if more else ""
        return (
            f"{place}: {text!r} is no number ({form.describe()}){below}. Correct them; if "
            f"they stand for no value, give --missing {text.strip()!r}"
        )

    def _form_of(self, name: str, cells: pd.Series) -> NumberForm:
        given = {"point": NumberForm(".", ","), "comma": NumberForm(",", ".")}
        if self.options.decimal != "auto":
            return given[self.options.decimal]
        return find_form(cells) or settle_form(cells, self._usual_form(), name)

    def _usual_form(self) -> NumberForm | None:
        """The form of the columns that show one, if it is the same for all."""
        if not self._form:
            shown = [
                form.decimal
                for name in self.columns
                if _has_sign(cells := self.cells(name))
                and (form := find_form(cells)) is not None
                and np.mean(np.isnan(parse_cells(cells, form))) < MIN_NUMBERS_RATIO
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
        cells = self.cells(self.column(name))
        values = parse_times_s(cells)
        good = np.isfinite(values)
        filled = (cells != "").to_numpy()
        if np.sum(good) < MIN_NUMBERS_RATIO * max(np.sum(filled), 1.0):
            return self.numbers(name)
        if np.any(filled & ~good):
            first = int(np.argmax(filled & ~good))
            raise RefusedTableError(
                f"row {self.columns.index[first]} of {self.path.name}, column {name!r}: "
                f"{cells.iloc[first]!r} is no date or time of day"
            )
        self.note(f"{name!r} read as dates or times of day")
        return values - values[good][0]

    def add_times(self, day: str, clock: str) -> str | None:
        """Name of a new column of times from one of days and one of times of day; None without such."""
        days, clocks = self.cells(day), self.cells(clock)
        is_pair = days.str.fullmatch(r"\d{1,4}[./-]\w{1,3}[./-]\d{2,4}").all()
        if not is_pair or not clocks.str.fullmatch(r"\d+:\d+:.*").all():
            return None
        name = f"{day} and {clock}, s"
        values = parse_times_s(days + " " + clocks)
        self.derived[name] = values - values[0]
        self.note(f"{day!r} and {clock!r} taken together as the time")
        return name

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
            values = parse_cells(self.cells(name), find_form(self.cells(name)) or POINT)
        good = np.isfinite(values)
        filled = 0 if name in self.derived else int((self.cells(name) != "").sum())
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
        for name in self.columns:
            some = self.columns[name].iloc[:: max(1, self.row_count // 5000)].drop_duplicates()
            some = clean_cells(some)
            some = some[~are_blank(some)]
            texts = int(np.isnan(parse_cells(some, find_form(some) or POINT)).sum())
            if 1 < len(some) <= MAX_LABELS_COUNT and texts > (1 - MIN_NUMBERS_RATIO) * len(some):
                found.append(name)
        return found

    def labels(self, name: str) -> list[str]:
        """A column as text, (rows,)."""
        return self.columns[self.column(name)].tolist()

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
        cells = pd.DataFrame(found.cells, dtype=str)
        return Table(path, cells, found.notes, found.units, options=options)
    if options.topics:
        raise RefusedTableError(
            f"{path.name} holds no recorded messages: --topic and --field are for ROS bags and MCAP files"
        )
    raw = read_raw_table(path)
    return Table(path, raw.cells, raw.notes, raw.units, options=options)


def _has_sign(cells: pd.Series) -> bool:
    return bool(cells.str.contains("[.,]").any())


def radians_per_unit(words: Sequence[str]) -> float | None:
    """Radians per unit of angle that a column's words name; None if they name none."""
    return next((ANGLES_RAD[word] for word in reversed(words) if word in ANGLES_RAD), None)


def split_name(name: str) -> list[str]:
    """Lower-case words of a column name: ``Boom pos [deg]`` and ``BoomPos_deg`` give boom, pos, deg."""
    text = re.sub(
        r"([a-z]{2,})([A-Z])", r"\1 \2", re.sub("[°º˚]", " deg ", name).replace("%", " pct ")
    )
    return "".join(c.lower() if c.isalnum() else " " for c in text).split()
