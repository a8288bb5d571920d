"""Where a table's names, units and rows stand in its lines: the common layout and those of some programs."""

import csv
import io
import re
from collections import Counter
from collections.abc import Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import pandas as pd

from diagnosis.tables.cells import RefusedTableError, is_blank, is_number, parse_times_s
from diagnosis.tables.text_files import find_separator, read_lines, require_readable
from machine.conventions import IntArray

MIN_ROWS: Final = 20
"""Fewest rows of a usable table, and of a run."""
MAX_HEADER_LINES: Final = 1000
"""Lines among which the first row of numbers is searched."""
TYPICAL_ROWS: Final = 200
"""Rows from the last fifth of the file that show which columns hold text."""
_TEXT: Final = pd.StringDtype("python", na_value=np.nan)
"""With Arrow, where that is installed, other regular expressions would be valid."""
_COMMENT: Final = re.compile(
    r"\s*(?:#(?!N/?A|NV|DIV/0|VALUE|NUM|REF|NULL|NAME\?)|%\s|//)", re.IGNORECASE
)
"""Begin of a comment, not the error of a spreadsheet."""
_TIMES: Final = ("s", "sec", "ms", "us", "ns", "min")
_LENGTHS: Final = ("m", "cm", "mm", "ft", "yd", "in", "px", "m/s", "cm/s", "mm/s", "ft/s")
_ANGLES: Final = ("rad", "deg", "°", "rad/s", "deg/s", "°/s")
UNITS: Final = frozenset({*_TIMES, *_LENGTHS, *_ANGLES, "%", "pct", "v", "bar", "(none)", "-", "1"})
"""Cells that a row of units may hold."""


class RawTable(NamedTuple):
    """A table as text."""

    cells: pd.DataFrame
    """A column of texts by name; the index holds the line of each row in the file."""
    units: dict[str, str]
    """By column name."""
    notes: list[str]
    """Assumptions made while reading, for the user."""


def read_raw_table(path: Path) -> RawTable:
    """Read a delimited text file; the separator is comma, semicolon, bar, tab or blank.

    Raises:
        RefusedTableError: the file is missing, too large, not text, too short, or has no column names.
    """
    lines, numbers, notes, foreign = read_lines(path)
    is_data = np.array([_COMMENT.match(line) is None for line in lines], dtype=np.bool_)
    data = [line for line, keep in zip(lines, is_data, strict=True) if keep]
    if len(data) < MIN_ROWS:
        raise RefusedTableError(
            f"{path.name} has {len(data)} lines, at least {MIN_ROWS} are needed: empty or cut off"
        )
    separator = find_separator(data)
    grid = _split_lines(data, np.array(numbers)[is_data], separator)
    first = int(np.argmax(is_data))
    if later := int(np.sum(~is_data[first:])):
        notes = [*notes, f"{later} lines of comments below the first row left out"]
    if lines[0].lower().startswith("#multi:"):
        raw = _read_tracker(grid)
    else:
        comments = [_COMMENT.sub("", line, 1).lstrip("#%/ ") for line in lines[:first]]
        names = [
            _top(_split_lines([text], np.array([1]), separator), 1)[0]
            for text in comments
            if text.strip()
        ]
        raw = _read_controldesk(grid) or _read_twincat(path, grid)
        raw = raw or _read_common(path, grid, names)
    words = (*map(str, raw.cells.columns), *raw.units.values())
    require_readable(path, foreign, list(raw.cells.index), words)
    return _check_rows(path, raw._replace(notes=[*notes, *raw.notes]))


def _split_lines(lines: Sequence[str], numbers: IntArray, separator: str) -> pd.DataFrame:
    """Cells of lines, the index holds their numbers.

    A quotation mark that is never closed, or far too late, is a character like others.
    """
    width = 1 + max(line.count(separator) for line in lines)
    if separator == " ":
        width = max(len(line.split()) for line in lines)
    for quoting in (csv.QUOTE_MINIMAL, csv.QUOTE_NONE):
        try:
            cells = pd.read_csv(
                io.StringIO("\n".join(lines)),
                sep=r"\s+" if separator == " " else separator,
                header=None,
                names=list(range(width)),
                index_col=False,
                dtype=_TEXT,
                na_filter=False,
                skipinitialspace=True,
                quoting=quoting,
            )
        except pd.errors.ParserError:
            continue
        if len(cells) == len(lines):
            cells.index = pd.Index(numbers)
            return cells.apply(lambda column: column.str.strip())
        breaks = cells.apply(lambda column: column.str.count("\n")).sum(axis=1).to_numpy()
        joined = cells.apply(lambda column: column.str.count(re.escape(separator))).to_numpy()
        if np.sum(breaks) + len(cells) == len(lines) and np.max(joined) < max(width - 1, 1):
            begins = np.concatenate([[0], np.cumsum(breaks + 1)[:-1]]).astype(np.int64)
            cells.index = pd.Index(numbers[begins])
            return cells.apply(lambda column: column.str.strip())
    raise RefusedTableError("its lines cannot be split into cells: check its quotation marks")


def _top(grid: pd.DataFrame, count: int) -> list[list[str]]:
    """The first rows without trailing blank cells."""
    return [_without_trailing_blanks(row) for row in grid.head(count).to_numpy().tolist()]


def _without_trailing_blanks(row: list[str]) -> list[str]:
    while len(row) > 1 and not row[-1]:
        row.pop()
    return row


def _widths(cells: pd.DataFrame) -> IntArray:
    """Cells of each row without trailing blank ones, at least 1, (rows,)."""
    filled = (cells != "").to_numpy()
    last = filled.shape[1] - np.argmax(filled[:, ::-1], axis=1)
    return np.where(np.any(filled, axis=1), last, 1)


def _read_controldesk(grid: pd.DataFrame) -> RawTable | None:
    """Layout of dSPACE ControlDesk, rows that begin with trace_names and trace_values; else None."""
    top = _top(grid, MAX_HEADER_LINES)
    marks = {row[0]: k for k, row in enumerate(top)}
    if not {"trace_names", "trace_values"} <= set(marks):
        return None
    names = ["time", *top[marks["trace_names"]][2:]]
    if "path" in marks:
        # Ports of blocks are all called In1: the block is the last part of the path.
        blocks = ["time", *(cell.rpartition("/")[2] for cell in top[marks["path"]][2:])]
        names = [
            block if block and names.count(name) > 1 else name
            for name, block in zip_longest(names, blocks[: len(names)], fillvalue="")
        ]
    units = ["s", *top[marks["trace_units"]][2:]] if "trace_units" in marks else []
    note = (
        "ControlDesk: names from trace_names, units from trace_units, the first column is the time"
    )
    body = grid.iloc[marks["trace_values"] :, 1:]
    return _name_columns(names, body, units, [note])


def _read_twincat(path: Path, grid: pd.DataFrame) -> RawTable | None:
    """Layout of TwinCAT Scope: properties, then a time in ms and a value for each channel; else None.

    Raises:
        RefusedTableError: the channels have clocks of their own.
    """
    top = _top(grid, MAX_HEADER_LINES)
    heads = [k for k, r in enumerate(top) if len(r) > 3 and set(r[::2]) == {"Name"}]
    if not heads or not any(row[0].startswith("SampleTime") for row in top):
        return None
    channels = top[heads[0]][1::2]
    begin = next(
        (k for k in range(heads[0], len(top)) if all(is_number(c) for c in top[k])), len(top)
    )
    unit_row = next((r for r in top[heads[0] : begin] if r and set(r[::2]) == {"Unit"}), [])
    body = grid.iloc[begin:, : 2 * len(channels)]
    times = body.iloc[:, ::2]
    if not times.eq(times.iloc[:, 0], axis=0).all(axis=None):
        raise RefusedTableError(
            f"{path.name} is a TwinCAT Scope export whose channels have clocks of their own: export them "
            "with one sample time"
        )
    units = ["ms", *(unit if unit != "(None)" else "" for unit in unit_row[1::2])]
    note = "TwinCAT Scope: channels by their row Name, times in ms"
    short = [name.rpartition(".")[2] for name in channels]
    names = ["time", *(short if len(set(short)) == len(short) else channels)]
    values = pd.concat([times.iloc[:, :1], body.iloc[:, 1::2]], axis=1)
    return _name_columns(names, values, units, [note])


def _read_tracker(grid: pd.DataFrame) -> RawTable:
    """Layout of Tracker with several bodies: their names above columns t, x, y, x, y; a row for each body.

    Raises:
        RefusedTableError: the names of bodies and columns do not belong together.
    """
    first, names = _top(grid, 2)
    bodies = [name for name in first if name]
    width, left = divmod(len(names) - 1, max(len(bodies), 1))
    own = names[1 : 1 + width]
    if left or width == 0 or names != [names[0], *own * len(bodies)]:
        raise RefusedTableError(
            f"the file holds several bodies of Tracker ({', '.join(bodies)}) whose columns differ "
            f"({', '.join(names)}): export one file a body"
        )
    parts: list[pd.DataFrame] = []
    for k, body in enumerate(bodies):
        part = grid.iloc[2:, [0, *range(1 + k * width, 1 + (k + 1) * width)]]
        parts.append(part.set_axis(range(1 + width), axis=1).assign(body=body))
    note = f"Tracker: {len(bodies)} bodies ({', '.join(bodies)}), each with its own rows"
    return _name_columns([names[0], *own, "body"], pd.concat(parts), [], [note])


def _read_common(path: Path, grid: pd.DataFrame, comments: Sequence[list[str]]) -> RawTable:
    """A header line, with lines above it and a row of units below it or not."""
    top = _top(grid, MAX_HEADER_LINES)
    begin, width = _find_first_row(path, grid, top)
    above = top[:begin] or list(comments)
    names_at = [k for k, row in enumerate(above) if len(row) >= width and any(row)]
    # A header that is too short gives a refusal of the row that is too long.
    names_at = names_at or [k for k, row in enumerate(above) if len(row) > max(1, width // 2)]
    notes: list[str] = []
    if not names_at:
        raise _no_header_error(path, grid, begin, width, above)
    names, units = above[names_at[-1]], list[str]()
    if len(names_at) > 1 and all(
        cell.strip("[]() ").lower() in UNITS or not cell for cell in names
    ):
        units, names = names, above[names_at[-2]]
        notes.append("units taken from the row below the header")
    if len(above) > 1 + bool(units):
        notes.append("lines above the header left out")
    return _name_columns(names, grid.iloc[begin:], units, notes)


def _find_first_row(path: Path, grid: pd.DataFrame, top: list[list[str]]) -> tuple[int, int]:
    """Index of the first row of numbers, and the width of the rows.

    It holds a number, and text only in columns that hold text further down, or below a row of names.

    Raises:
        RefusedTableError: none is found.
    """
    tail = grid.iloc[-max(MIN_ROWS, len(grid) // 5) :]
    tail = tail.iloc[:: max(1, len(tail) // TYPICAL_ROWS)]
    typical = [_without_trailing_blanks(row) for row in tail.to_numpy().tolist()]
    width = Counter(len(row) for row in typical).most_common(1)[0][0]
    width = max([width, *(len(row) for row in typical if _is_short_of_blanks(row, typical))])
    has_text = [
        2 * sum(_is_text(row[k]) for row in typical if k < len(row))
        > sum(not is_blank(row[k]) for row in typical if k < len(row))
        for k in range(width)
    ]
    for k, row in enumerate(top):
        is_typed = all(has_text[n] or not _is_text(cell) for n, cell in enumerate(row[:width]))
        if not is_typed or not any(is_number(cell) for cell in row):
            continue
        # Rows between the names and here hold numbers beside a word: they belong to the table.
        while k > 1 and len(top[k - 1]) >= width and _has_number(top[k - 1], has_text):
            k -= 1
        return k, width
    if all(has_text):
        return 1, width
    raise RefusedTableError(f"{path.name} has no row of numbers within {MAX_HEADER_LINES} lines")


def _has_number(row: Sequence[str], has_text: Sequence[bool]) -> bool:
    """Whether at least half of a row's cells in columns of numbers are numbers."""
    cells = [cell for cell, is_text in zip(row, has_text, strict=False) if not is_text]
    return bool(cells) and 2 * sum(is_number(cell) for cell in cells) >= len(cells)


def _is_short_of_blanks(row: Sequence[str], typical: Sequence[Sequence[str]]) -> bool:
    """Whether at least a tenth of the rows are as long: shorter ones then end in blank cells."""
    return sum(len(other) >= len(row) for other in typical) >= 0.1 * len(typical)


def _is_text(cell: str) -> bool:
    return not (is_blank(cell) or is_number(cell) or (":" in cell and _is_time(cell)))


def _is_time(cell: str) -> bool:
    return bool(np.isfinite(parse_times_s(pd.Series([cell], dtype=str))[0]))


def _no_header_error(
    path: Path, grid: pd.DataFrame, begin: int, width: int, above: Sequence[Sequence[str]]
) -> RefusedTableError:
    if not above:
        first = ", ".join(_top(grid, 1)[0][:4])
        return RefusedTableError(
            f"the first line of {path.name} holds numbers ({first}...); the columns need names: add a header "
            "line"
        )
    return RefusedTableError(
        f"no line of {path.name} above its numbers names its {width} columns; the last one (row "
        f"{grid.index[max(begin - 1, 0)]}) is {', '.join(above[-1])[:60]!r}. Add a header line"
    )


def _name_columns(
    names: Sequence[str], body: pd.DataFrame, units: Sequence[str], notes: list[str]
) -> RawTable:
    """Number names that are missing or occur twice, and leave out repetitions of the header."""
    header: list[str] = []
    for k, name in enumerate(names):
        own = name or f"column {k + 1}"
        count = 1 + sum(other == own for other in names[:k])
        header.append(own if count == 1 else f"{own} ({count})")
    by_name = {n: u.strip("[]() ").lower() for n, u in zip(header, units, strict=False)}
    body = body.set_axis(range(body.shape[1]), axis=1).reindex(
        columns=range(max(body.shape[1], len(header))), fill_value=""
    )
    is_repeated = (body.iloc[:, : len(names)] == list(names)).all(axis=1)
    if is_repeated.any():
        notes.append(f"{int(is_repeated.sum())} repetitions of the header left out")
        body = body[~is_repeated]
    return RawTable(body.rename(columns=dict(enumerate(header))), by_name, notes)


def _check_rows(path: Path, raw: RawTable) -> RawTable:
    """Columns that have names; a torn last row is left out.

    Raises:
        RefusedTableError: there is no row, or one has more cells than there are names.
    """
    header = [name for name in raw.cells.columns if isinstance(name, str)]
    if raw.cells.empty:
        raise RefusedTableError(f"{path.name} has no row of numbers")
    widths = _widths(raw.cells)
    if np.any(widths > len(header)):
        first = int(np.argmax(widths > len(header)))
        raise RefusedTableError(
            f"row {raw.cells.index[first]} of {path.name} has {widths[first]} cells, its header names "
            f"{len(header)} columns ({', '.join(header)[:80]}): a separator within a number or a text, or a "
            "name is missing"
        )
    cells, notes = raw.cells[header], raw.notes
    # A last line with fewer cells than the others was cut while it was written.
    if len(widths) > 1 and widths[-1] < np.min(widths[:-1]):
        notes = [*notes, f"the last line (row {cells.index[-1]}) is cut off: left out"]
        cells = cells.iloc[:-1]
    return raw._replace(cells=cells, notes=notes)
