"""Numbers and times of a column's cells, read exactly: one form for the whole column.

A form is a decimal sign and a thousands sign. It follows from the cells: a sign that occurs twice in a cell,
or before the other sign, separates thousands; a sign that is not followed by exactly three digits is decimal.
"""

import math
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Final, Literal, NamedTuple

import numpy as np

from machine.conventions import Array
from machine.errors import LogError

Decimal = Literal["auto", "point", "comma"]


class RefusedTableError(LogError):
    """A table that cannot be used; the message gives the reason with numbers and the remedy."""


class NumberForm(NamedTuple):
    """How the numbers of a column are written."""

    decimal: str
    thousands: str = ""

    def describe(self) -> str:
        """Text for notes and refusals."""
        name = {".": "decimal point", ",": "decimal comma"}[self.decimal]
        return f"{name}, {self.thousands!r} between thousands" if self.thousands else name


POINT: Final = NumberForm(".")
BLANK_CELLS: Final = frozenset(
    [
        "",
        "nan",
        "-nan",
        "na",
        "n/a",
        "#n/a",
        "#nv",
        "null",
        "none",
        "-",
        "--",
        "inf",
        "-inf",
        "+inf",
    ]
)
"""Cells, in lower case, that hold no value."""
MAX_MAGNITUDE: Final = 1e20
"""Larger numbers hold no value; nanoseconds since 1970 are near 2e18."""
SMOOTHER_RATIO: Final = 1.5
"""A reading is preferred to the other if the column then moves less, relative to its range, by this."""
_MINUS: Final = str.maketrans(dict.fromkeys("\u2212\u2013\ufe63\uff0d", "-"))
_BLANKS: Final = str.maketrans(dict.fromkeys("\u00a0\u2009\u202f", " "))
_ANY_NUMBER: Final = re.compile(r"[+-]?(?:\d[\d.,' ]*|[.,]\d+)(?:[eE][+-]?\d+)?")
_THOUSANDS: Final = re.compile(r"[+-]?[1-9]\d{0,2}[.,]\d{3}")


def clean_cell(text: str) -> str:
    """A cell with an ASCII minus, without surrounding blanks and a trailing percent or degree sign."""
    return text.translate(_MINUS).translate(_BLANKS).strip().rstrip("%°").rstrip()


def has_other_minus(text: str) -> bool:
    """Whether a cell has a minus sign other than ASCII's."""
    return not text.isascii() and text.translate(_MINUS) != text


def is_number(text: str) -> bool:
    """Whether a cell holds a number of any form."""
    return _ANY_NUMBER.fullmatch(clean_cell(text)) is not None


def is_blank(text: str) -> bool:
    """Whether a cell holds no value."""
    return text.strip().lower() in BLANK_CELLS


def find_form(cells: Sequence[str]) -> NumberForm | None:
    """The form that a column's cells are written in; None if several fit.

    Cells without a decimal or thousands sign fit any form.
    """
    if not any("," in text for text in cells):
        # A point is decimal unless the column proves otherwise.
        return None if _all_thousands([text for text in cells if "." in text]) else POINT
    seen = [text for text in map(clean_cell, cells) if _ANY_NUMBER.fullmatch(text)]
    marked = {sign: [text for text in seen if sign in text] for sign in ".,"}
    for text in marked[","]:
        if "." in text:
            return (
                NumberForm(".", ",") if text.rfind(".") > text.rfind(",") else NumberForm(",", ".")
            )
    for sign, other in ((",", "."), (".", ",")):
        if any(text.count(sign) > 1 for text in marked[sign]):
            return NumberForm(other, sign)
        if marked[sign] and not _all_thousands(marked[sign]):
            return NumberForm(sign, other if marked[other] else "")
    return None


def _all_thousands(cells: Sequence[str]) -> bool:
    """Whether the sign in every cell may separate thousands."""
    return bool(cells) and all(_THOUSANDS.fullmatch(clean_cell(text)) for text in cells)


def settle_form(cells: Sequence[str], likely: NumberForm | None, name: str) -> NumberForm:
    """The form of a column whose own cells do not settle it.

    Args:
        cells: of the column.
        likely: form of the file's other columns, if they have one.
        name: of the column, for the message.

    Raises:
        RefusedTableError: several forms fit.
    """
    sign = "," if any("," in text for text in cells) else "."
    grouped = NumberForm("." if sign == "," else ",", sign)
    if likely is not None:
        return likely if likely.decimal == sign else grouped
    as_thousands, as_decimal = (
        _relative_travel(parse_cells(cells, form)) for form in (grouped, NumberForm(sign))
    )
    if SMOOTHER_RATIO * as_thousands < as_decimal:
        return grouped
    if sign == "." or SMOOTHER_RATIO * as_decimal < as_thousands:
        return NumberForm(sign)
    example = next(text for text in cells if sign in text)
    raise RefusedTableError(
        f"column {name!r}: is {example!r} {example.replace(sign, '')} or {example.replace(',', '.')}? "
        "Give --decimal point or --decimal comma"
    )


def _relative_travel(values: Array) -> float:
    known = values[np.isfinite(values)]
    span = float(np.ptp(known)) if known.size else 0.0
    return float(np.sum(np.abs(np.diff(known)))) / span if span > 0.0 else math.inf


def parse_cells(cells: Sequence[str], form: NumberForm) -> Array:
    """Cells as numbers, (rows,); nan where one holds no number of this form."""
    if form == POINT and not any("_" in text for text in cells):
        try:
            return np.array(cells, dtype=np.float64)
        except ValueError:  # blank cells, or other signs
            pass
    group = "[ '\u2019" + re.escape(form.thousands) + "]"
    decimal = re.escape(form.decimal)
    pattern = re.compile(
        rf"[+-]?(?:(?:\d+|\d{{1,3}}(?:{group}\d{{3}})+)(?:{decimal}\d*)?|{decimal}\d+)(?:[eE][+-]?\d+)?"
    )
    values = np.full(len(cells), np.nan)
    for k, cell in enumerate(cells):
        text = clean_cell(cell)
        if pattern.fullmatch(text):
            values[k] = float(re.sub(group, "", text).replace(form.decimal, "."))
    return values


_CLOCK: Final = re.compile(r"(?:(\d+):)?(\d+):(\d+(?:[.,]\d+)?)\s*([AaPp][Mm])?")
_DAY: Final = re.compile(r"^\D*(\d{1,2})([./-])(\d{1,2})\2(\d{4})")
_DAY_S: Final = 86400.0


def parse_times_s(cells: Sequence[str]) -> Array:
    """Seconds of dates and times, or of times of day, (rows,); nan where a cell is neither.

    Days are written before months with points; with slashes the order follows from a number above 12.
    Times of day that pass midnight go on.

    Raises:
        RefusedTableError: the day changes and either number may be the month.
    """
    found = [_DAY.match(text) for text in cells]
    days = {(int(m[1]), m[2], int(m[3])) for m in found if m is not None}
    is_month_first = any(second > 12 for _, _, second in days)
    is_open = not is_month_first and all(sign != "." and first <= 12 for first, sign, _ in days)
    if len(days) > 1 and is_open:
        example = next(m[0] for m in found if m is not None)
        raise RefusedTableError(
            f"in the date {example!r} either number may be the month, and the day changes: write dates as "
            "2021-01-20"
        )
    values = np.array([_parse_time_s(text, is_month_first) for text in cells])
    if not days:
        back = np.flatnonzero(np.diff(values) < -0.5 * _DAY_S)
        for row in back:
            values[row + 1 :] += _DAY_S
    return values


def _parse_time_s(text: str, is_month_first: bool) -> float:
    try:
        # Only differences matter: a time without a zone may be read as UTC.
        stamp = datetime.fromisoformat(text.strip())
        return stamp.replace(tzinfo=stamp.tzinfo or UTC).timestamp()
    except ValueError:
        pass
    found = _CLOCK.search(text)
    if found is None:
        return math.nan
    hours, minutes, seconds, half = found.groups()
    hour = int(hours or 0) % 12 + 12 * (half.lower() == "pm") if half else int(hours or 0)
    midnight_s = 0.0
    if (day := _DAY.match(text)) is not None:
        first, second = int(day[1]), int(day[3])
        number, month = (second, first) if is_month_first else (first, second)
        try:
            midnight_s = datetime(int(day[4]), month, number, tzinfo=UTC).timestamp()
        except ValueError:
            return math.nan
    return midnight_s + 3600.0 * hour + 60.0 * int(minutes) + float(seconds.replace(",", "."))
