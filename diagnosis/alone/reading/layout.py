"""Finds header, separator and rows in the text of a table, whatever was written above it.

Lines above the header, a header behind ``#``, a row of units below it and decimal commas are understood; a
table without names for its columns is refused.
"""

import csv
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from machine.errors import LogError

MIN_ROWS: Final = 20
LOOK_LINES: Final = 400
"""As many lines tell how a table is laid out."""
HEADER_LINES: Final = 60
"""The first row of numbers is looked for in as many lines."""
MAX_BYTES: Final = 1_500_000_000
"""Beyond this a table does not fit into the memory of a small machine (about 4 times its size is needed)."""
ARCHIVE_MARK: Final = b"PK\x03\x04"
"""With which zip archives begin; spreadsheets are such."""
LOOK_BYTES: Final = 4096
BINARY_RATIO: Final = 0.1
"""Of the first bytes of a file: with more control characters it is no text."""
NO_NUMBERS: Final = ("nan", "inf", "-inf", "na", "n/a", "null", "none")
_TIMES: Final = ("s", "sec", "ms", "us", "ns", "min")
_LENGTHS: Final = ("m", "cm", "mm", "ft", "yd", "in", "px", "m/s", "cm/s", "mm/s", "ft/s")
_ANGLES: Final = ("rad", "deg", "°", "rad/s", "deg/s", "°/s")
UNITS: Final = frozenset({*_TIMES, *_LENGTHS, *_ANGLES, "%", "pct", "v", "-", "1"})
"""What the cells of a row of units hold."""


class RefusedTableError(LogError):
    """A table that cannot be used: the text says why, with numbers, and what to do."""


class Layout(NamedTuple):
    """A table as text."""

    header: list[str]
    rows: list[list[str]]
    units: dict[str, str]
    """Of the columns, from a row of units below the header."""
    notes: list[str]


def read_layout(path: Path) -> Layout:
    """Read a table; comma, semicolon, bar, tab or blanks between cells.

    Raises:
        RefusedTableError: missing, empty, or without names for its columns.
    """
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise RefusedTableError(
                f"{path.name} has {size / 1e9:.1f} GB, at most {MAX_BYTES / 1e9:g} GB are read: "
                "give the part with the motion, or every tenth row"
            )
        text = path.read_text(encoding=_encoding(path), errors="replace")
    except OSError as error:
        raise RefusedTableError(f"cannot open {path}: {error.strerror}") from error
    lines = [line for line in text.replace("\x00", "").splitlines() if line.strip()]
    data = [line for line in lines if not line.lstrip().startswith("#")]
    if len(data) < MIN_ROWS:
        raise RefusedTableError(
            f"{path.name} has {len(data)} lines, at least {MIN_ROWS} are needed: empty or cut off"
        )
    separator = _separator(data)
    is_comma_decimal = separator == ";" and any("," in line for line in data[1:20])
    begin = _first_row(data, separator)
    header, units, notes = _header(path, lines, data, begin, separator)
    body = _split(data[begin:], separator)
    whole = [row for row in body if len(row) >= len(header) // 2 + 1]
    if len(whole) < len(body):
        notes.append(f"{len(body) - len(whole)} torn lines left out")
    if is_comma_decimal:
        notes.append("decimal commas read as points")
    return Layout(header, whole, units, notes)


def _encoding(path: Path) -> str:
    """UTF-16 by its mark (spreadsheets export it), else UTF-8.

    Raises:
        RefusedTableError: no text.
    """
    with path.open("rb") as file:
        start = file.read(LOOK_BYTES)
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


def _separator(lines: Sequence[str]) -> str:
    """What most lines have equally often; a comma between the digits of a number separates nothing."""
    part = [*lines[: LOOK_LINES // 2], *lines[-LOOK_LINES // 2 :]]
    best, most = " ", 0
    for separator in ";\t|,":
        counts = Counter(line.count(separator) for line in part)
        count, lines_count = counts.most_common(1)[0]
        if count > 0 and lines_count > max(most, 0.5 * len(part)):
            best, most = separator, lines_count
    return best


def _split(lines: Sequence[str], separator: str) -> list[list[str]]:
    try:
        return list(csv.reader(lines, delimiter=separator, skipinitialspace=True))
    except csv.Error:  # a quotation mark that is never closed
        return [line.split(separator) for line in lines]


def _first_row(lines: Sequence[str], separator: str) -> int:
    """Number of the first line of which at least a third are numbers, and the next ones too; 1 if none."""
    rows = _split(lines[: HEADER_LINES + 5], separator)
    width = Counter(len(row) for row in rows).most_common(1)[0][0]
    good = [len(r) >= width // 2 + 1 and 3 * _numbers_count(r) >= len(r) > 0 for r in rows]
    for k in range(len(good) - 1):
        if good[k] and sum(good[k + 1 : k + 4]) >= min(2, len(good) - k - 1):
            return k
    return 1


def _numbers_count(row: Sequence[str]) -> int:
    return sum(
        bool(np.isfinite(number(cell))) or cell.strip().lower() in NO_NUMBERS for cell in row
    )


def _header(
    path: Path, lines: Sequence[str], data: Sequence[str], begin: int, separator: str
) -> tuple[list[str], dict[str, str], list[str]]:
    """Names, units and notes from the lines above the first row of numbers."""
    notes: list[str] = []
    width = len(_split(data[begin : begin + 1], separator)[0])
    above = [_cells(line, separator) for line in data[:begin]]
    if not above:
        place = lines.index(data[0])
        comments = [line.lstrip().lstrip("#").strip() for line in lines[:place]]
        above = [_cells(line, separator) for line in comments if line]
    fitting = [row for row in above if abs(len(row) - width) <= 1 and any(row)]
    if not fitting:
        first = ", ".join(_cells(data[0], separator)[:4])
        raise RefusedTableError(
            f"the first line of {path.name} holds numbers ({first}...); the columns need names: add a "
            "header line"
            if not data[:begin]
            else f"no line of {path.name} above its numbers names its {width} columns; the last one is "
            f"{data[begin - 1][:60]!r}. Add a header line"
        )
    units: dict[str, str] = {}
    names = fitting[-1]
    if len(fitting) > 1 and all(_is_unit(cell) for cell in names):
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


def _cells(line: str, separator: str) -> list[str]:
    row = _split([line], separator)
    return [cell.strip() for cell in row[0]] if row else []


def _is_unit(cell: str) -> bool:
    return cell.strip("[]() ").lower() in UNITS or not cell


def number(text: str) -> float:
    """A cell as a number, with a point or a comma; nan if it is none."""
    try:
        return float(text)
    except ValueError:
        pass
    try:
        return float(text.strip().rstrip("%°").replace(",", "."))
    except ValueError:
        return float("nan")
