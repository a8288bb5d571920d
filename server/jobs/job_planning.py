"""The next loads of a job, planned in a process of its own."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from bulk.job_file import BulkJob, JobFile, surveyed_job
from bulk.placement import middle_height_m
from bulk.planner import LoadPlanner, PlannedLoad
from bulk.throw_model import LandingScatter, MeasuredLoad, ThrowModel, measured_model
from machine.conventions import Array
from machine.errors import DownrangeError
from machine.policy_card import PolicyCard
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
    policy_dir: Path
    card: PolicyCard
    landing: tuple[LandingScatter, ...]
    """Measured; empty: predicted in the twin."""
    loads: tuple[MeasuredLoad, ...]
    """Measured ones of the same material."""
    model: ThrowModel | None
    """Of the same task before; predicting it takes seconds."""


@dataclass(frozen=True, slots=True)
class PlanAnswer:
    """Loads that are proposed, and the throws that they were planned with, before what loads showed."""

    loads: tuple[PlannedLoad, ...]
    model: ThrowModel


PlanLoads = Callable[[PlanTask, Callable[[], bool]], PlanAnswer]
"""Plans; ends early where the second argument, polled several times a second, returns True."""


def planned_loads(task: PlanTask) -> PlanAnswer:
    """Plan.

    Raises:
        UsageError: the goal cannot be thrown at; with the numbers.
    """
    job = surveyed_job(task.file, task.ground)
    model = task.model or _model(task, job)
    throws = model.learned(task.loads)
    planner = LoadPlanner(job.goal, job.field, throws, task.file.grab_m3, task.zones)
    present = replace(job.field, height_m=task.height_m)
    return PlanAnswer(planner.next_loads(present, task.passed_m), model)


def _model(task: PlanTask, job: BulkJob) -> ThrowModel:
    spec, height_m, grab_m3 = load_spec(), middle_height_m(job), task.file.grab_m3
    if task.landing:
        return measured_model(task.card, spec, job.material, task.landing, height_m, grab_m3)
    # Imported here: the server's own process does not need the simulator.
    from bulk.previewed_throws import previewed_model

    return previewed_model(task.policy_dir, task.card, spec, job.material, height_m, grab_m3)


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
