"""Where a table's names, units and rows stand in its lines: the common layout and those of some programs."""

import csv
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from diagnosis.tables.cells import RefusedTableError, is_blank, is_number, parse_times_s
from diagnosis.tables.text_files import find_separator, read_lines

MIN_ROWS: Final = 20
"""Fewest rows of a usable table, and of a run."""
MAX_HEADER_LINES: Final = 1000
"""Lines among which the first row of numbers is searched."""
TYPICAL_ROWS: Final = 200
"""Rows from the last fifth of the file that show which columns hold text."""
_TIMES: Final = ("s", "sec", "ms", "us", "ns", "min")
_LENGTHS: Final = ("m", "cm", "mm", "ft", "yd", "in", "px", "m/s", "cm/s", "mm/s", "ft/s")
_ANGLES: Final = ("rad", "deg", "°", "rad/s", "deg/s", "°/s")
UNITS: Final = frozenset({*_TIMES, *_LENGTHS, *_ANGLES, "%", "pct", "v", "bar", "(none)", "-", "1"})
"""Cells that a row of units may hold."""


class RawTable(NamedTuple):
    """A table as text."""

    header: list[str]
    rows: list[list[str]]
    units: dict[str, str]
    """By column name."""
    notes: list[str]
    """Assumptions made while reading, for the user."""
    numbers: list[int]
    """Line of the file of each row."""


class _Grid(NamedTuple):
    """Cells of all lines, without trailing blank ones, and the lines' numbers."""

    rows: list[list[str]]
    numbers: list[int]


def read_raw_table(path: Path) -> RawTable:
    """Read a delimited text file; the separator is comma, semicolon, bar, tab or blank.

    Raises:
        RefusedTableError: the file is missing, too large, not text, too short, or has no column names.
    """
    lines, numbers, notes = read_lines(path)
    is_data = [not line.lstrip().startswith("#") for line in lines]
    data = [line for line, keep in zip(lines, is_data, strict=True) if keep]
    if len(data) < MIN_ROWS:
        raise RefusedTableError(
            f"{path.name} has {len(data)} lines, at least {MIN_ROWS} are needed: empty or cut off"
        )
    separator = find_separator(data)
    grid = _split_lines(
        data, [n for n, keep in zip(numbers, is_data, strict=True) if keep], separator
    )
    comments = [line.lstrip().lstrip("#").strip() for line in lines[: is_data.index(True)]]
    if lines[0].lower().startswith("#multi:"):
        raw = _read_tracker(grid)
    else:
        raw = _read_controldesk(grid) or _read_twincat(path, grid)
        raw = raw or _read_common(path, grid, [_cells(c, separator) for c in comments if c])
    return _check_rows(path, raw._replace(notes=[*notes, *raw.notes]))


def _split_lines(lines: Sequence[str], numbers: Sequence[int], separator: str) -> _Grid:
    rows: list[list[str]] = []
    places: list[int] = []
    reader = csv.reader(lines, delimiter=separator, skipinitialspace=True)
    try:
        for row in reader:
            rows.append(_without_trailing_blanks(row))
            places.append(numbers[reader.line_num - 1])
    except csv.Error:  # a quotation mark that is never closed
        return _Grid([line.split(separator) for line in lines], list(numbers))
    return _Grid(rows, places)


def _cells(line: str, separator: str) -> list[str]:
    return _split_lines([line], [1], separator).rows[0]


def _without_trailing_blanks(row: list[str]) -> list[str]:
    row = [cell.strip() for cell in row]
    while len(row) > 1 and not row[-1]:
        row.pop()
    return row


def _read_controldesk(grid: _Grid) -> RawTable | None:
    """Layout of dSPACE ControlDesk, rows that begin with trace_names and trace_values; else None."""
    marks = {row[0]: k for k, row in enumerate(grid.rows[:MAX_HEADER_LINES]) if row}
    if not {"trace_names", "trace_values"} <= set(marks):
        return None
    names = ["time", *grid.rows[marks["trace_names"]][2:]]
    units = ["s", *grid.rows[marks["trace_units"]][2:]] if "trace_units" in marks else []
    begin = marks["trace_values"]
    rows = [row[1:] for row in grid.rows[begin:]]
    note = (
        "ControlDesk: names from trace_names, units from trace_units, the first column is the time"
    )
    return _name_columns(names, _Grid(rows, grid.numbers[begin:]), units, [note])


def _read_twincat(path: Path, grid: _Grid) -> RawTable | None:
    """Layout of TwinCAT Scope: properties, then a time in ms and a value for each channel; else None.

    Raises:
        RefusedTableError: the channels have clocks of their own.
    """
    top = grid.rows[:MAX_HEADER_LINES]
    heads = [k for k, r in enumerate(top) if len(r) > 3 and set(r[::2]) == {"Name"}]
    if not heads or not any(row[0].startswith("SampleTime") for row in top):
        return None
    channels = grid.rows[heads[0]][1::2]
    begin = next(
        (k for k in range(heads[0], len(grid.rows)) if all(is_number(c) for c in grid.rows[k])),
        len(grid.rows),
    )
    unit_row = next((r for r in top[heads[0] : begin] if r and set(r[::2]) == {"Unit"}), [])
    rows = grid.rows[begin:]
    if any(len(set(row[::2])) > 1 for row in rows):
        raise RefusedTableError(
            f"{path.name} is a TwinCAT Scope export whose channels have clocks of their own: export them "
            "with one sample time"
        )
    units = ["ms", *(unit if unit != "(None)" else "" for unit in unit_row[1::2])]
    note = "TwinCAT Scope: channels by their row Name, times in ms"
    short = [name.rpartition(".")[2] for name in channels]
    names = ["time", *(short if len(set(short)) == len(short) else channels)]
    body = _Grid([[*row[:1], *row[1::2]] for row in rows], grid.numbers[begin:])
    return _name_columns(names, body, units, [note])


def _read_tracker(grid: _Grid) -> RawTable:
    """Layout of Tracker with several bodies: their names above columns t, x, y, x, y; a row for each body.

    Raises:
        RefusedTableError: the names of bodies and columns do not belong together.
    """
    bodies = [name for name in grid.rows[0] if name]
    names = grid.rows[1]
    width, left = divmod(len(names) - 1, max(len(bodies), 1))
    own = names[1 : 1 + width]
    if left or width == 0 or names != [names[0], *own * len(bodies)]:
        raise RefusedTableError(
            f"the file holds several bodies of Tracker ({', '.join(bodies)}) whose columns differ "
            f"({', '.join(names)}): export one file a body"
        )
    rows: list[list[str]] = []
    for k, body in enumerate(bodies):
        part = slice(1 + k * width, 1 + (k + 1) * width)
        rows += [[row[0], *row[part], body] for row in grid.rows[2:]]
    note = f"Tracker: {len(bodies)} bodies ({', '.join(bodies)}), each with its own rows"
    numbers = grid.numbers[2:] * len(bodies)
    return _name_columns([names[0], *own, "body"], _Grid(rows, numbers), [], [note])


def _read_common(path: Path, grid: _Grid, comments: Sequence[list[str]]) -> RawTable:
    """A header line, with lines above it and a row of units below it or not."""
    begin, width = _find_first_row(path, grid)
    above = grid.rows[:begin] or list(comments)
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
    return _name_columns(names, _Grid(grid.rows[begin:], grid.numbers[begin:]), units, notes)


def _find_first_row(path: Path, grid: _Grid) -> tuple[int, int]:
    """Index of the first row of numbers, and the width of the rows.

    It holds a number, and text only in columns that hold text further down.

    Raises:
        RefusedTableError: none is found.
    """
    tail = grid.rows[-max(MIN_ROWS, len(grid.rows) // 5) :]
    typical = tail[:: max(1, len(tail) // TYPICAL_ROWS)]
    width = Counter(len(row) for row in typical).most_common(1)[0][0]
    width = max([width, *(len(row) for row in typical if _is_short_of_blanks(row, typical))])
    has_text = [
        2 * sum(_is_text(row[k]) for row in typical if k < len(row))
        > sum(not is_blank(row[k]) for row in typical if k < len(row))
        for k in range(width)
    ]
    for k, row in enumerate(grid.rows[:MAX_HEADER_LINES]):
        is_typed = all(has_text[n] or not _is_text(cell) for n, cell in enumerate(row[:width]))
        if is_typed and any(is_number(cell) for cell in row):
            return k, width
    if all(has_text):
        return 1, width
    raise RefusedTableError(f"{path.name} has no row of numbers within {MAX_HEADER_LINES} lines")


def _is_short_of_blanks(row: Sequence[str], typical: Sequence[Sequence[str]]) -> bool:
    """Whether at least a tenth of the rows are as long: shorter ones then end in blank cells."""
    return sum(len(other) >= len(row) for other in typical) >= 0.1 * len(typical)


def _is_text(cell: str) -> bool:
    return not (is_blank(cell) or is_number(cell) or bool(np.isfinite(parse_times_s([cell])[0])))


def _no_header_error(
    path: Path, grid: _Grid, begin: int, width: int, above: Sequence[Sequence[str]]
) -> RefusedTableError:
    if not above:
        first = ", ".join(grid.rows[0][:4])
        return RefusedTableError(
            f"the first line of {path.name} holds numbers ({first}...); the columns need names: add a header "
            "line"
        )
    return RefusedTableError(
        f"no line of {path.name} above its numbers names its {width} columns; the last one (row "
        f"{grid.numbers[max(begin - 1, 0)]}) is {', '.join(above[-1])[:60]!r}. Add a header line"
    )


def _name_columns(
    names: Sequence[str], body: _Grid, units: Sequence[str], notes: list[str]
) -> RawTable:
    """Number names that are missing or occur twice, and leave out repetitions of the header."""
    header: list[str] = []
    for k, name in enumerate(names):
        own = name or f"column {k + 1}"
        count = 1 + sum(other == own for other in names[:k])
        header.append(own if count == 1 else f"{own} ({count})")
    by_name = {n: u.strip("[]() ").lower() for n, u in zip(header, units, strict=False)}
    repeated = [k for k, row in enumerate(body.rows) if row == list(names)]
    if repeated:
        notes.append(f"{len(repeated)} repetitions of the header left out")
        body = _Grid(
            [row for k, row in enumerate(body.rows) if k not in set(repeated)],
            [n for k, n in enumerate(body.numbers) if k not in set(repeated)],
        )
    return RawTable(header, body.rows, by_name, notes, body.numbers)


def _check_rows(path: Path, raw: RawTable) -> RawTable:
    """Rows as wide as the header; torn ones are left out.

    Raises:
        RefusedTableError: there is no row, or one has more cells than there are names.
    """
    width = len(raw.header)
    if not raw.rows:
        raise RefusedTableError(f"{path.name} has no row of numbers")
    for row, number in zip(raw.rows, raw.numbers, strict=True):
        if len(row) > width:
            raise RefusedTableError(
                f"row {number} of {path.name} has {len(row)} cells, its header names {width} columns "
                f"({', '.join(raw.header)[:80]}): a separator within a number or a text, or a name is missing"
            )
    # A last line with fewer cells than the others was cut while it was written.
    is_cut = len(raw.rows) > 1 and len(raw.rows[-1]) < min(len(row) for row in raw.rows[:-1])
    keep = [k for k in range(len(raw.rows)) if not is_cut or k < len(raw.rows) - 1]
    cut_note = f"the last line (row {raw.numbers[-1] if raw.numbers else 0}) is cut off: left out"
    notes = [*raw.notes, cut_note] if is_cut else raw.notes
    rows = [(raw.rows[k] + [""] * width)[:width] for k in keep]
    return raw._replace(rows=rows, notes=notes, numbers=[raw.numbers[k] for k in keep])
