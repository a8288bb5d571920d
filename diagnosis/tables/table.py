"""Read a delimited text file into a table: encoding, separator, header, units, columns.

Understood are lines above the header, a header behind ``#``, a row of units below the header, and decimal
commas. A file without column names is refused.
"""

import csv
import re
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from machine.conventions import Array
from machine.errors import LogError

MIN_ROWS: Final = 20
"""Fewest rows of a usable table, and of a run."""
SEPARATOR_LINES: Final = 400
"""Lines, half from each end of the file, from which the separator is found."""
MAX_HEADER_LINES: Final = 60
"""Lines among which the first row of numbers is searched."""
MAX_BYTES: Final = 1_500_000_000
"""Largest file, bytes; reading takes about four times as much memory."""
ARCHIVE_MARK: Final = b"PK\x03\x04"
"""First bytes of a zip archive, such as a spreadsheet file."""
SNIFFED_BYTES: Final = 4096
"""Bytes from the start of a file that decide whether it is text."""
BINARY_RATIO: Final = 0.1
"""Share of control characters in those bytes above which a file is not text."""
NO_NUMBERS: Final = ("nan", "inf", "-inf", "na", "n/a", "null", "none")
"""Cells that stand for a number in a row of numbers."""
_TIMES: Final = ("s", "sec", "ms", "us", "ns", "min")
_LENGTHS: Final = ("m", "cm", "mm", "ft", "yd", "in", "px", "m/s", "cm/s", "mm/s", "ft/s")
_ANGLES: Final = ("rad", "deg", "°", "rad/s", "deg/s", "°/s")
UNITS: Final = frozenset({*_TIMES, *_LENGTHS, *_ANGLES, "%", "pct", "v", "-", "1"})
"""Cells that a row of units may hold."""
MIN_NUMBERS_RATIO: Final = 0.5
"""Smallest share of numeric cells in a numeric column."""
BLANK_CELLS: Final = frozenset(["", "nan", "na", "n/a", "null", "none"])
"""Cells that hold no value."""
DEGREE_WORDS: Final = ("deg", "degs", "degrees", "degree", "grad")
"""Words that mean degrees; ``grad`` as in German tables, gradians do not occur."""
MAX_MAGNITUDE: Final = 1e20
"""Larger numbers are read as nan; nanoseconds since 1970 are near 2e18."""
MAX_LABELS_COUNT: Final = 60
"""Most distinct texts in a column of labels."""


class RefusedTableError(LogError):
    """A table that cannot be used; the message gives the reason with numbers and the remedy."""


class RawTable(NamedTuple):
    """A table as text."""

    header: list[str]
    rows: list[list[str]]
    units: dict[str, str]
    """By column name, from a row of units below the header."""
    notes: list[str]
    """Assumptions made while reading, for the user."""


def read_raw_table(path: Path) -> RawTable:
    """Read a delimited text file; the separator is comma, semicolon, bar, tab or blank.

    Raises:
        RefusedTableError: the file is missing, too large, not text, too short, or has no column names.
    """
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise RefusedTableError(
                f"{path.name} has {size / 1e9:.1f} GB, at most {MAX_BYTES / 1e9:g} GB are read: "
                "give the part with the motion, or every tenth row"
            )
        text = path.read_text(encoding=_find_encoding(path), errors="replace")
    except OSError as error:
        raise RefusedTableError(f"cannot open {path}: {error.strerror}") from error
    lines = [line for line in text.replace("\x00", "").splitlines() if line.strip()]
    data = [line for line in lines if not line.lstrip().startswith("#")]
    if len(data) < MIN_ROWS:
        raise RefusedTableError(
            f"{path.name} has {len(data)} lines, at least {MIN_ROWS} are needed: empty or cut off"
        )
    separator = _find_separator(data)
    is_comma_decimal = separator == ";" and any("," in line for line in data[1:20])
    begin = _find_first_row(data, separator)
    header, units, notes = _read_header(path, lines, data, begin, separator)
    body = _split_lines(data[begin:], separator)
    whole = [row for row in body if len(row) >= len(header) // 2 + 1]
    if len(whole) < len(body):
        notes.append(f"{len(body) - len(whole)} torn lines left out")
    if is_comma_decimal:
        notes.append("decimal commas read as points")
    return RawTable(header, whole, units, notes)


def _find_encoding(path: Path) -> str:
    """Encoding of a file: UTF-16 by its byte order mark, else UTF-8.

    Raises:
        RefusedTableError: the file is an archive or binary.
    """
    with path.open("rb") as file:
        start = file.read(SNIFFED_BYTES)
    if start[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return "utf-16"
    if start.startswith(ARCHIVE_MARK):
        raise RefusedTableError(
            f"{path.name} is an archive or a spreadsheet (.xlsx), not text: export the sheet as CSV"
        )
    control = sum(byte < 0x20 and byte not in b"\t\n\r\x00" for byte in start)
    if control > BINARY_RATIO * len(start):
        raise RefusedTableError(
            f"{path.name} is not text ({control} of its first {len(start)} bytes are control characters): "
            "export the record as CSV"
        )
    return "utf-8-sig"


def _find_separator(lines: Sequence[str]) -> str:
    """The separator that most lines have equally often.

    A decimal comma does not occur equally often, so it is not taken for a separator.
    """
    part = [*lines[: SEPARATOR_LINES // 2], *lines[-SEPARATOR_LINES // 2 :]]
    best, most = " ", 0
    for separator in ";\t|,":
        counts = Counter(line.count(separator) for line in part)
        count, lines_count = counts.most_common(1)[0]
        if count > 0 and lines_count > max(most, 0.5 * len(part)):
            best, most = separator, lines_count
    return best


def _split_lines(lines: Sequence[str], separator: str) -> list[list[str]]:
    try:
        return list(csv.reader(lines, delimiter=separator, skipinitialspace=True))
    except csv.Error:  # a quotation mark that is never closed
        return [line.split(separator) for line in lines]


def _find_first_row(lines: Sequence[str], separator: str) -> int:
    """Index of the first row of numbers, 1 if there is none.

    A row of numbers has numbers in at least a third of its cells, and so have the rows after it.
    """
    rows = _split_lines(lines[: MAX_HEADER_LINES + 5], separator)
    width = Counter(len(row) for row in rows).most_common(1)[0][0]
    good = [len(r) >= width // 2 + 1 and 3 * _count_numbers(r) >= len(r) > 0 for r in rows]
    for k in range(len(good) - 1):
        if good[k] and sum(good[k + 1 : k + 4]) >= min(2, len(good) - k - 1):
            return k
    return 1


def _count_numbers(row: Sequence[str]) -> int:
    return sum(
        bool(np.isfinite(parse_number(cell))) or cell.strip().lower() in NO_NUMBERS for cell in row
    )


def _read_header(
    path: Path, lines: Sequence[str], data: Sequence[str], begin: int, separator: str
) -> tuple[list[str], dict[str, str], list[str]]:
    """Column names, units and notes from the lines above the first row of numbers."""
    notes: list[str] = []
    width = len(_split_lines(data[begin : begin + 1], separator)[0])
    above = [_split_cells(line, separator) for line in data[:begin]]
    if not above:
        place = lines.index(data[0])
        comments = [line.lstrip().lstrip("#").strip() for line in lines[:place]]
        above = [_split_cells(line, separator) for line in comments if line]
    fitting = [row for row in above if abs(len(row) - width) <= 1 and any(row)]
    if not fitting:
        first = ", ".join(_split_cells(data[0], separator)[:4])
        raise RefusedTableError(
            f"the first line of {path.name} holds numbers ({first}...); the columns need names: add a "
            "header line"
            if not data[:begin]
            else f"no line of {path.name} above its numbers names its {width} columns; the last one is "
            f"{data[begin - 1][:60]!r}. Add a header line"
        )
    units: dict[str, str] = {}
    names = fitting[-1]
    if len(fitting) > 1 and all(_is_unit_cell(cell) for cell in names):
        unit_row, names = names, fitting[-2]
        units = {n: u.strip("[]() ").lower() for n, u in zip(names, unit_row, strict=False)}
        notes.append("units taken from the row below the header")
    if len(above) > len(fitting) or len(fitting) > 1 + bool(units):
        notes.append("lines above the header left out")
    names = [name or f"column {k + 1}" for k, name in enumerate(names)]
    if len(set(names)) != len(names):
        raise RefusedTableError(
            f"{path.name} has two columns of the same name: {', '.join(names)}. Rename one"
        )
    return names, units, notes


def _split_cells(line: str, separator: str) -> list[str]:
    row = _split_lines([line], separator)
    return [cell.strip() for cell in row[0]] if row else []


def _is_unit_cell(cell: str) -> bool:
    return cell.strip("[]() ").lower() in UNITS or not cell


def parse_number(text: str) -> float:
    """Parse a cell with a decimal point or comma; nan if it holds no number."""
    try:
        return float(text)
    except ValueError:
        pass
    try:
        return float(text.strip().rstrip("%°").replace(",", "."))
    except ValueError:
        return float("nan")


@dataclass(slots=True)
class Table:
    """Columns of a file as text, with the assumptions made about it."""

    path: Path
    columns: dict[str, list[str]]
    notes: list[str] = field(default_factory=list[str])
    """Assumptions and repairs, for the user."""
    units: dict[str, str] = field(default_factory=dict[str, str])
    """By column name, from a row of units below the header."""
    derived: dict[str, Array] = field(default_factory=dict[str, Array])
    """Columns computed from others, by name, (rows,) each."""

    @property
    def row_count(self) -> int:
        """Rows without the header."""
        return len(next(iter(self.columns.values()), []))

    def numbers(self, name: str) -> Array:
        """A column as numbers, (rows,); nan where a cell is empty or unreadable.

        Raises:
            RefusedTableError: there is no such column, or too few of its non-blank cells are numbers.
        """
        if name in self.derived:
            return self.derived[name].copy()
        cells = self.columns[self.column(name)]
        try:
            values = np.array(cells, dtype=np.float64)
        except ValueError:
            values = np.array([parse_number(text) for text in cells])
        values[~(np.abs(values) < MAX_MAGNITUDE)] = np.nan
        good = np.isfinite(values)
        if (share := float(np.mean(good)) if len(values) else 0.0) < MIN_NUMBERS_RATIO:
            # Tables merged from several topics have blank cells in the rows of other topics: not counted.
            filled = np.array([text.strip().lower() not in BLANK_CELLS for text in cells])
            if not np.any(good) or np.sum(good) < MIN_NUMBERS_RATIO * np.sum(filled):
                raise RefusedTableError(
                    f"column {name!r} of {self.path.name} holds a number in {share:.0%} of its rows; "
                    "choose another column"
                )
        return values

    def clock(self, name: str) -> Array:
        """A column of times, (rows,): numbers, or dates and times of day in s from the first one."""
        try:
            return self.numbers(name)
        except RefusedTableError:
            values = np.array([_parse_time_s(text) for text in self.columns[self.column(name)]])
            if np.mean(np.isfinite(values)) < MIN_NUMBERS_RATIO:
                raise
            self.notes.append(f"{name!r} read as dates or times of day")
            return values - values[np.isfinite(values)][0]

    def is_numeric(self, name: str) -> bool:
        """Whether a column holds numbers that vary."""
        try:
            values = self.numbers(name)
        except RefusedTableError:
            return False
        return bool(np.nanmax(values) > np.nanmin(values))

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
            numbers = sum(bool(np.isfinite(parse_number(text))) for text in some)
            if 1 < len(some) <= MAX_LABELS_COUNT and numbers < MIN_NUMBERS_RATIO * len(some):
                found.append(name)
        return found

    def labels(self, name: str) -> list[str]:
        """A column as text, (rows,)."""
        return self.columns[self.column(name)]

    def column(self, name: str) -> str:
        """The exact name of a column; case and surrounding blanks are ignored.

        Raises:
            RefusedTableError: there is no such column.
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


def read_table(path: Path) -> Table:
    """Read a delimited text file with a header line.

    Raises:
        RefusedTableError: see `read_raw_table`.
    """
    header, rows, units, notes = read_raw_table(path)
    width = len(header)
    if not all(len(row) == width for row in rows):
        rows = [(row + [""] * width)[:width] for row in rows]
    columns = dict(zip(header, (list(cells) for cells in zip(*rows, strict=True)), strict=True))
    return Table(path, columns, notes, units)


def says_degrees(words: Sequence[str]) -> bool | None:
    """Whether a column's words mean degrees (True) or radians (False); None if they name neither."""
    if any(word in DEGREE_WORDS for word in words):
        return True
    return False if any(word in ("rad", "radians", "radian") for word in words) else None


def split_name(name: str) -> list[str]:
    """Lower-case words of a column name: ``Boom pos [deg]`` and ``BoomPos_deg`` give boom, pos, deg."""
    text = re.sub(r"([a-z]{2,})([A-Z])", r"\1 \2", name.replace("°", " deg ").replace("%", " pct "))
    return "".join(c.lower() if c.isalnum() else " " for c in text).split()


_CLOCK = re.compile(r"(?:(\d+):)?(\d+):(\d+(?:[.,]\d+)?)\s*([AaPp][Mm])?")


_DAY = re.compile(r"^\D*(\d{1,2})[./](\d{1,2})[./](\d{4})")


def _parse_time_s(text: str) -> float:
    """Seconds of a date and time, or of a time of day; nan if the text is neither."""
    try:
        # Only differences matter: a time without a zone may be read as UTC.
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
    # Within one record it does not matter which of the two numbers is the month.
    days = 0 if day is None else int(day.group(1)) + int(day.group(2))
    return 86400.0 * days + 3600.0 * hour + 60.0 * int(minutes) + float(seconds.replace(",", "."))
