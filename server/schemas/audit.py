"""The audit for the console."""

from datetime import datetime
from typing import Literal

from pydantic import JsonValue

from server.schemas.console import View


class AuditRow(View):
    """One link of the audit chain."""

    sequence_count: int
    t_utc: datetime
    actor: str
    session_id: str | None
    machine_id: str | None
    throw_id: str | None
    action: str
    phase: Literal["intent", "outcome", "denied", "fact"]
    detail: JsonValue
    previous_sha256: str
    row_sha256: str


class AuditPage(View):
    """A page, newest first."""

    rows: tuple[AuditRow, ...]
    next_cursor: str | None


class AuditVerdict(View):
    """Whether the chain is whole."""

    is_intact: bool
    row_count: int
    first_bad_sequence_count: int | None
    problem: str | None
