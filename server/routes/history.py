"""Throws: pages, statistics, export, details, series, logs, marks, replays.

Machines upload their logs with their own token in place of a person's session.
"""

import asyncio
import re
from datetime import UTC, datetime
from typing import Annotated

from fastapi import APIRouter, Depends, Header, Query, Request, Response
from fastapi.responses import FileResponse, PlainTextResponse, StreamingResponse

from diagnosis.loading.throw_csv import throw_csv
from machine.conventions import Mode
from server.accounts.audit_chain import Entry
from server.dependencies import (
    AuditDep,
    DatabaseDep,
    HistoryDep,
    ImpactMarker,
    LogsDep,
    MachineCaller,
    PlansDep,
    ReplaysDep,
    StatisticsDep,
    ThrowsDep,
    Viewer,
)
from server.errors import ApiError
from server.plans.landing_errors import point_of
from server.schemas.history import (
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
from server.throws.impacts import add_impact, impact_view, impact_views, target_of
from server.throws.throw_details import throw_detail
from server.throws.throw_history import ThrowFilter
from server.throws.throw_series import series_of

router = APIRouter(tags=["history"])
logs_router = APIRouter(tags=["logs"])

MAX_LOG_BODY_BYTES = 512 * 1024 * 1024
"""Outer bound; the limit that counts is a setting (DOWNRANGE_LOG_MAX_BYTES)."""
_SHA256 = re.compile(r"[0-9a-f]{64}")
_THROW_ID = re.compile(r"[A-Za-z0-9_-]{1,64}")

Name = Annotated[str | None, Query(max_length=64)]
Range = Annotated[float | None, Query(ge=0.0, le=100.0, allow_inf_nan=False)]


def throw_filter(
    machine_id: Name = None,
    mode: Mode | None = None,
    policy_sha256: Name = None,
    operator: Name = None,
    outcome: Outcome | None = None,
    min_range_m: Range = None,
    max_range_m: Range = None,
    since: datetime | None = None,
    until: datetime | None = None,
) -> ThrowFilter:
    """The filter that pages, statistics and export share; times without a zone are UTC."""
    return ThrowFilter(
        machine_id=machine_id,
        mode=mode,
        policy_sha256=policy_sha256,
        operator=operator,
        outcome=outcome,
        min_range_m=min_range_m,
        max_range_m=max_range_m,
        since=_aware(since),
        until=_aware(until),
    )


FilterDep = Annotated[ThrowFilter, Depends(throw_filter)]


def _aware(moment: datetime | None) -> datetime | None:
    return moment.replace(tzinfo=UTC) if moment is not None and moment.tzinfo is None else moment


@router.get("/throws")
def list_throws(
    session: Viewer,
    history: HistoryDep,
    wanted: FilterDep,
    cursor: Annotated[str | None, Query(max_length=36)] = None,
    limit: Annotated[int, Query(ge=1, le=500)] = 50,
) -> ThrowPage:
    """A page of throws, newest first."""
    return history.page(wanted, cursor, limit)


@router.get("/throws/stats")
def read_throw_stats(
    session: Viewer,
    statistics: StatisticsDep,
    wanted: FilterDep,
    group_by: GroupBy = GroupBy.POLICY,
) -> ThrowStats:
    """Accuracy of the newest throws that match."""
    return statistics.of(wanted, group_by)


@router.get("/throws/export.csv", response_class=StreamingResponse)
def export_throws(
    session: Viewer, audit: AuditDep, history: HistoryDep, wanted: FilterDep
) -> StreamingResponse:
    """The throws that match, as CSV."""
    audit.record(Entry(session.actor, "throws.export", "fact"))
    return StreamingResponse(
        history.export(wanted),
        media_type="text/csv; charset=utf-8",
        headers={"Content-Disposition": 'attachment; filename="throws.csv"'},
    )


@router.get("/throws/{throw_id}")
def read_throw(
    throw_id: str, session: Viewer, database: DatabaseDep, plans: PlansDep, logs: LogsDep
) -> ThrowDetail:
    """Everything about one throw."""
    return throw_detail(database, plans, logs, throw_id)


@router.get("/throws/{throw_id}/series")
def read_throw_series(throw_id: str, session: Viewer, logs: LogsDep) -> ThrowSeries:
    """Time series from the throw's log."""
    return series_of(throw_id, logs.read(throw_id))


@router.get("/throws/{throw_id}/log", response_class=FileResponse)
def read_throw_log(throw_id: str, session: Viewer, logs: LogsDep) -> FileResponse:
    """The throw's log file (MCAP)."""
    return FileResponse(
        logs.path(throw_id),
        media_type="application/octet-stream",
        filename=f"{throw_id}.mcap",
    )


@router.get("/throws/{throw_id}/csv", response_class=PlainTextResponse)
def read_throw_csv(throw_id: str, session: Viewer, logs: LogsDep) -> PlainTextResponse:
    """The throw's log as CSV."""
    return PlainTextResponse(
        throw_csv(logs.read(throw_id)),
        media_type="text/csv; charset=utf-8",
        headers={"Content-Disposition": f'attachment; filename="{throw_id}.csv"'},
    )


@router.post("/throws/{throw_id}/impacts", status_code=201)
def mark_impact(
    throw_id: str,
    body: ImpactRequest,
    session: ImpactMarker,
    store: DatabaseDep,
    throws: ThrowsDep,
    audit: AuditDep,
) -> ImpactView:
    """Add a record of where the load came down; nothing is overwritten."""
    with store.write() as database:
        throw = throws.get(database, throw_id)
        target = target_of(throw)
        if body.x_m is not None and body.y_m is not None:
            x_m, y_m = body.x_m, body.y_m
        else:
            x_m, y_m = point_of(
                target, body.downrange_error_m or 0.0, body.crossrange_error_m or 0.0
            )
        impact = add_impact(
            database,
            throw,
            (x_m, y_m, target.z_m),
            "manual",
            sd_m=None,
            recorded_by=session.username,
            note=body.note.replace("\x00", ""),
        )
        audit.append(
            database,
            Entry(
                session.actor,
                "impact.mark",
                "fact",
                machine_id=throw.machine_id,
                throw_id=throw_id,
                detail={"x_m": x_m, "y_m": y_m, "note": impact.note},
            ),
        )
        database.flush()
        view = impact_view(impact, is_current=impact_views(database, throw_id)[-1].is_current)
    throws.publish(throw_id)
    return view


@router.post("/throws/{throw_id}/replay")
def replay_throw(
    throw_id: str,
    body: ReplayRequest,
    session: Viewer,
    store: DatabaseDep,
    throws: ThrowsDep,
    replays: ReplaysDep,
) -> ReplayView:
    """Show the throw in this session's 3D view."""
    with store.read() as database:
        plan_id = throws.get(database, throw_id).plan_id
    return replays.control(throw_id, plan_id, body, session)


@logs_router.put(
    "/machines/{machine_id}/throw-logs/{throw_id}",
    status_code=204,
    openapi_extra={
        "requestBody": {
            "required": True,
            "content": {"application/octet-stream": {"schema": {"type": "string"}}},
        }
    },
)
async def put_throw_log(
    machine_id: MachineCaller,
    throw_id: str,
    request: Request,
    logs: LogsDep,
    throws: ThrowsDep,
    x_content_sha256: Annotated[str, Header()] = "",
) -> Response:
    """Store a throw's log; the same upload again changes nothing."""
    if not _SHA256.fullmatch(x_content_sha256) or not _THROW_ID.fullmatch(throw_id):
        raise ApiError("bad_upload", "A throw id and X-Content-SHA256 (64 hex digits) are needed.")
    await asyncio.to_thread(logs.require_throw, machine_id, throw_id)
    scratch, size_bytes = await logs.receive(request.stream(), x_content_sha256)
    is_new = await asyncio.to_thread(
        logs.keep, scratch, machine_id, throw_id, x_content_sha256, size_bytes
    )
    if is_new:
        await asyncio.to_thread(throws.publish, throw_id)
    return Response(status_code=204)
