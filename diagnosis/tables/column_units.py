"""Units of a table's columns: convert angles, lengths and counts to rad and m, unwrap, remove outliers.

Every conversion is noted.
"""

import math
import re
from collections.abc import Mapping, Sequence
from typing import Final, Literal

import numpy as np
from scipy.ndimage import median_filter

from diagnosis.tables.cells import RefusedTableError
from diagnosis.tables.table import ANGLES_RAD, Table, radians_per_unit
from diagnosis.tables.time_series import estimate_noise
from machine.conventions import Array, BoolArray

AngleUnit = Literal["auto", "rad", "deg"]
LENGTHS_M: Final[Mapping[str, float]] = {
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), 1.0),
    **dict.fromkeys(("km", "kilometers", "kilometres"), 1000.0),
    **dict.fromkeys(("dm", "decimeters", "decimetres"), 0.1),
    **dict.fromkeys(("cm", "centimeter", "centimetre", "centimeters", "centimetres"), 0.01),
    **dict.fromkeys(("mm", "millimeter", "millimetre", "millimeters", "millimetres"), 0.001),
    **dict.fromkeys(("um", "µm", "μm", "micron", "microns", "micrometers"), 1e-6),
    **dict.fromkeys(("ft", "feet", "foot"), 0.3048),
    **dict.fromkeys(("in", "inch", "inches"), 0.0254),
    **dict.fromkeys(("yd", "yds", "yard", "yards"), 0.9144),
    **dict.fromkeys(("kmh", "kph", "kmph"), 1.0 / 3.6),
    "mph": 0.44704,
}
"""Metres per unit of length, or m/s per unit of speed."""
_PER_TIME: Final = re.compile(r"(?:/ ?|\bper[ _])(?:(h|hr|hour)|(min|minute))\b")
PIXEL_WORDS: Final = ("px", "pixel", "pixels", "pix")
"""Names of pixels as a unit."""
COUNT_WORDS: Final = ("count", "counts", "cnt", "ticks", "pulses", "encoder", "enc", "adc", "raw")
"""Names of encoder counts and other raw values."""
WRAP_PERIODS: Final = (
    *(2.0 * math.pi, 360.0, 400.0, 1000.0, 1024.0, 2000.0, 2048.0, 3600.0, 4000.0, 4096.0),
    *(8000.0, 8192.0, 10000.0, 16384.0, 32768.0, 36000.0, 65536.0),
)
"""Range of usual encoders in their own units; a wrapped column spans nearly one of them."""
OUTLIER_RATIO: Final = 0.05
"""Smallest deviation of an outlier, as a share of the column's 5 to 95 % range."""
MAX_OUTLIERS_RATIO: Final = 0.05
"""If more rows deviate, they belong to the motion and none is removed."""


def find_wrap_period(values: Array) -> float | None:
    """Period of a wrapped column in its own unit; None if it does not wrap."""
    seen = values[np.isfinite(values)]
    span = float(np.ptp(seen)) if seen.size else 0.0
    if span == 0.0 or not np.any(np.abs(np.diff(seen)) > 0.8 * span):
        return None
    return next((turn for turn in WRAP_PERIODS if 0.95 * turn < span <= 1.02 * turn), None)


def unwrap_angle(values: Array, turn: float) -> Array:
    """Remove jumps of one period; nan stays nan."""
    out = values.copy()
    known = np.isfinite(values)
    out[known] = np.unwrap(values[known], period=turn)
    return out


def find_outliers(values: Array) -> BoolArray:
    """Mask of outliers, (rows,): one or two rows far off the lines through the neighbours on both sides."""
    known = np.flatnonzero(np.isfinite(values))
    found = np.zeros(len(values), dtype=np.bool_)
    if known.size < 20:
        return found
    x = values[known]
    noise = estimate_noise([x])
    low, high = np.quantile(x, [0.05, 0.95])
    limit = max(10.0 * noise, OUTLIER_RATIO * float(high - low))
    is_candidate = np.abs(x - median_filter(x, 5, mode="nearest")) > limit
    if not np.any(is_candidate) or np.mean(is_candidate) > MAX_OUTLIERS_RATIO:
        return found
    kept = np.flatnonzero(~is_candidate)
    for row in np.flatnonzero(is_candidate):
        # A corner, as at a bounce, lies on the line of one side; an outlier on neither.
        place = int(np.searchsorted(kept, row))
        sides = (kept[max(place - 2, 0) : place], kept[place : place + 2])
        lines = [np.polyfit(side, x[side], 1) for side in sides if len(side) == 2]
        found[known[row]] = all(
            abs(float(np.polyval(line, row)) - x[row]) > limit for line in lines
        )
    return found


def remove_outliers(table: Table, name: str, values: Array) -> Array:
    """Outliers set to nan and noted."""
    wrong = find_outliers(values)
    if np.any(wrong):
        table.notes.append(f"{name!r}: {int(np.sum(wrong))} stray values left out")
    return np.where(wrong, np.nan, values)


def joint_output_in_si(table: Table, name: str, values: Array, is_speed: bool) -> tuple[Array, str]:
    """A joint's position or velocity in rad or m, unwrapped, without outliers, and the resulting unit."""
    words = table.words(name)
    unit, factor, from_unit = "unit", 1.0, ""
    lengths = [word for word in words[1:] if word in LENGTHS_M]
    per_s = _per_second(table, name) if is_speed else 1.0
    if (radians := radians_per_unit(words)) is not None:
        unit, factor = "rad", radians * per_s
        from_unit = "" if factor == 1.0 else _angle_unit(words)
    elif lengths:
        unit, factor = "m", LENGTHS_M[lengths[-1]] * per_s
        from_unit = "" if factor == 1.0 else lengths[-1]
    if from_unit:
        table.notes.append(f"{name!r} converted from {from_unit} to {unit}")
    if not is_speed and (turn := find_wrap_period(values)) is not None:
        jumps = int(np.sum(np.abs(np.diff(values[np.isfinite(values)])) > 0.8 * turn))
        values = unwrap_angle(values, turn)
        label = "2 pi" if turn < 7.0 else f"{turn:g}"
        table.notes.append(f"{name!r}: {jumps} jumps of {label} unwrapped")
        if unit == "unit" and turn > 360.0:
            unit, factor = "rad", 2.0 * math.pi / turn
            table.notes.append(f"{name!r} converted from {turn:g} counts a turn to rad")
    return remove_outliers(table, name, values * factor), unit


def _angle_unit(words: Sequence[str]) -> str:
    """The unit of angle among a column's words."""
    named = next(word for word in reversed(words) if word in ANGLES_RAD)
    return "degrees" if ANGLES_RAD[named] == ANGLES_RAD["deg"] else named


def _per_second(table: Table, name: str) -> float:
    """Factor to 1/s of a speed in units an hour or a minute, as its name or unit says."""
    found = _PER_TIME.search(f"{name} {table.units.get(name, '')}".lower())
    return 1.0 if found is None else 1.0 / 3600.0 if found[1] else 1.0 / 60.0


def angle_in_radians(
    table: Table, name: str, values: Array, unit: AngleUnit, counts_per_turn: float | None = None
) -> Array:
    """An angle column in rad, unwrapped, without outliers.

    If the name gives no unit, values above one turn mean degrees.

    Raises:
        RefusedTableError: the column holds counts and the counts per turn are not known.
    """
    words = table.words(name)
    factor = radians_per_unit(words) if unit == "auto" else ANGLES_RAD[unit]
    factor = None if factor is None else factor * _per_second(table, name)
    turn = counts_per_turn
    if turn is None and factor is None and any(word in COUNT_WORDS for word in words):
        turn = find_wrap_period(values)
        if turn is None and float(np.nanmax(np.abs(values))) > 360.0:
            raise RefusedTableError(
                f"column {name!r} counts up to {np.nanmax(np.abs(values)):.6g}: how many make a turn? Give "
                "--counts-per-turn (4096 for an encoder of 12 bits, four times the lines of a disk)"
            )
    if turn is not None and turn > 360.0:
        table.notes.append(f"{name!r} converted from {turn:g} counts a turn to rad")
        return remove_outliers(table, name, unwrap_angle(values, turn) * (2.0 * math.pi / turn))
    if factor is None:
        is_large = bool(np.nanmax(np.abs(values)) > 2.0 * math.pi + 0.1)
        factor = ANGLES_RAD["deg" if is_large else "rad"]
        seen = "degrees: it exceeds 2 pi" if is_large else "rad"
        table.notes.append(f"{name!r} taken as {seen}; --angle-unit says otherwise")
    elif factor not in (1.0, ANGLES_RAD["deg"]):
        table.notes.append(f"{name!r} converted from {_angle_unit(words)} to rad")
    if (turn := find_wrap_period(values)) is not None:
        values = unwrap_angle(values, turn)
    return remove_outliers(table, name, values * factor)


def are_pixels(table: Table, names: Sequence[str], unit: str) -> bool:
    """Whether positions are in pixels, by the given unit or by the columns' names."""
    if unit != "auto":
        return unit == "px"
    # A column named just "px" is the position along x.
    return any(word in PIXEL_WORDS for name in names for word in table.words(name)[1:])


def metres_per_unit(table: Table, name: str, unit: str) -> float:
    """Metres per unit of a column; 1 for pixels, which gravity scales later."""
    if unit != "auto":
        return LENGTHS_M.get(unit, 1.0)
    named = [word for word in table.words(name)[1:] if word in LENGTHS_M]
    factor = LENGTHS_M[named[-1]] * _per_second(table, name) if named else 1.0
    if factor != 1.0:
        table.notes.append(f"{name!r} converted from {named[-1]} to m")
    return factor


def is_length(table: Table, name: str) -> bool:
    """Whether a column's name says that it is a length and not an angle."""
    words = table.words(name)
    return radians_per_unit(words) is None and any(word in LENGTHS_M for word in words[1:])
