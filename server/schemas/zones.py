"""Bodies of the HTTP interface for exclusion zones."""

from datetime import datetime

from pydantic import Field

from machine.conventions import FILLED_LINE_PATTERN
from machine.site.zones import Zones
from server.schemas.console import Request, View


class ZoneChangeBody(Request):
    """All zones of a machine as they shall be from the next approval on."""

    zones: Zones
    from_version_count: int = Field(ge=0)
    """Version that was changed; refused if somebody else was quicker."""
    reason: str = Field(min_length=3, max_length=300, pattern=FILLED_LINE_PATTERN)
    """Why they are changed."""


class ZoneApprovalBody(Request):
    """Approves the newest version."""

    version_count: int = Field(ge=0)
    """The version that was looked at; refused if it is not the newest."""


class ZoneVersionView(View):
    """One version: who, when, why."""

    version_count: int
    zones: Zones
    zones_sha256: str
    """Empty for no zones."""
    reason: str
    created_by: str
    created_utc: datetime
    approved_by: str | None
    """Null for a draft."""
    approved_utc: datetime | None


class ZonesView(View):
    """Exclusion zones of a machine, frame `machine`."""

    machine_id: str
    version_count: int
    """Of the newest version, draft or approved; 0 before the first."""
    zones: Zones
    """As the newest version says."""
    is_approved: bool
    """The newest version says what is approved."""
    approved: Zones
    """Approved: what previews and the machine keep out of."""
    approved_version_count: int
    approved_sha256: str
    """As the machine's state names the set on board; empty for no zones."""
    reason: str
    changed_by: str | None
    changed_utc: datetime | None
    approved_by: str | None
    """Of the approved version."""
    approved_utc: datetime | None
    undo_version_count: int | None
    """Version that undo goes back to; null when there is none."""
    drawn_by: tuple[str, ...]
    """Who had a hand in the draft since the approved zones; empty where there is no draft."""
    is_four_eyes: bool
    """Whether those may not approve it."""
