"""The angle of a swing out of a table: an angle, a gyro's rates, a tracked bob, or a mass on a spring.

A gyro that is mounted askew is turned to the axis of the swing; a bob's pivot is found from its path.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from diagnosis.alone.reading.columns import axes_of, is_turn_rate
from diagnosis.alone.reading.layout import RefusedTableError
from diagnosis.alone.reading.tables import Table
from diagnosis.alone.reading.units import (
    AngleUnit,
    in_radians,
    is_length,
    metres,
    spikes,
    without_spikes,
)
from machine.conventions import Array

ANGLE_WORDS: Final = (
    *("angle", "theta", "swing", "pitch", "phi", "position", "pos", "encoder", "q", "winkel"),
    *("roll", "yaw", "euler", "counts", "displacement", "alpha"),
)
CLEAR_RATIO: Final = 4.0
"""Variance of the axis of the swing over that of the next: below this it is not one plane swing."""
ARC_NOISES: Final = 8.0
"""Depth of a bob's arc over its noise from which its pivot can be found."""


class SwingColumn(NamedTuple):
    """What swings."""

    name: str
    values: Array
    """(rows,) rad, rad/s or m."""
    is_rate: bool
    is_length: bool


def swing_column(
    table: Table, time: str, angle: str | None, unit: AngleUnit, counts_per_turn: float | None
) -> SwingColumn:
    """The column that swings, in SI.

    Raises:
        RefusedTableError: no column, or several that could be.
    """
    if angle is None and (found := _from_several(table, time)) is not None:
        return found
    name = angle or _guessed(table, time)
    values = table.numbers(name)
    if is_length(table, name) and unit == "auto":
        values = without_spikes(table, name, values * metres(table, name, "auto"))
        table.notes.append(f"{name!r} taken as a way in m: a mass on a spring, no pendulum")
        return SwingColumn(name, values, is_rate=False, is_length=True)
    is_rate = is_turn_rate(table, name)
    values = in_radians(table, name, values, unit, counts_per_turn)
    return SwingColumn(name, values, is_rate, is_length=False)


def _guessed(table: Table, time: str) -> str:
    rates = [n for n in table.columns if n != time and is_turn_rate(table, n)]
    try:
        return table.guess("angle", "--angle", ANGLE_WORDS, (time, *rates))
    except RefusedTableError:
        if len(rates) == 1:
            return rates[0]
        others = [n for n in table.columns if n != time and table.is_numeric(n)]
        if len(others) == 1:
            table.notes.append(f"column {others[0]!r} taken as the angle: no other fits")
            return others[0]
        raise


def _from_several(table: Table, time: str) -> SwingColumn | None:
    """An angle made of several columns: three angles or rates, or a tracked bob; None if one is enough."""
    others = [n for n in table.columns if n != time and table.is_numeric(n)]
    rates = [n for n in others if is_turn_rate(table, n)]
    angles = [n for n in others if n not in rates and any(w in ANGLE_WORDS for w in table.words(n))]
    rates = [n for n in rates if not {"absolute", "norm", "magnitude"} & set(table.words(n))]
    if len(angles) > 1:
        return _largest(table, angles)
    if not angles and len(rates) > 1:
        return _main_turn(table, rates)
    return None if angles or rates else _bob(table)


def _largest(table: Table, names: list[str]) -> SwingColumn | None:
    """The angle that swings, when the others hardly move."""
    spread = [float(np.nanvar(table.numbers(name))) for name in names]
    order = np.argsort(spread)[::-1]
    if spread[order[0]] < CLEAR_RATIO * spread[order[1]]:
        return None
    name = names[int(order[0])]
    table.notes.append(f"column {name!r} taken as the angle: it swings, the others hardly move")
    values = in_radians(table, name, table.numbers(name), "auto")
    return SwingColumn(name, values, is_rate=False, is_length=False)


def _main_turn(table: Table, names: list[str]) -> SwingColumn | None:
    """Rates about the axis about which most of the turning happens (principal axis)."""
    rates = np.stack([in_radians(table, n, table.numbers(n), "auto") for n in names[:3]], axis=1)
    known = rates[np.all(np.isfinite(rates), axis=1)]
    size, axes = np.linalg.eigh(np.cov((known - np.mean(known, axis=0)).T))
    if size[-1] < CLEAR_RATIO * size[-2]:
        return None
    axis = axes[:, -1] * np.sign(axes[int(np.argmax(np.abs(axes[:, -1]))), -1])
    table.notes.append(
        f"columns {', '.join(names[:3])} taken together about the axis of the swing "
        f"({', '.join(f'{a:.2f}' for a in axis)})"
    )
    return SwingColumn(", ".join(names[:3]), rates @ axis, is_rate=True, is_length=False)


def _bob(table: Table) -> SwingColumn | None:
    """The angle of a tracked bob about the centre of its arc (circle by least squares, Kasa 1976)."""
    try:
        names = axes_of(table)
    except RefusedTableError:
        return None
    if len(names) < 2:
        return None
    x, y = (table.numbers(n) * metres(table, n, "auto") for n in (names[0], names[-1]))
    known = np.isfinite(x) & np.isfinite(y) & ~spikes(x) & ~spikes(y)
    matrix = np.stack([x[known], y[known], np.ones(int(np.sum(known)))], axis=1)
    solved, *_ = np.linalg.lstsq(matrix, -(x[known] ** 2 + y[known] ** 2), rcond=None)
    centre = -0.5 * solved[:2]
    radius = math.sqrt(max(float(centre @ centre - solved[2]), 0.0))
    off = np.hypot(x[known] - centre[0], y[known] - centre[1]) - radius
    depth = radius - math.sqrt(max(radius**2 - 0.25 * float(np.ptp(x[known])) ** 2, 0.0))
    if depth < ARC_NOISES * float(np.std(off)):
        table.notes.append(
            f"the arc of {', '.join(names)} is too flat for a pivot: {names[0]!r} alone"
        )
        return SwingColumn(names[0], np.where(known, x, np.nan), is_rate=False, is_length=True)
    down = float(np.sign(np.median(y[known]) - centre[1])) or -1.0
    angle = np.where(known, np.arctan2(x - centre[0], down * (y - centre[1])), np.nan)
    table.notes.append(
        f"{', '.join(names)} taken as a bob on a circle about ({centre[0]:.4g}, {centre[1]:.4g}), "
        f"radius {radius:.4g}"
    )
    return SwingColumn(", ".join(names), angle, is_rate=False, is_length=False)
