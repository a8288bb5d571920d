"""Audit."""

from typing import NoReturn

from fastapi import APIRouter, Query

from server.errors import UnavailableError
from server.schemas_history import AuditPage, AuditVerdict

router = APIRouter(tags=["audit"])


def _later() -> NoReturn:
    raise UnavailableError("not_ready", "this part of the service is not there yet")


@router.get("/audit")
def list_audit(
    machine_id: str | None = None,
    throw_id: str | None = None,
    actor: str | None = None,
    action: str | None = None,
    cursor: str | None = None,
    limit: int = Query(default=100, ge=1, le=500),
) -> AuditPage:
    """Who did what, newest first."""
    _later()


@router.get("/audit/verify")
def verify_audit() -> AuditVerdict:
    """Check the whole chain."""
    _later()
