"""The next loads of a job, planned in a process of its own."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from bulk.job_file import BulkJob, JobFile, surveyed_job
from bulk.placement import middle_height_m
from bulk.planner import LoadPlanner, PlannedLoad
from bulk.throw_model import (
    LandingScatter,
    MeasuredLoad,
    PolicyFolder,
    ThrowModel,
    learned_models,
)
from machine.conventions import Array, Mode
from machine.errors import DownrangeError
from machine.site.zones import Zone
from machine.spec import load_spec
from server.child_process import Send, run_child
from server.jobs.job_ground import Ground


@dataclass(frozen=True, slots=True)
class PlanTask:
    """What is planned, as it travels to the process."""

    file: JobFile
    ground: Ground | None
    height_m: Array
    """(rows, columns) present surface."""
    passed_m: tuple[tuple[float, float], ...]
    zones: tuple[Zone, ...]
    policies: tuple[PolicyFolder, ...]
    """On board, of the modes that may be chosen."""
    landing: Mapping[Mode, tuple[LandingScatter, ...]]
    """Measured; empty: that of virtual machines."""
    loads: Mapping[Mode, tuple[MeasuredLoad, ...]]
    """Measured ones of the same material."""
    models: tuple[ThrowModel, ...] | None
    """Predicted for the same task before; it takes about 1 s for each mode and pace."""


@dataclass(frozen=True, slots=True)
class PlanAnswer:
    """Loads that are proposed, and the throws as they were predicted, before what measured ones showed."""

    loads: tuple[PlannedLoad, ...]
    models: tuple[ThrowModel, ...]


PlanLoads = Callable[[PlanTask, Callable[[], bool]], PlanAnswer]
"""Plans; ends early where the second argument, polled several times a second, returns True."""


def planned_loads(task: PlanTask) -> PlanAnswer:
    """Plan.

    Raises:
        UsageError: the goal cannot be thrown at; with the numbers.
    """
    job = surveyed_job(task.file, task.ground)
    models = task.models or _models(task, job)
    learned = learned_models(models, task.landing, task.loads)
    planner = LoadPlanner(job.goal, job.field, learned, task.file.grab_m3, task.zones)
    present = replace(job.field, height_m=task.height_m)
    return PlanAnswer(planner.next_loads(present, task.passed_m), models)


def _models(task: PlanTask, job: BulkJob) -> tuple[ThrowModel, ...]:
    # Imported here: the server's own process does not need the simulator.
    from bulk.previewed_throws import previewed_models

    file, height_m = task.file, middle_height_m(job)
    return previewed_models(
        task.policies, load_spec(), job.material, height_m, file.grab_m3, file.pace_ratio
    )


def plan_in_child(task: PlanTask, is_cancelled: Callable[[], bool]) -> PlanAnswer:
    """Plan in a process of its own.

    Raises:
        ChildKilledError: `is_cancelled` returned True.
        ChildFailedError: it cannot be planned, with the reason.
    """
    return run_child(_work, (task,), "plan of loads", lambda _kind, _content: None, is_cancelled)


def _work(task: PlanTask, send: Send) -> None:
    try:
        send(("done", planned_loads(task)))
    except DownrangeError as error:
        send(("failed", str(error)))
