"""A job's surface from what is stored: the ground, the last survey, and the loads since, always alike.

Surfaces are kept for a while by the loads that led to them, so that another load costs one pour and an undo
costs nothing.
"""

import zlib
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import replace
from threading import Lock
from typing import Any, Final, NamedTuple

import numpy as np

from bulk.goal import Progress, progress
from bulk.height_field import WALL, Grid, HeightField
from bulk.job_file import BulkJob, JobFile, area_grid, surveyed_job
from bulk.placement import LandedLoad, LoadPlacement
from bulk.survey import parse_survey
from bulk.survey_files import is_survey_file
from machine.conventions import Array
from machine.errors import UsageError
from machine.spec import MachineSpec
from server.jobs.job_views import JobProposal
from server.jobs.laid_material import load_footprint
from server.limits.limited_process import READ_S, LimitedProcess, LimitExceededError
from server.viewer.shapes import LoadFootprint

MAX_CELL_COUNT: Final = 40_000
"""20 m x 20 m at 0.1 m: a surface of 0.3 MB, and a pour of some milliseconds."""
KEPT_COUNT: Final = 40
"""Surfaces kept of a job."""
JOB_COUNT: Final = 8
"""Jobs whose surfaces are kept."""
BELOW_M: Final = 0.3
"""A survey that lies this far below what cannot move was taken in another frame."""

NAME: Final = "the survey"
"""What people call what they sent."""

Ground = tuple[Grid, Array]


class NumberedLoad(NamedTuple):
    """A load by its number in the job, which seeds its grains."""

    number: int
    load: LandedLoad


class SurveyedSurface(NamedTuple):
    """Heights (rows, columns) on the job's grid at a version of the job."""

    version_count: int
    height_m: Array


class JobState(NamedTuple):
    """A surface, and how far the job is with it."""

    field: HeightField
    progress: Progress


class JobGround:
    """The ground of one job; thread-safe."""

    def __init__(self, file: JobFile, ground: Ground | None, spec: MachineSpec) -> None:
        """Set up.

        Args:
            file: the job.
            ground: its survey; None: level ground.
            spec: of the machine.

        Raises:
            UsageError: it cannot be done; with numbers and reason.
        """
        # Before anything is computed on it.
        _require_size(area_grid(file) if ground is None else ground[0])
        self.job: BulkJob = surveyed_job(file, ground)
        self._placement = LoadPlacement(self.job, spec)
        self._lock = Lock()
        self._kept: OrderedDict[tuple[Any, ...], JobState] = OrderedDict()

    def surfaces(
        self, surveyed: SurveyedSurface | None, loads: Sequence[NumberedLoad]
    ) -> tuple[JobState, dict[int, Progress]]:
        """The surface after loads, and the progress after each one by its number; no longer kept ones miss.

        Args:
            surveyed: the last survey.
            loads: since then, in their order.
        """
        with self._lock:
            keys: list[tuple[Any, ...]] = [(None if surveyed is None else surveyed.version_count,)]
            for load in loads:
                keys.append((*keys[-1], load))
            after = {
                load.number: self._kept[key].progress
                for load, key in zip(loads, keys[1:], strict=True)
                if key in self._kept
            }
            done = next((i for i in range(len(keys) - 1, -1, -1) if keys[i] in self._kept), -1)
            surface = self._kept[keys[done]] if done >= 0 else self._keep(keys[0], surveyed)
            for load, key in zip(loads[max(done, 0) :], keys[max(done, 0) + 1 :], strict=True):
                field = self._placement.place(surface.field, load.load, load.number)
                surface = self._put(key, field)
                after[load.number] = surface.progress
            return surface, after

    def _keep(self, key: tuple[Any, ...], surveyed: SurveyedSurface | None) -> JobState:
        field = self.job.field
        if surveyed is not None:
            field = replace(field, height_m=np.maximum(surveyed.height_m, field.base_m))
        return self._put(key, field)

    def _put(self, key: tuple[Any, ...], field: HeightField) -> JobState:
        surface = JobState(field, progress(self.job.goal, self.job.field, field))
        self._kept[key] = surface
        while len(self._kept) > KEPT_COUNT:
            self._kept.popitem(last=False)
        return surface

    def footprints(
        self, field: HeightField, proposals: Sequence[JobProposal]
    ) -> tuple[LoadFootprint, ...]:
        """Where proposed loads would lie on a surface, each without the others."""
        with self._lock:
            return tuple(
                load_footprint(
                    field,
                    self._placement.place(field, LandedLoad(load.x_m, load.y_m, load.volume_m3), 0),
                    (load.x_m, load.y_m, load.surface_m),
                    _footprint_text(load),
                )
                for load in proposals
            )

    def resampled(self, present: HeightField, ground: Ground) -> Array:
        """Heights (rows, columns) of a survey on the job's grid; cells that it leaves out keep theirs.

        Raises:
            UsageError: it does not cover the goal, or lies below what cannot move; with the numbers.
        """
        grid, heights = ground
        own, region = present.grid, self.job.goal.region
        column = np.rint((own.x_m - grid.x0_m) / grid.cell_m).astype(int)
        row = np.rint((own.y_m - grid.y0_m) / grid.cell_m).astype(int)
        inside = ((row >= 0) & (row < grid.row_count))[:, None] & (
            (column >= 0) & (column < grid.column_count)
        )
        missing = int((region & ~inside).sum())
        if missing:
            raise UsageError(
                f"the survey leaves out {missing} of {int(region.sum())} cells of the goal; it covers x "
                f"{grid.x_m[0]:.1f} to {grid.x_m[-1]:.1f} m, y {grid.y_m[0]:.1f} to {grid.y_m[-1]:.1f} m"
            )
        rows, columns = row.clip(0, grid.row_count - 1), column.clip(0, grid.column_count - 1)
        sampled = heights[np.ix_(rows, columns)]
        below_m = float(np.median((present.base_m - sampled)[region]))
        if below_m > BELOW_M:
            raise UsageError(
                f"half of the survey lies {below_m:.2f} m or more below the floor of the goal; give heights "
                "above the ground at the machine, frame machine"
            )
        taken = np.where(inside & (present.container_index != WALL), sampled, present.height_m)
        return np.maximum(taken, present.base_m)


class JobGrounds:
    """Grounds of the jobs that were looked at last; thread-safe."""

    def __init__(self, spec: MachineSpec) -> None:
        self._spec = spec
        self._lock = Lock()
        self._kept: OrderedDict[str, JobGround] = OrderedDict()

    def make(self, file: JobFile, ground: Ground | None) -> JobGround:
        """The ground of a new job.

        Raises:
            UsageError: it cannot be done.
        """
        return JobGround(file, ground, self._spec)

    def find(self, job_id: str) -> JobGround | None:
        """That of a job, if it is kept."""
        with self._lock:
            return self._kept.get(job_id)

    def keep(self, job_id: str, ground: JobGround) -> None:
        """Keep that of a job."""
        with self._lock:
            self._kept[job_id] = ground
            while len(self._kept) > JOB_COUNT:
                self._kept.popitem(last=False)


class SurveyReader:
    """Reads surveys that people send; files that are not text in a process with limits."""

    def __init__(self, read_s: float = READ_S) -> None:
        self._process = LimitedProcess(read_s)

    def read(self, content: bytes, cell_m: float) -> Ground:
        """Grid and heights of a survey, rounded as they are stored.

        Raises:
            UsageError: no survey, or it needs too much time or memory; with numbers.
        """
        if not is_survey_file(content):
            grid, heights = parse_survey(content, NAME, cell_m)
        else:
            try:
                grid, heights = self._process.run(parse_survey, content, NAME, cell_m)
            except LimitExceededError as error:
                raise UsageError(
                    f"{NAME} took {error} to read; save it uncompressed, with fewer points"
                ) from error
        return grid, unpacked(pack(heights), grid)

    def close(self) -> None:
        """End the process."""
        self._process.close()


def pack(height_m: Array) -> bytes:
    """Heights as they are stored."""
    return zlib.compress(np.asarray(height_m, dtype="<f4").tobytes(), 6)


def unpacked(stored: bytes, grid: Grid) -> Array:
    """Heights (rows, columns) as they were stored."""
    flat = np.frombuffer(zlib.decompress(stored), dtype="<f4").astype(np.float64)
    return flat.reshape(grid.row_count, grid.column_count)


def _footprint_text(load: JobProposal) -> str:
    # Of the first alone in full: labels of places so near to each other would hide what they name.
    number = f"{load.proposal_count}"
    return f"{number}: {load.volume_m3:.2f} m³" if load.proposal_count == 1 else number


def _require_size(grid: Grid) -> None:
    count = grid.row_count * grid.column_count
    if count > MAX_CELL_COUNT:
        raise UsageError(
            f"the ground has {count} cells of {grid.cell_m:g} m, at most {MAX_CELL_COUNT} are possible; "
            "choose a smaller area or larger cells"
        )
