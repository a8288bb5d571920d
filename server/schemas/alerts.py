"""Alerts as the console and programs see them."""

from datetime import datetime
from enum import StrEnum
from typing import Literal

from pydantic import Field

from machine.conventions import LINE_PATTERN
from server.schemas.console import Request, View

MAX_SILENCE_S = 86_400.0
"""A silence outlasts no day: whoever comes on shift decides anew."""


class AlertRule(StrEnum):
    """What an alert is about (server/alerts/alert_rules.py)."""

    LOST = "lost"
    STOPPED = "stopped"
    FAULT = "fault"
    ARM_REFUSED = "arm_refused"
    RECORDS = "records"
    CLOCK = "clock"
    DISK = "disk"
    CERTIFICATE = "certificate"
    EXPIRED = "expired"
    """The certificate has run out."""
    DRIFT = "drift"
    ROLLOUT = "rollout"
    """A rollout is paused."""


AlertSeverity = Literal["warning", "error"]


class AlertView(View):
    """One alert; at most one of a rule and machine is open at a time."""

    alert_id: str
    rule: AlertRule
    severity: AlertSeverity
    machine_id: str | None
    """None: it is about the server."""
    text: str
    opened_utc: datetime
    seen_utc: datetime
    """When its condition was last found."""
    cleared_utc: datetime | None
    acknowledged_by: str | None
    acknowledged_utc: datetime | None
    note: str
    """What the person said who acknowledged it."""
    silenced_until_utc: datetime | None
    """Until then it calls nobody; the next alert of its rule and machine neither."""
    silenced_by: str | None


class AlertPage(View):
    """Alerts, newest first."""

    rows: tuple[AlertView, ...]
    next_cursor: str | None


class AcknowledgeRequest(Request):
    """A person has seen an alert."""

    note: str = Field(default="", max_length=500, pattern=LINE_PATTERN)


class SilenceRequest(Request):
    """An alert is to call nobody for a while."""

    duration_s: float = Field(ge=0.0, le=MAX_SILENCE_S)
    """From now; 0 ends the silence."""
