"""The audit, for those who may read it."""

import json
from typing import Annotated

from fastapi import APIRouter, Query
from sqlalchemy import select

from server.dependencies import AuditDep, Auditor, DatabaseDep
from server.errors import ApiError
from server.schemas.audit import AuditPage, AuditRow, AuditVerdict
from server.store.models import Audit

router = APIRouter(tags=["audit"])

Name = Annotated[str | None, Query(max_length=64)]


@router.get("/audit")
def list_audit(
    session: Auditor,
    store: DatabaseDep,
    machine_id: Name = None,
    throw_id: Name = None,
    actor: Name = None,
    action: Name = None,
    cursor: Annotated[str | None, Query(max_length=20)] = None,
    limit: Annotated[int, Query(ge=1, le=500)] = 100,
) -> AuditPage:
    """Who did what, newest first."""
    query = select(Audit).order_by(Audit.sequence_count.desc()).limit(limit + 1)
    for column, value in (
        (Audit.machine_id, machine_id),
        (Audit.throw_id, throw_id),
        (Audit.actor, actor),
        (Audit.action, action),
    ):
        if value is not None:
            query = query.where(column == value)
    if cursor is not None:
        if not cursor.isdecimal():
            raise ApiError("bad_cursor", f"'{cursor}' is no cursor of the audit.")
        query = query.where(Audit.sequence_count < int(cursor[:18]))
    with store.read() as database:
        rows = database.scalars(query).all()
    return AuditPage(
        rows=tuple(_view(row) for row in rows[:limit]),
        next_cursor=str(rows[limit - 1].sequence_count) if len(rows) > limit else None,
    )


@router.get("/audit/verify")
def verify_audit(session: Auditor, audit: AuditDep) -> AuditVerdict:
    """Check the whole chain."""
    return audit.verify()


def _view(row: Audit) -> AuditRow:
    phase = row.phase if row.phase in ("intent", "outcome", "denied") else "fact"
    return AuditRow.model_validate(
        {
            "sequence_count": row.sequence_count,
            "t_utc": row.t_utc,
            "actor": row.actor,
            "session_id": row.session_id,
            "machine_id": row.machine_id,
            "throw_id": row.throw_id,
            "action": row.action,
            "phase": phase,
            "detail": json.loads(row.detail_json),
            "previous_sha256": row.previous_sha256,
            "row_sha256": row.row_sha256,
        }
    )
