"""Bulk jobs: begun, changed and ended; nothing here commands a machine."""

from typing import Annotated, Final

from fastapi import APIRouter, Query
from fastapi.responses import HTMLResponse

from server.dependencies import JobsDep, Thrower, Viewer
from server.jobs.job_views import (
    JobChange,
    JobEndRequest,
    JobLoadRequest,
    JobMoveRequest,
    JobPage,
    JobRequest,
    JobSkipRequest,
    JobStatus,
    JobSurface,
    JobSurveyRequest,
    JobView,
)

router = APIRouter(prefix="/jobs", tags=["jobs"])
surveys_router = APIRouter(prefix="/jobs", tags=["jobs"])
"""Apart: its bodies may be larger than others (server/app.py)."""

MAX_SURVEY_BODY_BYTES: Final = 8 * 1024 * 1024


@router.get("")
def list_jobs(
    session: Viewer,
    jobs: JobsDep,
    machine_id: Annotated[str | None, Query(max_length=32)] = None,
    status: JobStatus | None = None,
    cursor: Annotated[str | None, Query(max_length=36)] = None,
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
) -> JobPage:
    """A page of jobs, newest first."""
    return jobs.page(machine_id, status, cursor, limit)


@surveys_router.post("", status_code=201)
def create_job(body: JobRequest, session: Thrower, jobs: JobsDep) -> JobView:
    """Begin a job; a machine has one at a time."""
    return jobs.create(body, session)


@router.get("/{job_id}")
def read_job(job_id: str, session: Viewer, jobs: JobsDep) -> JobView:
    """One job: progress, next loads, loads so far."""
    return jobs.view(job_id)


@router.get("/{job_id}/surface")
def read_job_surface(job_id: str, session: Viewer, jobs: JobsDep) -> JobSurface:
    """Its ground: start, now, wanted."""
    return jobs.surface(job_id)


@router.get("/{job_id}/report", response_class=HTMLResponse)
def read_job_report(job_id: str, session: Viewer, jobs: JobsDep) -> HTMLResponse:
    """Its report so far, as one HTML page."""
    return HTMLResponse(jobs.report(job_id))


@router.post("/{job_id}/skip")
def skip_job_load(job_id: str, body: JobSkipRequest, session: Thrower, jobs: JobsDep) -> JobView:
    """Pass a proposal over until the next load."""
    return jobs.skip(job_id, body, session)


@router.post("/{job_id}/move")
def move_job_load(job_id: str, body: JobMoveRequest, session: Thrower, jobs: JobsDep) -> JobView:
    """Move a proposal."""
    return jobs.move(job_id, body, session)


@router.post("/{job_id}/loads")
def add_job_load(job_id: str, body: JobLoadRequest, session: Thrower, jobs: JobsDep) -> JobView:
    """Record a throw, or a load by hand."""
    return jobs.add_load(job_id, body, session)


@router.post("/{job_id}/undo")
def undo_job_load(job_id: str, body: JobChange, session: Thrower, jobs: JobsDep) -> JobView:
    """Withdraw the last load."""
    return jobs.undo(job_id, body, session)


@surveys_router.post("/{job_id}/survey")
def survey_job(job_id: str, body: JobSurveyRequest, session: Thrower, jobs: JobsDep) -> JobView:
    """Put a surveyed surface in place of the computed one."""
    return jobs.survey(job_id, body, session)


@router.post("/{job_id}/end")
def end_job(job_id: str, body: JobEndRequest, session: Thrower, jobs: JobsDep) -> JobView:
    """End a job."""
    return jobs.end(job_id, body, session)
