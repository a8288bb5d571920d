"""Jobs in the database, and how the console sees them."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Final, Literal, NamedTuple

from sqlalchemy import func, select
from sqlalchemy.orm import Session as DatabaseSession
from sqlalchemy.orm import undefer

from bulk.goal import Progress
from bulk.height_field import Grid
from bulk.job_file import JobFile
from bulk.job_report import progress_json
from bulk.material import Material
from bulk.placement import LandedLoad
from machine.site.thrown_material import MaterialFootprint
from server.errors import ConflictError, NotFoundError
from server.jobs.job_ground import Ground, NumberedLoad, SurveyedSurface, pack, unpacked
from server.jobs.job_views import (
    JobLoadView,
    JobPage,
    JobProgress,
    JobProposal,
    JobStatus,
    JobSummary,
    JobView,
    PlanningState,
)
from server.store.database import Database
from server.store.job_tables import JobLoad, JobRow, JobSurvey

FIRST_VERSION: Final = 1
RATE_COUNT: Final = 10
"""Newest loads that say how many there are in a time."""


class Planned(NamedTuple):
    """What a plan gave."""

    state: PlanningState
    error: str = ""
    landing_by: Literal["measured", "predicted"] | None = None
    proposals: tuple[JobProposal, ...] = ()


@dataclass(slots=True)
class JobRecord:
    """A job with its loads, oldest first, read apart from any transaction."""

    row: JobRow
    loads: list[JobLoad]
    surveys: list[JobSurvey]
    """The ground of the job, if it was surveyed, and the last survey since."""

    @property
    def file(self) -> JobFile:
        """What was asked."""
        return JobFile.model_validate(self.row.file)

    @property
    def counted(self) -> list[JobLoad]:
        """Loads that were not withdrawn."""
        return [load for load in self.loads if not load.is_withdrawn]

    @property
    def ground(self) -> Ground | None:
        """The surveyed ground that the job began on."""
        first = next((s for s in self.surveys if s.version_count == FIRST_VERSION), None)
        return None if first is None else _ground_of(first)

    @property
    def last_survey(self) -> JobSurvey | None:
        """The last survey since the job began."""
        since = [survey for survey in self.surveys if survey.version_count > FIRST_VERSION]
        return max(since, key=lambda survey: survey.version_count, default=None)

    @property
    def surveyed(self) -> SurveyedSurface | None:
        """Surface of the last survey since the job began."""
        last = self.last_survey
        return None if last is None else SurveyedSurface(last.version_count, _ground_of(last)[1])

    @property
    def steps(self) -> list[NumberedLoad]:
        """Loads since the last survey."""
        last = self.last_survey
        since = 0 if last is None else last.version_count
        return [
            NumberedLoad(load.load_count, _landed(load))
            for load in self.counted
            if load.version_count > since
        ]

    def require_open(self) -> None:
        """Refuse a job that has ended.

        Raises:
            ConflictError: it has.
        """
        if self.row.ended_utc is not None:
            raise ConflictError("job_ended", f"Job {self.row.name} has ended.")

    def require_version(self, version_count: int) -> None:
        """Refuse a change of a job that has changed, or has ended.

        Raises:
            ConflictError: it has.
        """
        self.require_open()
        if self.row.version_count != version_count:
            raise ConflictError(
                "job_changed",
                f"Job {self.row.name} is at version {self.row.version_count} now, you changed version "
                f"{version_count}. Look at it again.",
            )


def _landed(load: JobLoad) -> LandedLoad:
    if load.covariance_m2 is None:
        return LandedLoad(load.x_m, load.y_m, load.volume_m3)
    xx, xy, yy = load.covariance_m2
    return LandedLoad(load.x_m, load.y_m, load.volume_m3, (xx, xy, yy))


def spread_of(load: JobLoad) -> tuple[float, float] | None:
    """Standard deviations of a load's places as measured, along the longest axis and across."""
    if load.covariance_m2 is None:
        return None
    xx, xy, yy = load.covariance_m2
    return MaterialFootprint(volume_m3=load.volume_m3, covariance_m2=(xx, xy, yy)).sd_m


def _ground_of(survey: JobSurvey) -> Ground:
    grid = Grid(**survey.grid)
    return grid, unpacked(survey.heights, grid)


def survey_row(
    job_id: str, version_count: int, ground: Ground, recorded_by: str, at_utc: datetime
) -> JobSurvey:
    """A surface as it is stored."""
    grid, heights = ground
    return JobSurvey(
        job_id=job_id,
        version_count=version_count,
        grid=grid._asdict(),
        heights=pack(heights),
        recorded_by=recorded_by,
        at_utc=at_utc,
    )


def read_record(database: DatabaseSession, job_id: str) -> JobRecord:
    """A job.

    Raises:
        NotFoundError: there is none.
    """
    row = database.get(JobRow, job_id)
    if row is None:
        raise NotFoundError("no_job", f"There is no job {job_id[:40]}.")
    loads = select(JobLoad).where(JobLoad.job_id == job_id).order_by(JobLoad.load_count)
    versions = database.scalars(
        select(JobSurvey.version_count)
        .where(JobSurvey.job_id == job_id)
        .order_by(JobSurvey.version_count)
    ).all()
    wanted = {version for version in versions if version == FIRST_VERSION} | set(versions[-1:])
    surveys = (
        select(JobSurvey)
        .where(JobSurvey.job_id == job_id, JobSurvey.version_count.in_(wanted))
        .options(undefer(JobSurvey.heights))
    )
    return JobRecord(row, list(database.scalars(loads)), list(database.scalars(surveys)))


def open_job_id(database: DatabaseSession, machine_id: str) -> str | None:
    """The open job of a machine."""
    query = select(JobRow.job_id).where(JobRow.machine_id == machine_id, JobRow.ended_utc.is_(None))
    return database.scalars(query.limit(1)).first()


def open_job_ids(database: DatabaseSession) -> list[str]:
    """All open jobs."""
    return list(database.scalars(select(JobRow.job_id).where(JobRow.ended_utc.is_(None))))


def job_page(
    database: Database,
    machine_id: str | None,
    status: JobStatus | None,
    cursor: str | None,
    limit: int,
) -> JobPage:
    """A page of jobs, newest first."""
    query = select(JobRow)
    if machine_id is not None:
        query = query.where(JobRow.machine_id == machine_id)
    if status is not None:
        is_open = JobRow.ended_utc.is_(None)
        query = query.where(is_open if status == "open" else ~is_open)
    if cursor is not None:
        query = query.where(JobRow.job_id < cursor)
    with database.read() as session:
        rows = session.scalars(query.order_by(JobRow.job_id.desc()).limit(limit + 1)).all()
        counts = _counts(session, [row.job_id for row in rows])
    return JobPage(
        items=tuple(_summary(row, counts.get(row.job_id, 0)) for row in rows[:limit]),
        next_cursor=rows[limit - 1].job_id if len(rows) > limit else None,
    )


def _counts(database: DatabaseSession, job_ids: Sequence[str]) -> dict[str, int]:
    query = (
        select(JobLoad.job_id, func.count())
        .where(JobLoad.job_id.in_(job_ids), JobLoad.is_withdrawn.is_(False))
        .group_by(JobLoad.job_id)
    )
    return {str(row[0]): int(row[1]) for row in database.execute(query)}


def _summary(row: JobRow, load_count: int) -> JobSummary:
    return JobSummary(
        job_id=row.job_id,
        machine_id=row.machine_id,
        name=row.name,
        status="open" if row.ended_utc is None else "ended",
        version_count=row.version_count,
        created_utc=row.created_utc,
        created_by=row.created_by,
        ended_utc=row.ended_utc,
        ended_by=row.ended_by,
        filled_ratio=row.progress["filled_ratio"],
        load_count=load_count,
    )


def proposals_of(record: JobRecord) -> tuple[JobProposal, ...]:
    """Loads that are proposed now."""
    return tuple(JobProposal.model_validate(item) for item in record.row.proposals)


def progress_of(state: Progress) -> JobProgress:
    """Progress with its ratios."""
    return JobProgress(**progress_json(state))


def job_view(record: JobRecord, material: Material) -> JobView:
    """A job for the console."""
    row, loads = record.row, record.counted
    thrown_m3 = sum(load.volume_m3 for load in loads)
    state = JobProgress.model_validate(row.progress)
    rate = _loads_per_s(loads)
    time_left_s = None
    if rate is not None and row.ended_utc is None and thrown_m3 > 0.0:
        kept_m3 = thrown_m3 / len(loads) * max(1.0 - state.spill_ratio, 0.1)
        time_left_s = state.missing_m3 / kept_m3 / rate
    return JobView(
        **_summary(row, len(loads)).model_dump(),
        end_reason=row.end_reason,
        file=record.file,
        material=material,
        grab_kg=material.mass_kg(record.file.grab_m3),
        progress=state,
        thrown_m3=thrown_m3,
        loads_per_s=rate,
        time_left_s=time_left_s,
        plan_state=PlanningState(row.plan_state),
        plan_error=row.plan_error or None,
        landing_by=(
            None
            if row.landing_by is None
            else "measured"
            if row.landing_by == "measured"
            else "predicted"
        ),
        next=proposals_of(record),
        loads=tuple(_load_view(load) for load in record.loads),
    )


def _loads_per_s(loads: Sequence[JobLoad]) -> float | None:
    times = sorted(load.at_utc for load in loads)[-RATE_COUNT:]
    if len(times) < 2:
        return None
    took_s = (times[-1] - times[0]).total_seconds()
    return (len(times) - 1) / took_s if took_s > 0.0 else None


def _load_view(load: JobLoad) -> JobLoadView:
    return JobLoadView(
        load_count=load.load_count,
        throw_id=load.throw_id,
        x_m=load.x_m,
        y_m=load.y_m,
        volume_m3=load.volume_m3,
        spread_m=spread_of(load),
        landed_by=(
            "measured"
            if load.landed_by == "measured"
            else "entered"
            if load.landed_by == "entered"
            else "predicted"
        ),
        recorded_by=load.recorded_by,
        at_utc=load.at_utc,
        is_withdrawn=load.is_withdrawn,
        filled_ratio=load.filled_ratio,
        spill_ratio=load.spill_ratio,
    )
