"""Goals of a job: the surface that is wanted, and how near the field is to it."""

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from bulk.height_field import OPEN, Grid, HeightField, Rectangle
from machine.conventions import Array, BoolArray, IntArray

ALONG_WORDS = ("rear", "middle", "front")
ACROSS_WORDS = ("right", "centre", "left")
PART_COUNT = 3


class GoalKind(StrEnum):
    """What is built."""

    PILE = "pile"
    TRUCK = "truck"
    TRENCH = "trench"
    CLEAR = "clear"


@dataclass(frozen=True, slots=True)
class Goal:
    """A wanted surface over one region."""

    kind: GoalKind
    place: Rectangle
    """What its parts are named by: front is where its length points to."""
    region: BoolArray
    """(rows, columns) cells that the material shall lie on."""
    wanted_m: Array
    """(rows, columns) wanted height there; the present surface elsewhere."""
    container: int = OPEN
    """Index of the container that is filled; `OPEN` on open ground."""
    heap: BoolArray | None = None
    """(rows, columns) where material is dug; None: it comes from elsewhere."""


class Progress(NamedTuple):
    """State of a job."""

    wanted_m3: float
    """Volume between the surface at the start and the wanted one."""
    missing_m3: float
    """Below the wanted surface."""
    placed_m3: float
    """Gain of material in the region."""
    spilled_m3: float
    """Gain of material elsewhere."""
    unevenness_m: float
    """Standard deviation of the surface about the wanted one, in the region."""

    @property
    def filled_ratio(self) -> float:
        """Share of the wanted volume that is not missing."""
        return 1.0 - self.missing_m3 / self.wanted_m3 if self.wanted_m3 > 0.0 else 1.0

    @property
    def spill_ratio(self) -> float:
        """Share of the thrown volume that lies elsewhere."""
        thrown = self.placed_m3 + self.spilled_m3
        return self.spilled_m3 / thrown if thrown > 0.0 else 0.0


def truck_goal(
    field: HeightField, container: int, fill_ratio: float, heap: Rectangle | None = None
) -> Goal:
    """Fill a container evenly up to a share of its walls' height; optionally from a heap on the ground."""
    item = field.containers[container]
    region = field.inside(container)
    wanted = np.where(region, item.floor_m + fill_ratio * item.wall_m, field.height_m)
    dug = None if heap is None else heap.mask(field.grid) & (field.container_index == OPEN)
    kind = GoalKind.TRUCK if heap is None else GoalKind.CLEAR
    return Goal(kind, item.inside, region, wanted, container, dug)


def pile_goal(field: HeightField, foot: Rectangle, height_m: float, slope_ratio: float) -> Goal:
    """A pile on a foot: sides at the angle of repose, flat on top where it would be higher."""
    along, across = foot.local_m(field.grid.x_m[None, :], field.grid.y_m[:, None])
    in_m = np.minimum(0.5 * foot.length_m - np.abs(along), 0.5 * foot.width_m - np.abs(across))
    rise = np.minimum(height_m, slope_ratio * np.maximum(in_m, 0.0))
    region = foot.mask(field.grid) & (field.container_index == OPEN)
    wanted = np.where(region, np.maximum(field.base_m + rise, field.height_m), field.height_m)
    return Goal(GoalKind.PILE, foot, region, wanted)


def trench_goal(field: HeightField, place: Rectangle, top_m: float) -> Goal:
    """A trench filled level up to a height."""
    region = place.mask(field.grid) & (field.container_index == OPEN)
    wanted = np.where(region, np.maximum(top_m, field.height_m), field.height_m)
    return Goal(GoalKind.TRENCH, place, region, wanted)


def progress(goal: Goal, start: HeightField, field: HeightField) -> Progress:
    """How far a job is."""
    area = field.grid.cell_area_m2
    gain = field.height_m - start.height_m
    gap = (goal.wanted_m - field.height_m)[goal.region]
    elsewhere = ~goal.region if goal.heap is None else ~goal.region & ~goal.heap
    return Progress(
        wanted_m3=float((goal.wanted_m - start.height_m)[goal.region].clip(0.0).sum()) * area,
        missing_m3=float(gap.clip(0.0).sum()) * area,
        placed_m3=float(gain[goal.region].sum()) * area,
        spilled_m3=float(gain[elsewhere].sum()) * area,
        unevenness_m=float(np.std(gap)),
    )


def part_name(goal: Goal, x_m: float, y_m: float) -> str:
    """Which ninth of the goal's rectangle a point lies in, as in "left rear"."""
    along, across = _part(goal, np.asarray(x_m), np.asarray(y_m))
    words = ACROSS_WORDS[int(across)], ALONG_WORDS[int(along)]
    if words == ("centre", "middle"):
        return "centre"
    return f"{words[0]} {words[1]}" if words[1] != "middle" else words[0]


def part_missing_m3(goal: Goal, grid: Grid, height_m: Array, x_m: float, y_m: float) -> float:
    """Volume that is missing under a surface (rows, columns) in the same ninth as a point."""
    along, across = _part(goal, grid.x_m[None, :], grid.y_m[:, None])
    here = _part(goal, np.asarray(x_m), np.asarray(y_m))
    mask = goal.region & (along == here[0]) & (across == here[1])
    return float((goal.wanted_m - height_m)[mask].clip(0.0).sum()) * grid.cell_area_m2


def candidate_cells(goal: Goal, field: HeightField, count: int) -> tuple[IntArray, IntArray]:
    """Rows and columns (N <= count) of cells spread evenly over the region."""
    rows, columns = np.nonzero(goal.region)
    spacing = max(1, math.ceil(math.sqrt(rows.size / max(count, 1))))
    while True:
        keep = (rows % spacing == spacing // 2) & (columns % spacing == spacing // 2)
        if keep.sum() <= count:
            break
        spacing += 1
    if not keep.any():
        keep = np.zeros(rows.size, dtype=np.bool_)
        keep[rows.size // 2] = True
    return rows[keep], columns[keep]


def _part(goal: Goal, x_m: Array, y_m: Array) -> tuple[Array, Array]:
    along, across = goal.place.local_m(x_m, y_m)
    third = PART_COUNT * (np.stack(np.broadcast_arrays(
        along / goal.place.length_m, across / goal.place.width_m)) + 0.5)  # fmt: skip
    number = np.clip(np.floor(third), 0, PART_COUNT - 1)
    return number[0], number[1]
