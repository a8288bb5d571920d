"""Surveyed ground as CSV: a grid of heights, or a cloud of points that is put on a grid.

Both have the header ``x_m,y_m,z_m``. A grid has one line a cell, a cloud any number of points a cell, of
which the median counts.
"""

import csv
import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from bulk.height_field import Grid, make_grid
from machine.conventions import Array, IntArray
from machine.errors import UsageError

COLUMNS = ("x_m", "y_m", "z_m")
MAX_POINT_COUNT = 2_000_000
MAX_HEIGHT_M = 50.0
MAX_EXTENT_M = 120.0
"""Larger areas or heights are most likely in other units or in a national grid."""


def read_survey(path: Path, cell_m: float) -> tuple[Grid, Array]:
    """Grid and heights (rows, columns) of a survey, frame `machine`.

    Raises:
        UsageError: not such a file, other units, too large, or holes; with numbers.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            return parse_survey(file, str(path), cell_m)
    except OSError as error:
        raise UsageError(f"{path} cannot be read: {error.strerror}") from error


def parse_survey(lines: Iterable[str], path: str, cell_m: float) -> tuple[Grid, Array]:
    """Grid and heights (rows, columns) of a survey's lines, frame `machine`.

    Args:
        lines: of the CSV text.
        path: what people call it.
        cell_m: size of the cells.

    Raises:
        UsageError: no such text, other units, too large, or holes; with numbers.
    """
    points = _read_points(lines, path)
    for axis, name in enumerate("xy"):
        extent = float(np.ptp(points[:, axis]))
        if extent > MAX_EXTENT_M:
            raise UsageError(
                f"{path}: {name} spans {extent:.0f} m, at most {MAX_EXTENT_M:.0f} m are expected; are these "
                "millimetres or feet? Give metres"
            )
        if float(np.abs(points[:, axis]).max()) > MAX_EXTENT_M:
            raise UsageError(
                f"{path}: {name} reaches {np.abs(points[:, axis]).max():.0f} m from the machine; give "
                "coordinates from the slew axis, x forward and y to the left"
            )
    height = float(np.abs(points[:, 2]).max())
    if height > MAX_HEIGHT_M:
        raise UsageError(
            f"{path}: z reaches {height:.0f} m, at most {MAX_HEIGHT_M:.0f} m are expected; give metres above "
            "the ground at the machine"
        )
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    grid = make_grid((float(low[0]), float(high[0])), (float(low[1]), float(high[1])), cell_m)
    column = np.rint((points[:, 0] - grid.x0_m) / cell_m).astype(int)
    row = np.rint((points[:, 1] - grid.y0_m) / cell_m).astype(int)
    inside = (row < grid.row_count) & (column < grid.column_count)
    cell = row[inside] * grid.column_count + column[inside]
    heights = _medians(cell, points[inside, 2], grid.row_count * grid.column_count)
    holes = np.flatnonzero(np.isnan(heights))
    if holes.size:
        first = divmod(int(holes[0]), grid.column_count)
        raise UsageError(
            f"{path} has no point in {holes.size} of {heights.size} cells of {cell_m:g} m, the first at "
            f"x {grid.x_m[first[1]]:.2f} m, y {grid.y_m[first[0]]:.2f} m; survey the holes, choose larger "
            "cells (cell_m) or cut the area"
        )
    return grid, heights.reshape(grid.row_count, grid.column_count)


def _read_points(text: Iterable[str], path: str) -> Array:
    points: list[tuple[float, float, float]] = []
    try:
        lines = csv.reader(text)
        header = [name.strip() for name in next(lines, [])]
        if tuple(header) != COLUMNS:
            raise UsageError(
                f"{path}: its first line is {','.join(header)[:60]!r}, not {','.join(COLUMNS)}; the "
                "columns are metres, frame machine"
            )
        for number, cells in enumerate(lines, start=2):
            points.append(_point(path, number, cells))
            if len(points) > MAX_POINT_COUNT:
                raise UsageError(f"{path} has more than {MAX_POINT_COUNT} points; thin it out")
    except (UnicodeDecodeError, csv.Error) as error:
        raise UsageError(f"{path} is no CSV text: {error}") from error
    if len(points) < 4:
        raise UsageError(f"{path} has {len(points)} points, 4 or more are needed")
    return np.array(points, dtype=np.float64)


def _point(path: str, number: int, cells: list[str]) -> tuple[float, float, float]:
    try:
        x, y, z = (float(cell) for cell in cells)
    except ValueError:
        raise UsageError(
            f"{path}, line {number}: {','.join(cells)[:60]!r} are not three numbers"
        ) from None
    if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
        raise UsageError(f"{path}, line {number}: a coordinate is not finite")
    return x, y, z


def _medians(cell: IntArray, z_m: Array, count: int) -> Array:
    """Median of the values of each cell (count); NaN for cells without any."""
    order = np.lexsort((z_m, cell))
    cells, z = cell[order], z_m[order]
    found, first, size = np.unique(cells, return_index=True, return_counts=True)
    result = np.full(count, np.nan)
    result[found] = 0.5 * (z[first + (size - 1) // 2] + z[first + size // 2])
    return result
