"""Numbers and times of a column's cells, read exactly: one form for the whole column.

A form is a decimal sign and a thousands sign. It follows from the cells: a sign that occurs twice in a cell,
or before the other sign, separates thousands; a sign that is not followed by exactly three digits is decimal.
"""

import math
import re
from typing import Final, Literal, NamedTuple

import numpy as np
import pandas as pd

from machine.conventions import Array, BoolArray
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
    (
        *("", "nan", "-nan", "na", "n/a", "null", "none", "nil", "-", "--", "<na>", "nat", "#nv"),
        *("inf", "-inf", "+inf", "infinity", "-infinity", "nan(ind)", "-nan(ind)", "1.#ind"),
        *("-1.#ind", "1.#qnan", "-1.#qnan", "1.#inf", "-1.#inf", "#n/a", "#div/0!", "#value!"),
        *("#num!", "#ref!", "#null!", "#name?"),
    )
)
"""Cells, in lower case, that hold no value: missing, infinite, or the error of a spreadsheet."""
SWITCH_CELLS: Final = {"true": "1", "false": "0", "on": "1", "off": "0"}
"""States of a switch, in lower case, as numbers."""
MAX_MAGNITUDE: Final = 1e20
"""Larger numbers hold no value; nanoseconds since 1970 are near 2e18."""
SMOOTHER_RATIO: Final = 1.5
"""A reading is preferred to the other if the column then moves less, relative to its range, by this."""
_SIGNS: Final = str.maketrans(
    {
        **dict.fromkeys("\u2212\u2013\u2014\ufe63\uff0d", "-"),
        **dict.fromkeys("\u00a0\u2009\u202f", " "),
    }
)
_FIRST_CELLS: Final = 100
"""Cells that are looked at first, for speed."""
_EXPONENT: Final = r"(?:[eEdD][+-]?\d+)?"
_NUMBER: Final = rf"[+-]?(?:\d[\d.,'\u2019 ]*|[.,]\d+){_EXPONENT}"
_ANY_NUMBER: Final = re.compile(_NUMBER)
_WITH_UNIT: Final = re.compile(rf"({_NUMBER}?)\s*([^\d\s.,'+-]\D*)")
_THOUSANDS: Final = r"[+-]?[1-9]\d{0,2}[.,]\d{3}"


def clean_cells(cells: pd.Series) -> pd.Series:
    """Cells with ASCII minus signs and blanks, none of them at the ends."""
    if not cells.str.isascii().all():
        cells = cells.str.translate(_SIGNS)
    return cells.str.strip()


def is_number(text: str) -> bool:
    """Whether a cell holds a number of any form."""
    return _ANY_NUMBER.fullmatch(text.translate(_SIGNS).strip()) is not None


def is_blank(text: str) -> bool:
    """Whether a cell holds no value."""
    return text.translate(_SIGNS).strip().lower() in BLANK_CELLS


def are_blank(cells: pd.Series) -> BoolArray:
    """Which cells of `clean_cells` hold no value, (rows,)."""
    return cells.str.lower().isin(BLANK_CELLS).to_numpy(np.bool_)


def split_unit(cells: pd.Series) -> tuple[pd.Series, str]:
    """Cells without the unit that follows each of their numbers, and that unit; empty if they have none.

    A percent or degree sign may be left out in some cells.
    """
    filled = cells[~are_blank(cells)]
    first = None if filled.empty else _WITH_UNIT.fullmatch(filled.iloc[0])
    if first is None and not (filled.str.endswith("%") | filled.str.endswith("\u00b0")).any():
        return cells, ""
    parts = cells.str.extract(f"^{_WITH_UNIT.pattern}$")
    units = set(parts[1].dropna().str.strip())
    has_unit = parts[1].notna()
    is_same = len(units) == 1 and (units <= {"%", "\u00b0"} or has_unit[filled.index].all())
    return (parts[0].where(has_unit, cells), units.pop()) if is_same else (cells, "")


def find_units(cells: pd.Series) -> list[str]:
    """The units that follow the numbers of a column's cells; empty unless each number has one."""
    units = cells[cells != ""].str.extract(f"^{_WITH_UNIT.pattern}$")[1]
    return sorted(set(units.str.strip())) if units.notna().all() else []


def find_form(cells: pd.Series) -> NumberForm | None:
    """The form that a column's cells are written in; None if several fit.

    Cells without a decimal or thousands sign fit any form.
    """
    has_point = cells.str.contains(".", regex=False)
    if len(cells) > 2 * _FIRST_CELLS:
        first = find_form(cells[:_FIRST_CELLS])
        if first == POINT and not cells.str.contains(",", regex=False).any():
            return POINT
    if not cells.str.contains(",", regex=False).any():
        # A point is decimal unless the column proves otherwise.
        return None if _are_thousands(cells[has_point]) else POINT
    seen = cells[cells.str.fullmatch(_ANY_NUMBER)]
    marked = {sign: seen[seen.str.contains(sign, regex=False)] for sign in ".,"}
    for text in marked[","][marked[","].str.contains(".", regex=False)]:
        return NumberForm(".", ",") if text.rfind(".") > text.rfind(",") else NumberForm(",", ".")
    for sign, other in ((",", "."), (".", ",")):
        if (marked[sign].str.count(re.escape(sign)) > 1).any():
            return NumberForm(other, sign)
        if len(marked[sign]) and not _are_thousands(marked[sign]):
            return NumberForm(sign, other if len(marked[other]) else "")
    return None


def _are_thousands(cells: pd.Series) -> bool:
    """Whether the sign in every cell may separate thousands."""
    return len(cells) > 0 and bool(cells.str.fullmatch(_THOUSANDS).all())


def settle_form(cells: pd.Series, likely: NumberForm | None, name: str) -> NumberForm:
    """The form of a column whose own cells do not settle it.

    Args:
        cells: of the column.
        likely: form of the file's other columns, if they have one.
        name: of the column, for the message.

    Raises:
        RefusedTableError: several forms fit.
    """
    has_comma = cells.str.contains(",", regex=False)
    sign = "," if has_comma.any() else "."
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
    example = str(cells[has_comma].iloc[0])
    raise RefusedTableError(
        f"column {name!r}: is {example!r} {example.replace(sign, '')} or {example.replace(',', '.')}? "
        "Give --decimal point or --decimal comma"
    )


def _relative_travel(values: Array) -> float:
    known = values[np.isfinite(values)]
    span = float(np.ptp(known)) if known.size else 0.0
    return float(np.sum(np.abs(np.diff(known)))) / span if span > 0.0 else math.inf


def parse_cells(cells: pd.Series, form: NumberForm) -> Array:
    """Cells as numbers, (rows,); nan where one holds no number of this form."""
    if form == POINT:
        values = pd.to_numeric(cells, errors="coerce").to_numpy(np.float64, copy=True)
        if np.all(np.isfinite(values)):
            return values
    group = "[ '\u2019" + re.escape(form.thousands) + "]"
    decimal = re.escape(form.decimal)
    whole = rf"(?:\d+|\d{{1,3}}(?:{group}\d{{3}})+)"
    is_of_form = cells.str.fullmatch(rf"[+-]?(?:{whole}(?:{decimal}\d*)?|{decimal}\d+){_EXPONENT}")
    plain = cells.where(is_of_form, "").str.replace(group, "", regex=True)
    plain = plain.str.replace(form.decimal, ".", regex=False).str.replace("[dD]", "e", regex=True)
    return pd.to_numeric(plain, errors="coerce").to_numpy(np.float64, copy=True)


_CLOCK: Final = (
    r"^(?:\D*?(?P<day>\d{1,4}[./-](?:\d{1,2}|[A-Za-z]{3})[./-]\d{2,4})[ T,;]+|(?P<days>\d+) days? |)"
    r"(?:(?P<hours>\d+):)?(?P<minutes>\d+):(?P<seconds>\d+(?:[.,]\d+|:\d{3})?)"
    r"\s*(?P<half>[AaPp])?[Mm.]*\s*(?:Z|UTC)?$"
)
_DAY_FIRST: Final = ("%d{0}%m{0}%Y", "%d{0}%m{0}%y")
_MONTH_FIRST: Final = ("%m{0}%d{0}%Y", "%m{0}%d{0}%y")
_EITHER: Final = ("%Y{0}%m{0}%d", "%d{0}%b{0}%Y", "%d{0}%b{0}%y")
_DAY_S: Final = 86400.0


def parse_times_s(cells: pd.Series) -> Array:
    """Seconds of dates and times, or of times of day, (rows,); nan where a cell is neither.

    Days are written before months with points; with slashes the order follows from a number above 12.
    Times of day that pass midnight go on.

    Raises:
        RefusedTableError: the day changes and either number may be the month.
    """
    text = cells.str.replace(r",(\d+)", r".\1", n=1, regex=True)
    stamps = pd.to_datetime(text, format="ISO8601", utc=True, errors="coerce")
    if stamps.notna().any():
        # Only differences matter: a time without a zone may be read as UTC.
        return ((stamps - stamps.min()) / pd.Timedelta(seconds=1)).to_numpy(np.float64, copy=True)
    parts = cells.str.extract(_CLOCK)
    hours = pd.to_numeric(parts["hours"]).fillna(0.0)
    late = parts["half"].str.lower().map({"p": 12.0, "a": 0.0})
    hours = hours.where(late.isna(), hours % 12.0 + late.fillna(0.0))
    seconds = pd.to_numeric(parts["seconds"].str.replace("[,:]", ".", regex=True))
    values = 3600.0 * hours + 60.0 * pd.to_numeric(parts["minutes"]) + seconds
    values = (values + _DAY_S * pd.to_numeric(parts["days"]).fillna(0.0)).to_numpy(
        np.float64, copy=True
    )
    days = parts["day"].dropna().unique()
    if len(days):
        midnights_s = _parse_days_s([str(day) for day in days])
        return values + parts["day"].map(midnights_s).fillna(0.0).to_numpy(np.float64, copy=True)
    for row in np.flatnonzero(np.diff(values) < -0.5 * _DAY_S):
        values[row + 1 :] += _DAY_S
    return values


def _parse_days_s(days: list[str]) -> dict[str, float]:
    """Seconds of each day's midnight; nan where it is none.

    Raises:
        RefusedTableError: there are several days, and either number may be the month.
    """
    sign = next(one for one in days[0] if one in "./-")
    texts = pd.Series(days)
    readings: list[pd.Series] = []
    for forms in (_DAY_FIRST, _MONTH_FIRST, _EITHER):
        for form in forms:
            found = pd.to_datetime(texts, format=form.format(sign), errors="coerce")
            if found.notna().all():
                readings.append(found)
                break
    if not readings:
        return dict.fromkeys(days, math.nan)
    if len(days) > 1 and len(readings) > 1 and sign != ".":
        raise RefusedTableError(
            f"in the date {days[0]!r} either number may be the month, and the day changes: write dates as "
            "2021-01-20"
        )
    midnights = (readings[0] - pd.Timestamp(0)) / pd.Timedelta(seconds=1)
    return dict(zip(days, midnights, strict=True))
