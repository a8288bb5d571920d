"""The surface of a job from the loads that were thrown: each poured where it landed, always alike."""

import math
from typing import NamedTuple

import numpy as np

from bulk.footprint import POUR_COUNT, Footprint, footprint, pour_points, release_towards
from bulk.height_field import HeightField
from bulk.job_file import BulkJob
from bulk.simulation import dig_heap
from machine.conventions import Array
from machine.spec import MachineSpec

MIN_RANGE_M = 5.0
"""Loads that landed nearer spread like those at this range."""
RANGE_STEP_M = 0.5
"""Footprints change little over this."""


class LandedLoad(NamedTuple):
    """A load that lies on the ground, frame `machine`."""

    x_m: float
    y_m: float
    volume_m3: float
    covariance_m2: tuple[float, float, float] | None = None
    """xx, xy and yy of its places as measured; None: as predicted."""


class LoadPlacement:
    """Places the loads of one job; the same loads in the same order give the same surface."""

    def __init__(self, job: BulkJob, spec: MachineSpec) -> None:
        self._job, self._spec = job, spec
        self._level_m = middle_height_m(job)
        self._marks: dict[float, Footprint] = {}

    def place(self, surface: HeightField, load: LandedLoad, number: int) -> HeightField:
        """The surface after a load. What a heap gave is dug there first: its volume stays that of the job.

        Args:
            surface: before.
            load: where it landed.
            number: of the load in the job; seeds its grains.
        """
        volume_m3 = load.volume_m3
        if self._job.goal.heap is not None:
            dug = dig_heap(surface, self._job.goal, volume_m3, self._job.material)
            if dug is None:
                return surface
            surface, volume_m3 = dug
        rng = np.random.default_rng(number)
        if load.covariance_m2 is not None:
            points = np.array((load.x_m, load.y_m)) + _spread(load.covariance_m2, rng)
        else:
            mark = self._mark(math.hypot(load.x_m, load.y_m))
            points = pour_points(mark, (load.x_m, load.y_m), rng)
        return surface.pour(points, volume_m3 / len(points), self._job.material.slope_ratio)

    def _mark(self, range_m: float) -> Footprint:
        step_m = RANGE_STEP_M * round(max(range_m, MIN_RANGE_M) / RANGE_STEP_M)
        if step_m not in self._marks:
            self._marks[step_m] = footprint(
                release_towards(step_m, self._level_m),
                self._level_m,
                self._job.material,
                self._job.file.grab_m3,
                self._spec,
                np.random.default_rng(0),
            )
        return self._marks[step_m]


def _spread(covariance_m2: tuple[float, float, float], rng: np.random.Generator) -> Array:
    """(POUR_COUNT, 2) points of mean 0 that have a covariance exactly."""
    xx, xy, yy = covariance_m2
    drawn = rng.standard_normal((POUR_COUNT, 2))
    drawn -= drawn.mean(axis=0)
    # Of orthonormal columns, the covariance is 1 / POUR_COUNT.
    sides, _ = np.linalg.qr(drawn)
    size, axes = np.linalg.eigh(np.array([[xx, xy], [xy, yy]]))
    return math.sqrt(POUR_COUNT) * (sides * np.sqrt(size.clip(0.0))) @ axes.T


def middle_height_m(job: BulkJob) -> float:
    """Median over the goal of the height halfway between start and wanted surface: where loads land."""
    return float(np.median(0.5 * (job.goal.wanted_m + job.field.height_m)[job.goal.region]))
