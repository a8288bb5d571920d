"""Units of a table's columns: angles, lengths and counts to rad and metres, wraps undone, stray values found.

What was converted is noted.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Final, Literal

import numpy as np
from scipy.ndimage import median_filter

from diagnosis.alone.reading.layout import RefusedTableError
from diagnosis.alone.reading.tables import Table, has_degrees
from machine.conventions import Array, BoolArray

AngleUnit = Literal["auto", "rad", "deg"]
LENGTHS_M: Final[Mapping[str, float]] = {
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), 1.0),
    **dict.fromkeys(("cm", "centimeters", "centimetres"), 0.01),
    **dict.fromkeys(("mm", "millimeters", "millimetres"), 0.001),
    **dict.fromkeys(("ft", "feet", "foot"), 0.3048),
    **dict.fromkeys(("in", "inch", "inches"), 0.0254),
    **dict.fromkeys(("yd", "yds", "yard", "yards"), 0.9144),
}
PIXEL_WORDS: Final = ("px", "pixel", "pixels", "pix")
COUNT_WORDS: Final = ("count", "counts", "cnt", "ticks", "pulses", "encoder", "enc", "adc", "raw")
TURNS_COUNTS: Final = (
    *(2.0 * math.pi, 360.0, 400.0, 1000.0, 1024.0, 2000.0, 2048.0, 3600.0, 4000.0, 4096.0),
    *(8000.0, 8192.0, 10000.0, 16384.0, 32768.0, 36000.0, 65536.0),
)
"""Turns of usual encoders in their own counts; a wrapped column spans nearly one of them."""
SPIKE_RATIO: Final = 0.05
"""Of the column's span: a value that stands out by less among its neighbours is left in."""
MOST_SPIKES_RATIO: Final = 0.05
"""When more rows stand out, they are the motion and no errors."""


def turn_of(values: Array) -> float | None:
    """What a wrapped column counts in one turn; None if it does not wrap."""
    seen = values[np.isfinite(values)]
    span = float(np.ptp(seen)) if seen.size else 0.0
    if span == 0.0 or not np.any(np.abs(np.diff(seen)) > 0.8 * span):
        return None
    return next((turn for turn in TURNS_COUNTS if 0.95 * turn < span <= 1.02 * turn), None)


def unwrapped(values: Array, turn: float) -> Array:
    """Without jumps of a turn; nan stays nan."""
    out = values.copy()
    known = np.isfinite(values)
    out[known] = np.unwrap(values[known], period=turn)
    return out


def spikes(values: Array) -> BoolArray:
    """(rows,) values far off the lines through their neighbours on both sides, one or two in a row."""
    known = np.flatnonzero(np.isfinite(values))
    found = np.zeros(len(values), dtype=np.bool_)
    if known.size < 20:
        return found
    x = values[known]
    third = np.diff(x, n=3)
    noise = 1.4826 * float(np.median(np.abs(third - np.median(third)))) / math.sqrt(20.0)
    low, high = np.quantile(x, [0.05, 0.95])
    limit = max(10.0 * noise, SPIKE_RATIO * float(high - low))
    suspect = np.abs(x - median_filter(x, 5, mode="nearest")) > limit
    if not np.any(suspect) or np.mean(suspect) > MOST_SPIKES_RATIO:
        return found
    kept = np.flatnonzero(~suspect)
    for row in np.flatnonzero(suspect):
        # A corner, as of a bounce, lies on the line of either side; a stray value on neither.
        place = int(np.searchsorted(kept, row))
        sides = (kept[max(place - 2, 0) : place], kept[place : place + 2])
        lines = [np.polyfit(side, x[side], 1) for side in sides if len(side) == 2]
        found[known[row]] = all(
            abs(float(np.polyval(line, row)) - x[row]) > limit for line in lines
        )
    return found


def without_spikes(table: Table, name: str, values: Array) -> Array:
    """Stray values made nan, noted."""
    wrong = spikes(values)
    if np.any(wrong):
        table.notes.append(f"{name!r}: {int(np.sum(wrong))} stray values left out")
    return np.where(wrong, np.nan, values)


def motion_in_si(table: Table, name: str, values: Array, is_speed: bool) -> tuple[Array, str]:
    """A joint's position or speed in rad or m, wraps undone, stray values out; the unit that results."""
    words = table.words(name)
    unit, factor, from_unit = "unit", 1.0, ""
    lengths = [word for word in words[1:] if word in LENGTHS_M]
    if "rpm" in words:
        unit, factor, from_unit = "rad", math.pi / 30.0, "rpm"
    elif has_degrees(words):
        unit, factor, from_unit = "rad", math.pi / 180.0, "degrees"
    elif has_degrees(words) is False:
        unit = "rad"
    elif lengths:
        unit, factor = "m", LENGTHS_M[lengths[-1]]
        from_unit = "" if factor == 1.0 else lengths[-1]
    if from_unit:
        table.notes.append(f"{name!r} converted from {from_unit} to {unit}")
    if not is_speed and (turn := turn_of(values)) is not None:
        jumps = int(np.sum(np.abs(np.diff(values[np.isfinite(values)])) > 0.8 * turn))
        values = unwrapped(values, turn)
        label = "2 pi" if turn < 7.0 else f"{turn:g}"
        table.notes.append(f"{name!r}: {jumps} jumps of {label} unwrapped")
        if unit == "unit" and turn > 360.0:
            unit, factor = "rad", 2.0 * math.pi / turn
            table.notes.append(f"{name!r} converted from {turn:g} counts a turn to rad")
    return without_spikes(table, name, values * factor), unit


def in_radians(
    table: Table, name: str, values: Array, unit: AngleUnit, counts_per_turn: float | None = None
) -> Array:
    """An angle column in rad, without jumps; without a unit in its name more than a turn means degrees.

    Raises:
        RefusedTableError: it counts something, and nothing says how many make a turn.
    """
    words = table.words(name)
    degrees = has_degrees(words) if unit == "auto" else unit == "deg"
    turn = counts_per_turn
    if turn is None and degrees is None and any(word in COUNT_WORDS for word in words):
        turn = turn_of(values)
        if turn is None and float(np.nanmax(np.abs(values))) > 360.0:
            raise RefusedTableError(
                f"column {name!r} counts up to {np.nanmax(np.abs(values)):.6g}: how many make a turn? Give "
                "--counts-per-turn (4096 for an encoder of 12 bits, four times the lines of a disk)"
            )
    if turn is not None and turn > 360.0:
        table.notes.append(f"{name!r} converted from {turn:g} counts a turn to rad")
        return without_spikes(table, name, unwrapped(values, turn) * (2.0 * math.pi / turn))
    if degrees is None:
        degrees = bool(np.nanmax(np.abs(values)) > 2.0 * math.pi + 0.1)
        seen = "degrees: it exceeds 2 pi" if degrees else "rad"
        table.notes.append(f"{name!r} taken as {seen}; --angle-unit says otherwise")
    if (turn := turn_of(values)) is not None:
        values = unwrapped(values, turn)
    return without_spikes(table, name, np.radians(values) if degrees else values)


def are_pixels(table: Table, names: Sequence[str], unit: str) -> bool:
    """Whether positions are in pixels, by the unit given or by the columns' names."""
    if unit != "auto":
        return unit == "px"
    # A column called px alone is the position along x.
    return any(word in PIXEL_WORDS for name in names for word in table.words(name)[1:])


def metres(table: Table, name: str, unit: str) -> float:
    """Metres in a column's unit; 1 for pixels, whose scale gravity gives."""
    if unit != "auto":
        return LENGTHS_M.get(unit, 1.0)
    named = [word for word in table.words(name)[1:] if word in LENGTHS_M]
    if named and LENGTHS_M[named[-1]] != 1.0:
        table.notes.append(f"{name!r} converted from {named[-1]} to m")
    return LENGTHS_M[named[-1]] if named else 1.0


def is_length(table: Table, name: str) -> bool:
    """Whether a column's name says that it is a distance and no angle."""
    words = table.words(name)
    return has_degrees(words) is None and any(word in LENGTHS_M for word in words[1:])
