"""History."""

from datetime import datetime
from typing import NoReturn

from fastapi import APIRouter, Query
from fastapi.responses import FileResponse, StreamingResponse

from machine.conventions import Mode
from server.errors import UnavailableError
from server.schemas_history import (
    GroupBy,
    ImpactRequest,
    ImpactView,
    Outcome,
    ReplayRequest,
    ReplayView,
    ThrowDetail,
    ThrowPage,
    ThrowSeries,
    ThrowStats,
)

router = APIRouter(tags=["history"])


def _later() -> NoReturn:
    raise UnavailableError("not_ready", "this part of the service is not there yet")


@router.get("/throws")
def list_throws(
    machine_id: str | None = None,
    mode: Mode | None = None,
    policy_sha256: str | None = None,
    operator: str | None = None,
    outcome: Outcome | None = None,
    min_range_m: float | None = None,
    max_range_m: float | None = None,
    since: datetime | None = None,
    until: datetime | None = None,
    cursor: str | None = None,
    limit: int = Query(default=50, ge=1, le=500),
) -> ThrowPage:
    """A page of throws, newest first."""
    _later()


@router.get("/throws/stats")
def read_throw_stats(
    machine_id: str | None = None,
    mode: Mode | None = None,
    policy_sha256: str | None = None,
    operator: str | None = None,
    outcome: Outcome | None = None,
    min_range_m: float | None = None,
    max_range_m: float | None = None,
    since: datetime | None = None,
    until: datetime | None = None,
    group_by: GroupBy = GroupBy.POLICY,
) -> ThrowStats:
    """Accuracy of the throws that match."""
    _later()


@router.get("/throws/export.csv", response_class=StreamingResponse)
def export_throws(
    machine_id: str | None = None,
    mode: Mode | None = None,
    policy_sha256: str | None = None,
    operator: str | None = None,
    outcome: Outcome | None = None,
    min_range_m: float | None = None,
    max_range_m: float | None = None,
    since: datetime | None = None,
    until: datetime | None = None,
) -> StreamingResponse:
    """The throws that match, as CSV."""
    _later()


@router.get("/throws/{throw_id}")
def read_throw(throw_id: str) -> ThrowDetail:
    """One throw."""
    _later()


@router.get("/throws/{throw_id}/series")
def read_throw_series(throw_id: str) -> ThrowSeries:
    """Time series from the throw's log."""
    _later()


@router.get("/throws/{throw_id}/log", response_class=FileResponse)
def read_throw_log(throw_id: str) -> FileResponse:
    """The throw's log file (MCAP)."""
    _later()


@router.post("/throws/{throw_id}/impacts", status_code=201)
def mark_impact(throw_id: str, body: ImpactRequest) -> ImpactView:
    """Add a record of where the load came down."""
    _later()


@router.post("/throws/{throw_id}/replay")
def replay_throw(throw_id: str, body: ReplayRequest) -> ReplayView:
    """Show the throw in this session's 3D view."""
    _later()
