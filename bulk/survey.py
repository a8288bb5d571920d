"""Surveyed ground: heights on a regular grid, or a cloud of points, on the cells of a job.

As CSV with the header ``x_m,y_m,z_m``, GeoTIFF, LAS or LAZ. A grid that is coarser than the cells is
interpolated; of the points in a cell the median counts.
"""

import csv
import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from bulk.height_field import Grid, make_grid
from bulk.survey_files import Raster, is_survey_file, read_survey_file
from machine.conventions import Array, IntArray
from machine.errors import UsageError

COLUMNS = ("x_m", "y_m", "z_m")
MIN_POINT_COUNT = 4
MAX_POINT_COUNT = 2_000_000
MAX_HEIGHT_M = 50.0
MAX_EXTENT_M = 120.0
"""Larger areas or heights are most likely in other units or in a national grid."""
REPLACED = "\ufffd"
"""What a browser makes of bytes that are no text."""
MAX_SPACING_M = 1.0
"""A coarser grid of heights shows no piles."""


def read_survey(path: Path, cell_m: float) -> tuple[Grid, Array]:
    """Grid and heights (rows, columns) of a survey, frame `machine`.

    Raises:
        UsageError: not such a file, other units, too large, or holes; with numbers.
    """
    try:
        return parse_survey(path.read_bytes(), str(path), cell_m)
    except OSError as error:
        raise UsageError(f"{path} cannot be read: {error.strerror}") from error


def parse_survey(content: bytes, name: str, cell_m: float) -> tuple[Grid, Array]:
    """Grid and heights (rows, columns) of a survey's content, frame `machine`.

    Args:
        content: of the file.
        name: what people call it.
        cell_m: size of the cells.

    Raises:
        UsageError: no survey, other units, too large, or holes; with numbers.
    """
    if is_survey_file(content):
        found = read_survey_file(content, name, MAX_POINT_COUNT)
    else:
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            raise UsageError(f"{name} is no CSV text, GeoTIFF, LAS or LAZ: {error}") from error
        if not text.strip():
            raise UsageError(f"{name} is empty")
        if REPLACED in text or "\0" in text:
            raise UsageError(f"{name} is no CSV text, GeoTIFF, LAS or LAZ")
        found = _read_points(text.splitlines(), name)
    raster = found if isinstance(found, Raster) else _regular(found)
    if raster is not None:
        _require_place(raster.x_m, raster.y_m, raster.z_m[np.isfinite(raster.z_m)], name)
        spacing_m = max(float(np.diff(raster.x_m).max()), float(np.diff(raster.y_m).max()))
        if spacing_m > MAX_SPACING_M:
            raise UsageError(
                f"{name} has a height every {spacing_m:.2f} m, at most {MAX_SPACING_M:.0f} m are expected"
            )
        if spacing_m > cell_m * (1.0 + 1e-6):
            return _interpolated(raster, name, cell_m)
        x, y = np.meshgrid(raster.x_m, raster.y_m)
        found = np.stack([x, y, raster.z_m], axis=-1).reshape(-1, 3)
        found = found[np.isfinite(found[:, 2])]
    points = np.asarray(found)
    _require_place(points[:, 0], points[:, 1], points[:, 2], name)
    return _gridded(points, name, cell_m)


def _require_place(x_m: Array, y_m: Array, z_m: Array, name: str) -> None:
    """Refuse coordinates that are no metres, or not those of the machine."""
    if min(len(x_m), len(y_m)) < 2 or len(z_m) < MIN_POINT_COUNT:
        raise UsageError(f"{name} has {len(z_m)} points, {MIN_POINT_COUNT} or more are needed")
    if not all(np.isfinite(values).all() for values in (x_m, y_m, z_m)):
        raise UsageError(f"{name} has coordinates that are not finite numbers")
    for values, axis in ((x_m, "x"), (y_m, "y")):
        extent = float(np.ptp(values))
        if extent > MAX_EXTENT_M:
            raise UsageError(
                f"{name}: {axis} spans {extent:.0f} m, at most {MAX_EXTENT_M:.0f} m are expected; are these "
                "millimetres or feet? Give metres"
            )
        if float(np.abs(values).max()) > MAX_EXTENT_M:
            raise UsageError(
                f"{name}: {axis} reaches {np.abs(values).max():.0f} m from the machine; give "
                "coordinates from the slew axis, x forward and y to the left"
            )
    height = float(np.abs(z_m).max())
    if height > MAX_HEIGHT_M:
        raise UsageError(
            f"{name}: z reaches {height:.0f} m, at most {MAX_HEIGHT_M:.0f} m are expected; give metres above "
            "the ground at the machine"
        )


def _regular(points: Array) -> Raster | None:
    """The raster of points (N, 3) that have one height at every node of a regular grid; None for a cloud."""
    x_m, column = np.unique(points[:, 0].round(4), return_inverse=True)
    y_m, row = np.unique(points[:, 1].round(4), return_inverse=True)
    if len(x_m) < 2 or len(y_m) < 2 or len(x_m) * len(y_m) != len(points):
        return None
    z_m = np.full((len(y_m), len(x_m)), np.nan)
    z_m[row, column] = points[:, 2]
    steps = np.concatenate([np.diff(x_m), np.diff(y_m)])
    is_even = np.ptp(steps) <= 0.01 * float(steps.max())
    return Raster(x_m, y_m, z_m) if is_even and np.isfinite(z_m).all() else None


def _interpolated(raster: Raster, name: str, cell_m: float) -> tuple[Grid, Array]:
    """Heights between those of a coarser raster, linear along both axes."""
    x, y = raster.x_m, raster.y_m
    grid = make_grid(_whole(x, cell_m), _whole(y, cell_m), cell_m)
    rows = np.array([np.interp(grid.x_m, x, line) for line in raster.z_m])
    heights = np.array([np.interp(grid.y_m, y, line) for line in rows.T]).T
    _require_whole(grid, heights, name)
    return grid, heights


def _whole(axis_m: Array, cell_m: float) -> tuple[float, float]:
    """First and last centre of whole cells between the ends of an axis."""
    low = float(axis_m.min())
    return low, low + cell_m * math.floor(float(np.ptp(axis_m)) / cell_m + 1e-6)


def _gridded(points: Array, name: str, cell_m: float) -> tuple[Grid, Array]:
    """Medians of points (N, 3) in cells."""
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    grid = make_grid((float(low[0]), float(high[0])), (float(low[1]), float(high[1])), cell_m)
    column = np.rint((points[:, 0] - grid.x0_m) / cell_m).astype(int)
    row = np.rint((points[:, 1] - grid.y0_m) / cell_m).astype(int)
    inside = (row < grid.row_count) & (column < grid.column_count)
    cell = row[inside] * grid.column_count + column[inside]
    heights = _medians(cell, points[inside, 2], grid.row_count * grid.column_count)
    heights = heights.reshape(grid.row_count, grid.column_count)
    _require_whole(grid, heights, name)
    return grid, heights


def _require_whole(grid: Grid, heights: Array, name: str) -> None:
    holes = np.argwhere(np.isnan(heights))
    if len(holes):
        row, column = holes[0]
        raise UsageError(
            f"{name} has no point in {len(holes)} of {heights.size} cells of {grid.cell_m:g} m, the first at "
            f"x {grid.x_m[column]:.2f} m, y {grid.y_m[row]:.2f} m; survey the holes, cut the "
            "area, or give larger cells (cell_m of the job file)"
        )


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
    except csv.Error as error:
        raise UsageError(f"{path} is no CSV text: {error}") from error
    return np.array(points, dtype=np.float64).reshape(-1, 3)


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
