"""A job in simulation: loads are chosen by a rule, land with scatter, and pile up on the true surface.

The truth differs from what the planner knows: another angle of repose, a bias of the landings, a grab that
takes more or less than asked, grains poured one place after the other instead of their mean.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from bulk.footprint import pour_points
from bulk.goal import Goal, Progress, progress
from bulk.height_field import HeightField
from bulk.material import Material
from bulk.planner import LoadPlanner, PlannedLoad
from bulk.throw_model import ThrowModel
from machine.conventions import Array
from machine.site.objects import SWING_CIRCLE_M

MAX_LOAD_COUNT = 200
REACH_OF_ARM_M = 7.5
"""Largest distance from the slew axis at which the gripper digs (machine/spec.json, static reach)."""
MIN_HEAP_DEPTH_M = 0.03
"""A heap that is nowhere deeper is cleared."""

Rule = Callable[[HeightField, int], PlannedLoad | None]
"""Chooses the next load from the surface and the number of loads before; None ends the job."""


@dataclass(frozen=True, slots=True)
class Truth:
    """What the planner does not know."""

    slope_ratio: float
    """Tangent of the true angle of repose."""
    bias_m: tuple[float, float] = (0.0, 0.0)
    """Mean landing error downrange and crossrange."""
    scatter_ratio: float = 1.0
    """True scatter of the landings over the planner's."""
    footprint_ratio: float = 1.0
    """True spread of a load's grains over the planner's."""
    grab_spread_ratio: float = 0.08
    """Standard deviation of a grab's volume over the one asked for."""


class LoadRecord(NamedTuple):
    """One load of a job."""

    target: PlannedLoad
    landed_m: tuple[float, float]
    volume_m3: float
    after: Progress


@dataclass(slots=True)
class JobRun:
    """Course of a job."""

    start: HeightField
    final: HeightField
    loads: list[LoadRecord] = field(default_factory=list[LoadRecord])
    versions: list[Array] = field(default_factory=list[Array])
    """Surfaces (rows, columns) before each load: the way back for undo."""

    @property
    def thrown_m3(self) -> float:
        """All volume that was thrown."""
        return sum(load.volume_m3 for load in self.loads)


def simulate_job(
    goal: Goal, start: HeightField, models: Sequence[ThrowModel], rule: Rule, truth: Truth,
    rng: np.random.Generator, max_load_count: int = MAX_LOAD_COUNT,
) -> JobRun:  # fmt: skip
    """Throw loads until the rule ends the job."""
    run = JobRun(start, start)
    while len(run.loads) < max_load_count:
        load = rule(run.final, len(run.loads))
        if load is None:
            break
        asked = load.volume_m3 * max(0.2, 1.0 + truth.grab_spread_ratio * float(rng.normal()))
        surface, volume = run.final, asked
        if goal.heap is not None:
            dug = dig_heap(surface, goal, asked, models[0].material)
            if dug is None:
                break
            surface, volume = dug
        throws = next(
            model
            for model in models
            if (model.card.mode, model.pace_ratio) == (load.mode, load.pace_ratio)
        )
        sd = throws.landing_sd_m(math.hypot(load.x_m, load.y_m))
        landed = scattered_landing(
            load, (truth.scatter_ratio * sd[0], truth.scatter_ratio * sd[1]), truth.bias_m, rng
        )
        mark = throws.footprint_near(math.hypot(load.x_m, load.y_m))
        mark = mark.scaled(np.full(2, truth.footprint_ratio))
        points = pour_points(mark, landed, rng)
        run.versions.append(run.final.height_m)
        run.final = surface.pour(points, volume / len(points), truth.slope_ratio)
        run.loads.append(LoadRecord(load, landed, volume, progress(goal, start, run.final)))
    return run


def scattered_landing(
    load: PlannedLoad,
    sd_m: tuple[float, float],
    bias_m: tuple[float, float],
    rng: np.random.Generator,
) -> tuple[float, float]:
    """Where a load comes down: its target with bias and scatter downrange and crossrange."""
    bearing = math.atan2(load.y_m, load.x_m)
    down = bias_m[0] + sd_m[0] * float(rng.normal())
    cross = bias_m[1] + sd_m[1] * float(rng.normal())
    cos, sin = math.cos(bearing), math.sin(bearing)
    return load.x_m + cos * down - sin * cross, load.y_m + sin * down + cos * cross


def dig_heap(
    surface: HeightField, goal: Goal, volume_m3: float, material: Material
) -> tuple[HeightField, float] | None:
    """Grab at the heap's highest place within reach of the arm; None where the heap is gone."""
    if goal.heap is None:
        return None
    depth = np.where(goal.heap, surface.height_m - surface.base_m, 0.0)
    away = np.hypot(surface.grid.x_m[None, :], surface.grid.y_m[:, None])
    depth = np.where((away <= REACH_OF_ARM_M) & (away >= SWING_CIRCLE_M), depth, 0.0)
    row, column = np.unravel_index(int(depth.argmax()), depth.shape)
    deepest = float(depth[row, column])
    if deepest <= MIN_HEAP_DEPTH_M:
        return None
    slope = material.cut_slope_ratio(deepest)
    x_m, y_m = float(surface.grid.x_m[column]), float(surface.grid.y_m[row])
    dug = surface.dig(x_m, y_m, volume_m3, slope)
    return dug.field, dug.volume_m3


def planned_rule(planner: LoadPlanner) -> Rule:
    """The planner's first load, planned again from every surface."""

    def choose(surface: HeightField, _: int) -> PlannedLoad | None:
        loads = planner.next_loads(surface)
        return loads[0] if loads else None

    return choose
