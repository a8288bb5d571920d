"""Expected effect of many candidate loads on one surface, in one batch.

A load is poured as one rounded cone max(h, c - k (sqrt(d^2 + s^2) - s)), s being the spread of its grains:
about the mean of many cones around the aimed point. Cells of other regions take nothing; what would rise
above the region's lowest rim, and the share of grains that lands outside of the region, counts as spill.
"""

import math
from typing import NamedTuple

import numpy as np

from bulk.goal import Goal
from bulk.height_field import OPEN, WALL, HeightField
from machine.conventions import Array, IntArray

RIGID_M = 1e6
"""Level of cells that take nothing."""
LEVEL_STEP_COUNT = 8
SPREAD_SIGMAS = 3.0

Single = np.ndarray[tuple[int, ...], np.dtype[np.float32]]
"""Single precision suffices for the comparison of candidates."""


class Candidates(NamedTuple):
    """Places that loads may be thrown at, with windows of cells around them."""

    row: IntArray
    column: IntArray
    """(N) cells."""
    cell: IntArray
    """(N, W) indices of their windows into the padded grid."""
    drop_m: Single
    """(N, W) k (sqrt(d^2 + s^2) - s)."""
    outside_ratio: Single
    """(N) share of a load's grains that lands outside of the goal's region."""
    radius: int


class Effects(NamedTuple):
    """Expected effects of loads: N candidates x V volumes."""

    gain_m: Single
    """(N, V, W) rise of the surface in the candidates' windows."""
    cost: Array
    """(N, V) change of the surface's cost, m3 m."""
    spill_ratio: Array
    """(N, V) share of the load that is expected outside of the region."""


def make_candidates(
    goal: Goal, field: HeightField, cells: tuple[IntArray, IntArray], covariance_m2: Array,
    slope_ratio: float, largest_m3: float,
) -> Candidates:  # fmt: skip
    """Windows of candidate cells.

    Args:
        goal: of the job.
        field: its grid and containers.
        cells: rows and columns (N).
        covariance_m2: (N, 2, 2) of grains about each.
        slope_ratio: tangent of the angle of repose.
        largest_m3: largest load.
    """
    grid, (row, column) = field.grid, cells
    spread = np.sqrt(0.5 * np.trace(covariance_m2, axis1=1, axis2=2))
    foot_m = (3.0 * largest_m3 / (math.pi * slope_ratio)) ** (1.0 / 3.0)
    reach_m = max(1.2 * foot_m + float(spread.max()), SPREAD_SIGMAS * float(spread.max()))
    radius = math.ceil(reach_m / grid.cell_m)
    span = np.arange(-radius, radius + 1)
    dy, dx = (axis.ravel() for axis in np.meshgrid(span, span, indexing="ij"))
    width = grid.column_count + 2 * radius
    cell = (row[:, None] + dy + radius) * width + column[:, None] + dx + radius
    distance = grid.cell_m * np.hypot(dx, dy)
    drop = slope_ratio * (np.hypot(distance, spread[:, None]) - spread[:, None])
    inverse = np.linalg.inv(covariance_m2)
    x, y = grid.cell_m * dx, grid.cell_m * dy
    m2 = (
        inverse[:, 0, 0, None] * x * x
        + 2.0 * inverse[:, 0, 1, None] * x * y
        + inverse[:, 1, 1, None] * y * y
    )
    weight = np.exp(-0.5 * m2)
    inside = np.pad(goal.region, radius).ravel()[cell]
    outside = 1.0 - (weight * inside).sum(axis=1) / weight.sum(axis=1)
    return Candidates(
        row, column, cell, drop.astype(np.float32), outside.astype(np.float32), radius
    )


class Prediction:
    """Predicts loads on surfaces of one goal."""

    def __init__(
        self, goal: Goal, field: HeightField, among: Candidates, spill_weight_m: float
    ) -> None:
        """Prepare what does not change with the surface.

        Args:
            goal: of the job.
            field: its grid and containers.
            among: candidates.
            spill_weight_m: cost of a spilled volume.
        """
        self._among, self._spill_weight_m = among, spill_weight_m
        self._area = field.grid.cell_area_m2
        self._is_open = goal.container == OPEN
        fits = field.container_index == goal.container
        cells, radius = among.cell, among.radius
        self._takes = np.pad(fits, radius).ravel()[cells]
        self._inside = np.pad(goal.region, radius).ravel()[cells].astype(np.float32)
        wanted = np.pad(goal.wanted_m, radius).ravel()[cells]
        self._wanted: Single = wanted.astype(np.float32)
        walls = field.container_index == WALL
        rim = np.pad(np.where(walls, field.base_m, RIGID_M), radius, constant_values=RIGID_M)
        # An open region has no rim: material that leaves it is counted where it lies.
        level = RIGID_M if self._is_open else (rim.ravel()[cells] + among.drop_m).min(axis=1)
        self._rim_level = np.broadcast_to(level, (len(cells),)).astype(np.float32)

    def effects(self, height_m: Array, volumes_m3: Array) -> Effects:
        """Effects of every candidate with every volume (V) on a surface (rows, columns)."""
        among = self._among
        padded = np.pad(height_m, among.radius, constant_values=RIGID_M).astype(np.float32).ravel()
        here: Single = padded[among.cell]
        level = np.where(self._takes, here + among.drop_m, np.float32(RIGID_M))
        lands = 1.0 if self._is_open else 1.0 - among.outside_ratio
        depth = (volumes_m3[None, :] / self._area * np.reshape(lands, (-1, 1))).astype(np.float32)
        depth = np.broadcast_to(depth, (len(level), len(volumes_m3)))
        apex = np.minimum(_apex(level, depth), self._rim_level[:, None])
        gain = np.maximum(apex[:, :, None] - level[:, None, :], np.float32(0.0))
        short = (self._wanted - here) * self._inside
        inside = self._inside[:, None, :]
        cost = self._area * (gain * (gain * inside - 2.0 * short[:, None, :])).sum(axis=2)
        kept = (gain * inside).sum(axis=2) * self._area
        spill = np.clip(volumes_m3[None, :] - kept, 0.0, None)
        return Effects(gain, cost + self._spill_weight_m * spill, spill / volumes_m3[None, :])

    def after(self, height_m: Array, effects: Effects, candidate: int, volume: int) -> Array:
        """Expected surface after one load."""
        among, size = self._among, 2 * self._among.radius + 1
        gain = effects.gain_m[candidate, volume].reshape(size, size)
        top = int(among.row[candidate]) - among.radius
        left = int(among.column[candidate]) - among.radius
        rows = slice(max(top, 0), min(top + size, height_m.shape[0]))
        columns = slice(max(left, 0), min(left + size, height_m.shape[1]))
        result = height_m.copy()
        result[rows, columns] += gain[
            rows.start - top : rows.stop - top, columns.start - left : columns.stop - left
        ]
        return result


def _apex(level: Single, depth: Single) -> Single:
    """(N, V) level c with sum(max(c - level, 0)) = depth, by Newton's steps from above."""
    apex = level.min(axis=1)[:, None] + depth
    for index in range(apex.shape[1]):
        column = apex[:, index]
        for _ in range(LEVEL_STEP_COUNT):
            covered = level < column[:, None]
            count = np.maximum(covered.sum(axis=1), 1)
            total = np.einsum("nw,nw->n", level, covered, dtype=np.float32)
            column = (depth[:, index] + total) / count
        apex[:, index] = column
    return apex.astype(np.float32)
