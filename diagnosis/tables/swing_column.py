"""The deflection of a swing from a table: an angle, gyro rates, a tracked bob, or a mass on a spring.

Rates of a gyro are projected on the axis of the swing. The pivot of a bob is found from its arc.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from diagnosis.tables.cells import RefusedTableError
from diagnosis.tables.column_units import (
    AngleUnit,
    angle_in_radians,
    find_outliers,
    is_length,
    metres_per_unit,
    remove_outliers,
)
from diagnosis.tables.columns import find_axis_columns, is_angular_rate
from diagnosis.tables.table import Table
from machine.conventions import Array

ANGLE_WORDS: Final = (
    *("angle", "theta", "swing", "pitch", "phi", "position", "pos", "encoder", "q", "winkel"),
    *("roll", "yaw", "euler", "counts", "displacement", "alpha"),
)
"""Names of angle columns."""
MAIN_AXIS_RATIO: Final = 4.0
"""Smallest ratio of the variances along the main and the second axis of a plane swing."""
MIN_ARC_RATIO: Final = 8.0
"""Smallest depth of a bob's arc, in standard deviations about it, from which the pivot is found."""


class SwingColumn(NamedTuple):
    """The deflection of a swing."""

    name: str
    values: Array
    """(rows,) rad, rad/s or m."""
    is_rate: bool
    is_length: bool


def find_swing_column(
    table: Table, time: str, angle: str | None, unit: AngleUnit, counts_per_turn: float | None
) -> SwingColumn:
    """The deflection column in SI units.

    Raises:
        RefusedTableError: no column fits, or several do.
    """
    if angle is None and (found := _combine_columns(table, time)) is not None:
        return found
    name = angle or _guess_column(table, time)
    values = table.numbers(name)
    if is_length(table, name) and unit == "auto":
        values = remove_outliers(table, name, values * metres_per_unit(table, name, "auto"))
        table.notes.append(f"{name!r} taken as a way in m: a mass on a spring, no pendulum")
        return SwingColumn(name, values, is_rate=False, is_length=True)
    is_rate = is_angular_rate(table, name)
    values = angle_in_radians(table, name, values, unit, counts_per_turn)
    return SwingColumn(name, values, is_rate, is_length=False)


def _guess_column(table: Table, time: str) -> str:
    rates = [n for n in table.columns if n != time and is_angular_rate(table, n)]
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


def _combine_columns(table: Table, time: str) -> SwingColumn | None:
    """A deflection from several columns: angles or rates about several axes, or a tracked bob; else None."""
    others = [n for n in table.columns if n != time and table.is_numeric(n)]
    rates = [n for n in others if is_angular_rate(table, n)]
    angles = [n for n in others if n not in rates and any(w in ANGLE_WORDS for w in table.words(n))]
    rates = [n for n in rates if not {"absolute", "norm", "magnitude"} & set(table.words(n))]
    if len(angles) > 1:
        return _pick_largest_angle(table, angles)
    if not angles and len(rates) > 1:
        return _project_on_main_axis(table, rates)
    return None if angles or rates else _angle_of_bob(table)


def _pick_largest_angle(table: Table, names: list[str]) -> SwingColumn | None:
    """The angle with clearly the largest variance; None if there is none."""
    spread = [float(np.nanvar(table.numbers(name))) for name in names]
    order = np.argsort(spread)[::-1]
    if spread[order[0]] < MAIN_AXIS_RATIO * spread[order[1]]:
        return None
    name = names[int(order[0])]
    table.notes.append(f"column {name!r} taken as the angle: it swings, the others hardly move")
    values = angle_in_radians(table, name, table.numbers(name), "auto")
    return SwingColumn(name, values, is_rate=False, is_length=False)


def _project_on_main_axis(table: Table, names: list[str]) -> SwingColumn | None:
    """Rates projected on their principal axis; None if no axis dominates."""
    rates = np.stack(
        [angle_in_radians(table, n, table.numbers(n), "auto") for n in names[:3]], axis=1
    )
    known = rates[np.all(np.isfinite(rates), axis=1)]
    size, axes = np.linalg.eigh(np.cov((known - np.mean(known, axis=0)).T))
    if size[-1] < MAIN_AXIS_RATIO * size[-2]:
        return None
    axis = axes[:, -1] * np.sign(axes[int(np.argmax(np.abs(axes[:, -1]))), -1])
    table.notes.append(
        f"columns {', '.join(names[:3])} taken together about the axis of the swing "
        f"({', '.join(f'{a:.2f}' for a in axis)})"
    )
    return SwingColumn(", ".join(names[:3]), rates @ axis, is_rate=True, is_length=False)


def _angle_of_bob(table: Table) -> SwingColumn | None:
    """Angle of a tracked bob about the centre of its arc; a displacement in m if the arc is too flat.

    The circle is fitted by linear least squares (Kasa 1976).
    """
    try:
        names = find_axis_columns(table)
    except RefusedTableError:
        return None
    if len(names) < 2:
        return None
    x, y = (table.numbers(n) * metres_per_unit(table, n, "auto") for n in (names[0], names[-1]))
    known = np.isfinite(x) & np.isfinite(y) & ~find_outliers(x) & ~find_outliers(y)
    matrix = np.stack([x[known], y[known], np.ones(int(np.sum(known)))], axis=1)
    solved, *_ = np.linalg.lstsq(matrix, -(x[known] ** 2 + y[known] ** 2), rcond=None)
    centre = -0.5 * solved[:2]
    radius = math.sqrt(max(float(centre @ centre - solved[2]), 0.0))
    off = np.hypot(x[known] - centre[0], y[known] - centre[1]) - radius
    depth = radius - math.sqrt(max(radius**2 - 0.25 * float(np.ptp(x[known])) ** 2, 0.0))
    if depth < MIN_ARC_RATIO * float(np.std(off)):
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
