"""A job's surface and report for the console."""

import numpy as np

from bulk.height_field import HeightField
from bulk.job_report import job_html, progress_json, surfaces_json
from machine.conventions import Array
from server.jobs.job_ground import JobGround, JobState
from server.jobs.job_store import JobRecord, spread_of
from server.jobs.job_views import JobSurface
from server.store.job_tables import JobLoad


def job_surface(record: JobRecord, ground: JobGround, field: HeightField) -> JobSurface:
    """The ground of a job with its present surface."""
    goal = ground.job.goal
    return JobSurface(
        version_count=record.row.version_count,
        x_m=tuple(np.round(field.grid.x_m, 3).tolist()),
        y_m=tuple(np.round(field.grid.y_m, 3).tolist()),
        height_m=_millimetres(field.height_m),
        wanted_m=_millimetres(goal.wanted_m),
        start_m=_millimetres(ground.job.field.height_m),
        region=tuple(tuple(row) for row in goal.region.tolist()),
        containers=record.file.containers,
    )


def thrown_job_html(record: JobRecord, ground: JobGround, surface: JobState, policy_id: str) -> str:
    """The page of a job so far.

    Args:
        record: the job.
        ground: its ground.
        surface: present.
        policy_id: version that the machine throws with.
    """
    row, job, loads = record.row, ground.job, record.counted
    thrown_m3 = sum(load.volume_m3 for load in loads)
    return job_html(
        {
            "job": {
                "name": row.name,
                "goal": job.goal.kind.value,
                "material": job.material.name,
                "policy": policy_id,
                "grab_m3": job.file.grab_m3,
                "grab_kg": job.material.mass_kg(job.file.grab_m3),
                "landing_is_measured": row.landing_by == "measured",
            },
            "progress": progress_json(surface.progress) if loads else None,
            "thrown_m3": thrown_m3,
            "thrown_kg": job.material.mass_kg(thrown_m3),
            "loads": [_reported(load) for load in loads],
            **surfaces_json(job, surface.field),
        }
    )


def _reported(load: JobLoad) -> dict[str, object]:
    """A load for the report."""
    where = f"{load.landed_by} at x {load.x_m:.2f} m, y {load.y_m:.2f} m"
    spread_m = spread_of(load)
    if spread_m is not None:
        where += f", spread {spread_m[0]:.2f} m by {spread_m[1]:.2f} m (standard deviation)"
    named = "" if load.throw_id is None else f"; throw {load.throw_id}"
    return {
        "x_m": load.x_m,
        "y_m": load.y_m,
        "sentence": f"{where}{named}",
        "thrown_m3": load.volume_m3,
        "after": {
            "filled_ratio": load.filled_ratio or 0.0,
            "spill_ratio": load.spill_ratio or 0.0,
        },
    }


def _millimetres(height_m: Array) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in np.round(height_m, 3).tolist())
