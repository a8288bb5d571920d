"""Ground and material on a square grid: pouring with slopes at the angle of repose, digging, containers.

Pouring at a point raises the surface h to max(h, c - k d), d being the distance from the point and k the
tangent of the angle of repose; c follows from the volume. This is the quasi-static solution for sand poured
on a support that is not steeper than k (L. Prigozhin, Euro. J. Applied Math. 7, 225, 1996), with Euclidean
distances and therefore without a preferred direction of the grid. Support that is steeper, such as a wall,
cuts the cone off: what overflows it is poured again at the place behind it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import NamedTuple

import numpy as np

from machine.conventions import Array, BoolArray, IntArray
from machine.errors import UsageError

OPEN = -1
"""Container index of open ground."""
WALL = -2
"""Container index of the walls of all containers."""
MAX_CELL_COUNT = 1_000_000
MAX_OVERFLOW_COUNT = 400
DROP_CELLS = 0.5
"""A drop behind a cell counts as an edge from this many cells of slope on: grid distances along a ray are up
to 0.25 cells longer than the straight way. Steps between cells of many loads can be steeper than the angle
of repose by this much."""
MIN_WALL_CELLS = 1.5
"""Thickness below which a diagonal step could pass a wall on the grid."""


class Grid(NamedTuple):
    """Square cells, frame `machine`; rows along y, columns along x."""

    x0_m: float
    """Centre of the first cell."""
    y0_m: float
    cell_m: float
    row_count: int
    column_count: int

    @property
    def cell_area_m2(self) -> float:
        """Area of a cell."""
        return self.cell_m**2

    @property
    def x_m(self) -> Array:
        """(columns) centres."""
        return self.x0_m + self.cell_m * np.arange(self.column_count, dtype=np.float64)

    @property
    def y_m(self) -> Array:
        """(rows) centres."""
        return self.y0_m + self.cell_m * np.arange(self.row_count, dtype=np.float64)

    def cell_of(self, x_m: float, y_m: float) -> tuple[int, int]:
        """Row and column of the cell at a point, which may lie outside of the grid."""
        return round((y_m - self.y0_m) / self.cell_m), round((x_m - self.x0_m) / self.cell_m)

    def holds(self, x_m: float, y_m: float) -> bool:
        """Whether a point lies on a cell."""
        row, column = self.cell_of(x_m, y_m)
        return 0 <= row < self.row_count and 0 <= column < self.column_count


def make_grid(x_m: tuple[float, float], y_m: tuple[float, float], cell_m: float) -> Grid:
    """Grid that covers an area.

    Raises:
        UsageError: empty or too large, with the numbers.
    """
    rows = round((y_m[1] - y_m[0]) / cell_m) + 1
    columns = round((x_m[1] - x_m[0]) / cell_m) + 1
    if rows < 2 or columns < 2 or rows * columns > MAX_CELL_COUNT:
        raise UsageError(
            f"a grid of {columns} x {rows} cells of {cell_m:g} m: it needs 2 x 2 cells or more and at most "
            f"{MAX_CELL_COUNT}; change its area or its cell size"
        )
    return Grid(x_m[0], y_m[0], cell_m, rows, columns)


@dataclass(frozen=True, slots=True)
class Rectangle:
    """A rectangle on the ground, turned about its centre."""

    x_m: float
    y_m: float
    length_m: float
    width_m: float
    turn_rad: float = 0.0
    """Angle of its length from the x axis, positive to the left."""

    def local_m(self, x_m: Array, y_m: Array) -> tuple[Array, Array]:
        """Coordinates along its length and its width (positive to the left), from its centre."""
        dx, dy = x_m - self.x_m, y_m - self.y_m
        cos, sin = math.cos(self.turn_rad), math.sin(self.turn_rad)
        return cos * dx + sin * dy, cos * dy - sin * dx

    def point_m(self, along_m: float, across_m: float) -> tuple[float, float]:
        """The point at local coordinates."""
        cos, sin = math.cos(self.turn_rad), math.sin(self.turn_rad)
        return self.x_m + cos * along_m - sin * across_m, self.y_m + sin * along_m + cos * across_m

    def mask(self, grid: Grid, margin_m: float = 0.0) -> BoolArray:
        """(rows, columns) cells whose centre lies in the rectangle, grown by a margin."""
        along, across = self.local_m(grid.x_m[None, :], grid.y_m[:, None])
        inside = np.abs(along) <= 0.5 * self.length_m + margin_m + 1e-9
        return inside & (np.abs(across) <= 0.5 * self.width_m + margin_m + 1e-9)


@dataclass(frozen=True, slots=True)
class Container:
    """A truck bed or a box, open at the top; lengths are those of its inside."""

    name: str
    inside: Rectangle
    floor_m: float
    wall_m: float
    """Height of the walls above the floor."""
    wall_thickness_m: float = 0.1

    @property
    def top_m(self) -> float:
        """Height of the walls' upper edge."""
        return self.floor_m + self.wall_m


@dataclass(frozen=True, slots=True)
class Dug:
    """Result of a grab: the field without it, and the volume that it took."""

    field: "HeightField"
    volume_m3: float


@dataclass(frozen=True, slots=True)
class HeightField:
    """Surface over a grid. Operations return a new field; the old one is the version before."""

    grid: Grid
    base_m: Array
    """(rows, columns) what does not move: ground, floors, walls."""
    height_m: Array
    """(rows, columns) surface, nowhere below the base."""
    containers: tuple[Container, ...] = ()
    container_index: IntArray = field(default_factory=lambda: np.zeros((0, 0), dtype=np.int64))
    """(rows, columns) index of the container that a cell lies in, `OPEN` or `WALL`."""

    def volume_m3(self, mask: BoolArray | None = None) -> float:
        """Material above the base, in all cells or some of them."""
        depth = self.height_m - self.base_m
        return float((depth if mask is None else depth[mask]).sum()) * self.grid.cell_area_m2

    def inside(self, container: int) -> BoolArray:
        """Cells of a container's inside."""
        return self.container_index == container

    def surface_m(self, x_m: float, y_m: float) -> float | None:
        """Height of the surface at a point; None beside the grid and on walls.

        Linear between the centres of cells that are of one container, or of the open ground.
        """
        if not self.grid.holds(x_m, y_m):
            return None
        here = self.container_index[self.grid.cell_of(x_m, y_m)]
        if here == WALL:
            return None
        row, column = (
            (y_m - self.grid.y0_m) / self.grid.cell_m,
            (x_m - self.grid.x0_m) / self.grid.cell_m,
        )
        total = weight = 0.0
        for i in (math.floor(row), math.floor(row) + 1):
            for j in (math.floor(column), math.floor(column) + 1):
                near = max(1.0 - abs(row - i), 0.0) * max(1.0 - abs(column - j), 0.0)
                inside = 0 <= i < self.grid.row_count and 0 <= j < self.grid.column_count
                if inside and self.container_index[i, j] == here:
                    total, weight = total + near * float(self.height_m[i, j]), weight + near
        return total / weight

    def pour(self, points_m: Array, volume_m3: Array | float, slope_ratio: float) -> "HeightField":
        """Pour material at points, one after the other.

        Args:
            points_m: (N, 2) where it lands. Points beside the grid pour on its nearest cell.
            volume_m3: (N,) or one for all.
            slope_ratio: tangent of the angle of repose.

        Raises:
            UsageError: a volume that is negative or not finite.
        """
        volumes = np.broadcast_to(np.asarray(volume_m3, dtype=np.float64), (len(points_m),))
        if not (
            np.isfinite(volumes).all() and np.isfinite(points_m).all() and (volumes >= 0.0).all()
        ):
            raise UsageError("poured volumes are 0 or more, and their points finite")
        height = self.height_m.copy()
        for (x_m, y_m), volume in zip(points_m.tolist(), volumes.tolist(), strict=True):
            if volume > 0.0:
                _pour(height, self.grid, (x_m, y_m), volume, slope_ratio)
        return replace(self, height_m=height)

    def dig(self, x_m: float, y_m: float, volume_m3: float, slope_ratio: float) -> Dug:
        """Take a volume at a point: a crater whose sides have a slope, down to the base.

        Only material of the same container (or of the open ground) within 3 m is taken; less than the volume
        where there is no more.

        Raises:
            UsageError: the point lies outside of the grid, or the volume is not positive.
        """
        if not self.grid.holds(x_m, y_m) or not volume_m3 > 0.0:
            raise UsageError(
                f"digging {volume_m3:g} m3 at x {x_m:.2f} m, y {y_m:.2f} m is not on the grid"
            )
        row, column = self.grid.cell_of(x_m, y_m)
        d = np.hypot(self.grid.x_m[None, :] - x_m, self.grid.y_m[:, None] - y_m)
        near = (d <= 3.0) & (self.container_index == self.container_index[row, column])
        height, base, rise = self.height_m[near], self.base_m[near], slope_ratio * d[near]
        wanted = volume_m3 / self.grid.cell_area_m2

        def taken(level: float) -> Array:
            return np.maximum(height - np.maximum(base, level + rise), 0.0)

        low, high = float(base.min() - rise.max()), float(height.max())
        for _ in range(80):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if taken(middle).sum() > wanted else (low, middle)
        loss = taken(high)
        dug = self.height_m.copy()
        dug[near] = height - loss
        return Dug(replace(self, height_m=dug), float(loss.sum()) * self.grid.cell_area_m2)


def level_field(
    grid: Grid, containers: Sequence[Container] = (), ground_m: Array | float = 0.0
) -> HeightField:
    """Field of rigid ground with containers on it, without material.

    Raises:
        UsageError: a container that does not lie on the grid or meets another one.
    """
    shape = (grid.row_count, grid.column_count)
    base = np.broadcast_to(np.asarray(ground_m, dtype=np.float64), shape).copy()
    index = np.full(shape, OPEN, dtype=np.int64)
    for number, item in enumerate(containers):
        inside = item.inside.mask(grid)
        outside = item.inside.mask(grid, max(item.wall_thickness_m, MIN_WALL_CELLS * grid.cell_m))
        corners = [
            item.inside.point_m(along * item.inside.length_m, across * item.inside.width_m)
            for along in (-0.5, 0.5)
            for across in (-0.5, 0.5)
        ]
        if not inside.any() or not all(grid.holds(x, y) for x, y in corners):
            low, high = (grid.x_m[0], grid.y_m[0]), (grid.x_m[-1], grid.y_m[-1])
            raise UsageError(
                f"{item.name} does not lie on the survey, which covers x {low[0]:.1f} to {high[0]:.1f} m, "
                f"y {low[1]:.1f} to {high[1]:.1f} m"
            )
        if (index[outside] != OPEN).any():
            raise UsageError(f"{item.name} overlaps another container")
        base[outside], index[outside] = item.top_m, WALL
        base[inside], index[inside] = item.floor_m, number
    return HeightField(grid, base, base.copy(), tuple(containers), index)


class _Window(NamedTuple):
    """Cells around a centre up to a radius, flattened."""

    radius: int
    dx: Array
    dy: Array
    """In cells."""
    ancestors: tuple[IntArray, ...]
    """Cell 1, 2, 4, ... cells nearer to the centre on the same ray."""
    border: IntArray


@cache
def _window(radius: int) -> _Window:
    span = np.arange(-radius, radius + 1)
    dy, dx = (axis.ravel() for axis in np.meshgrid(span, span, indexing="ij"))
    ring = np.maximum(np.abs(dx), np.abs(dy))
    share = np.maximum(ring - 1, 0) / np.maximum(ring, 1)
    parent_x, parent_y = np.rint(dx * share).astype(int), np.rint(dy * share).astype(int)
    step = (parent_y + radius) * span.size + parent_x + radius
    ancestors = [step]
    while 1 << len(ancestors) <= radius:
        ancestors.append(ancestors[-1][ancestors[-1]])
    border = np.flatnonzero(ring == radius)
    return _Window(radius, dx.astype(np.float64), dy.astype(np.float64), tuple(ancestors), border)


def _pour(
    height: Array, grid: Grid, point_m: tuple[float, float], volume_m3: float, slope: float
) -> None:
    """Pour a volume at a point, in place."""
    rest = volume_m3 / grid.cell_area_m2
    x = min(max((point_m[0] - grid.x0_m) / grid.cell_m, 0.0), grid.column_count - 1.0)
    y = min(max((point_m[1] - grid.y0_m) / grid.cell_m, 0.0), grid.row_count - 1.0)
    cone_m = (3.0 * volume_m3 / (math.pi * slope)) ** (1.0 / 3.0)
    start = 4 * math.ceil((1.3 * cone_m / grid.cell_m + 3.0) / 4.0)
    for attempt in range(MAX_OVERFLOW_COUNT):
        overflow, radius = None, start
        may_overflow = attempt < MAX_OVERFLOW_COUNT - 1
        while True:
            done = _fill(height, grid, (x, y), rest, slope, radius, may_overflow=may_overflow)
            if done is not None:
                rest, overflow = done
                break
            radius *= 2
        if overflow is None:
            return
        x, y = overflow


def _fill(
    height: Array, grid: Grid, at: tuple[float, float], rest: float, slope: float, radius: int,
    *, may_overflow: bool,
) -> tuple[float, tuple[float, float] | None] | None:  # fmt: skip
    """Raise the surface around a point (in cells) up to the volume, or to the first edge that overflows.

    Returns:
        What is left (sum of heights) and the cell behind the edge; None where the window is too small.
    """
    window, size = _window(radius), 2 * radius + 1
    column, row = round(at[0]), round(at[1])
    view = np.full((size, size), np.inf)
    rows = slice(max(row - radius, 0), min(row + radius + 1, grid.row_count))
    columns = slice(max(column - radius, 0), min(column + radius + 1, grid.column_count))
    inner = (
        slice(rows.start - row + radius, rows.stop - row + radius),
        slice(columns.start - column + radius, columns.stop - column + radius),
    )
    view[inner] = height[rows, columns]
    rise = slope * grid.cell_m
    cone = rise * np.hypot(window.dx - (at[0] - column), window.dy - (at[1] - row))
    # Level of the cone's apex from which on a cell is covered.
    level = view.ravel() + cone
    needed = level
    for step in window.ancestors:
        needed = np.maximum(needed, needed[step])
    behind = (needed > level + DROP_CELLS * rise) & may_overflow
    overflow_level = float(needed[behind].min()) if behind.any() else math.inf
    open_level = np.where(behind, np.inf, level)
    ordered = np.sort(
        open_level[open_level < min(overflow_level, float(open_level.min()) + rest + 1.0)]
    )
    apex = _water_level(ordered, rest)
    is_whole = radius >= max(height.shape)
    edge = min(apex, overflow_level)
    if not is_whole and bool((open_level[window.border] < edge).any()):
        return None
    overflow = None
    if apex > overflow_level:
        lowest = int(np.where(behind, needed, np.inf).argmin())
        overflow = (column + float(window.dx[lowest]), row + float(window.dy[lowest]))
    gain = np.maximum(edge - open_level, 0.0).reshape(size, size)
    height[rows, columns] += gain[inner]
    return rest - float(gain.sum()), overflow


def _water_level(ordered: Array, volume: float) -> float:
    """Level c at which sum(max(c - level, 0)) is the volume, for increasing levels."""
    if ordered.size == 0:
        return math.inf
    levels = (volume + np.cumsum(ordered)) / np.arange(1, ordered.size + 1)
    covered = np.append(levels[:-1] <= ordered[1:], True)
    return float(levels[int(covered.argmax())])
