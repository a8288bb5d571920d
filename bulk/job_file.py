"""A job as JSON: material, ground, containers, goal, and what the machine may not throw at."""

import math
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from bulk.goal import Goal, pile_goal, trench_goal, truck_goal
from bulk.height_field import (
    OPEN,
    Container,
    Grid,
    HeightField,
    Rectangle,
    level_field,
    make_grid,
)
from bulk.material import Material, material
from bulk.survey import read_survey
from machine.conventions import Array
from machine.errors import UsageError
from machine.site.objects import SiteObject, SiteObjects
from machine.site.zones import Zones

Coordinate = Annotated[float, Field(ge=-60.0, le=60.0)]
Length = Annotated[float, Field(ge=0.3, le=30.0)]
Height = Annotated[float, Field(ge=-5.0, le=10.0)]
MIN_WORK_M3 = 0.01
"""Smallest volume of a job."""


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class RectanglePlace(_Strict):
    """A rectangle on the ground, frame `machine`."""

    x_m: Coordinate
    y_m: Coordinate
    length_m: Length
    width_m: Length
    turn_rad: float = Field(default=0.0, ge=-math.pi, le=math.pi)

    @property
    def rectangle(self) -> Rectangle:
        """The same for the height field."""
        return Rectangle(self.x_m, self.y_m, self.length_m, self.width_m, self.turn_rad)


class ContainerPlace(RectanglePlace):
    """A truck bed or box; its place is its inside."""

    name: str = Field(min_length=1, max_length=40)
    floor_m: Height
    wall_m: float = Field(gt=0.0, le=4.0)


class Area(_Strict):
    """Level ground without a survey."""

    x_min_m: Coordinate
    x_max_m: Coordinate
    y_min_m: Coordinate
    y_max_m: Coordinate


class TruckWork(_Strict):
    """Fill a container evenly."""

    kind: Literal["truck"]
    container: str
    fill_ratio: float = Field(default=0.95, gt=0.0, le=1.0)


class ClearWork(_Strict):
    """Dig a heap and throw it into a container."""

    kind: Literal["clear"]
    container: str
    heap: RectanglePlace
    fill_ratio: float = Field(default=0.95, gt=0.0, le=1.0)


class PileWork(_Strict):
    """Build a pile."""

    kind: Literal["pile"]
    foot: RectanglePlace
    height_m: float = Field(gt=0.0, le=5.0)


class TrenchWork(_Strict):
    """Fill a trench."""

    kind: Literal["trench"]
    place: RectanglePlace
    top_m: Height = 0.0


Work = Annotated[TruckWork | ClearWork | PileWork | TrenchWork, Field(discriminator="kind")]


class ScatterEntry(_Strict):
    """Measured scatter of the machine's landings at a range."""

    range_m: float = Field(gt=0.0, le=60.0)
    sd_downrange_m: float = Field(gt=0.0, le=5.0)
    sd_crossrange_m: float = Field(gt=0.0, le=5.0)


class JobFile(_Strict):
    """Content of a job file."""

    name: str = Field(min_length=1, max_length=80)
    mode: Literal["2d", "3d"] | None = None
    """How every load is thrown; left out: the planner chooses for each."""
    pace_ratio: float | None = Field(default=None, ge=0.0, le=1.0)
    """0 careful .. 1 fast, of every load; left out: the planner chooses for each."""
    material: str | Material
    """Name of a known kind, or its own numbers."""
    grab_m3: float = Field(gt=0.0, le=3.0)
    cell_m: float = Field(default=0.1, ge=0.02, le=0.5)
    area: Area | None = None
    survey: str | None = None
    """CSV file, relative to the job file."""
    containers: tuple[ContainerPlace, ...] = Field(default=(), max_length=8)
    loose: RectanglePlace | None = None
    """Where surveyed ground above 0 m is loose material that can be dug; the rest of the ground is rigid."""
    work: Work
    objects: SiteObjects = ()
    """Boxes, pits and piles that do not move."""
    zones: Zones = ()
    landing: tuple[ScatterEntry, ...] = Field(default=(), max_length=40)
    """Measured on this machine with `mode`; left out: that of virtual machines."""

    @model_validator(mode="after")
    def _check_ground(self) -> "JobFile":
        if (self.area is None) == (self.survey is None):
            raise ValueError("give either area or survey")
        if self.landing and self.mode is None:
            raise ValueError("landing is that of one mode; give mode as well")
        return self


class BulkJob(NamedTuple):
    """A job that is ready to be planned."""

    file: JobFile
    material: Material
    field: HeightField
    goal: Goal


def read_job(path: Path) -> BulkJob:
    """Read and set up a job.

    Raises:
        UsageError: no such file, not a job, or one that cannot be done; with numbers and reason.
    """
    try:
        file = JobFile.model_validate_json(path.read_bytes())
    except OSError as error:
        raise UsageError(f"{path} cannot be read: {error.strerror}") from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "the file"
        raise UsageError(f"{path} is not a job: {where}: {first['msg']}") from error
    return make_job(file, path.parent)


def make_job(file: JobFile, folder: Path) -> BulkJob:
    """Set up a job; files that it names lie in a folder.

    Raises:
        UsageError: it cannot be done; with numbers and reason.
    """
    survey = None if file.survey is None else read_survey(folder / file.survey, file.cell_m)
    return surveyed_job(file, survey)


def surveyed_job(file: JobFile, survey: tuple[Grid, Array] | None) -> BulkJob:
    """Set up a job on surveyed ground, or on level ground without a survey.

    Raises:
        UsageError: it cannot be done; with numbers and reason.
    """
    stuff = material_of(file)
    grid, ground = _level_ground(file) if survey is None else survey
    surface = ground.copy()
    if file.loose is not None:
        movable = file.loose.rectangle.mask(grid) & (ground > 0.0)
        ground = np.where(movable, 0.0, ground)
    for item in file.objects:
        ground, surface = _with_object(grid, ground, item), _with_object(grid, surface, item)
    boxes = [
        Container(item.name, item.rectangle, item.floor_m, item.wall_m) for item in file.containers
    ]
    empty = level_field(grid, boxes, ground)
    is_open = empty.container_index == OPEN
    height = np.where(is_open, np.maximum(surface, empty.base_m), empty.base_m)
    start = HeightField(grid, empty.base_m, height, empty.containers, empty.container_index)
    goal = _goal(file, start, stuff)
    wanted = float((goal.wanted_m - start.height_m).sum()) * grid.cell_area_m2
    if wanted < MIN_WORK_M3:
        raise UsageError(
            f"the {goal.kind.value} lacks {wanted:.3f} m3 only; check its heights and its place "
            f"({goal.region.sum()} cells on the survey)"
        )
    return BulkJob(file, stuff, start, goal)


def material_of(file: JobFile) -> Material:
    """The material of a job.

    Raises:
        UsageError: no such kind, with those that there are.
    """
    return material(file.material) if isinstance(file.material, str) else file.material


def area_grid(file: JobFile) -> Grid:
    """Grid of a job without a survey.

    Raises:
        UsageError: it has no area, or one that is empty or too large.
    """
    area = file.area
    if area is None:
        raise UsageError("give either area or survey")
    return make_grid((area.x_min_m, area.x_max_m), (area.y_min_m, area.y_max_m), file.cell_m)


def _level_ground(file: JobFile) -> tuple[Grid, Array]:
    grid = area_grid(file)
    return grid, np.zeros((grid.row_count, grid.column_count))


def _with_object(grid: Grid, ground: Array, item: SiteObject) -> Array:
    """Ground with the upper surface of an object."""
    result = ground.copy()
    foot = Rectangle(item.x_m, item.y_m, item.length_m, item.width_m, item.turn_rad).mask(grid)
    for row, column in np.argwhere(foot).tolist():
        top = item.surface_m(float(grid.x_m[column]), float(grid.y_m[row]))
        if top is not None:
            result[row, column] = top
    return result


def _goal(file: JobFile, start: HeightField, stuff: Material) -> Goal:
    work = file.work
    if isinstance(work, PileWork):
        foot = work.foot.rectangle
        _refuse_beside(start, foot, "pile")
        return pile_goal(start, foot, work.height_m, stuff.slope_ratio)
    if isinstance(work, TrenchWork):
        place = work.place.rectangle
        _refuse_beside(start, place, "trench")
        return trench_goal(start, place, work.top_m)
    names = [item.name for item in start.containers]
    if work.container not in names:
        there = ", ".join(names) or "none"
        raise UsageError(f"the goal names container '{work.container}'; there are: {there}")
    heap = work.heap.rectangle if isinstance(work, ClearWork) else None
    goal = truck_goal(start, names.index(work.container), work.fill_ratio, heap)
    if goal.heap is not None and start.volume_m3(goal.heap) < MIN_WORK_M3:
        raise UsageError(
            f"the heap holds {start.volume_m3(goal.heap):.3f} m3 of loose material; give a survey and "
            "name the loose part of it (loose)"
        )
    return goal


def _refuse_beside(start: HeightField, place: Rectangle, name: str) -> None:
    corners = [
        place.point_m(a * place.length_m, b * place.width_m)
        for a in (-0.5, 0.5)
        for b in (-0.5, 0.5)
    ]
    outside = [corner for corner in corners if not start.grid.holds(*corner)]
    if outside:
        x, y = outside[0]
        raise UsageError(
            f"the {name} has a corner at x {x:.1f} m, y {y:.1f} m, beside the ground that the job describes; "
            "enlarge area or survey"
        )
