"""Bodies of the HTTP interface for the life of policy versions."""

from datetime import datetime
from enum import StrEnum

from pydantic import Field, JsonValue

from machine.conventions import FILLED_LINE_PATTERN
from server.schemas.console import Request, View


class PolicyState(StrEnum):
    """Where a version is in its life."""

    UPLOADED = "uploaded"
    VALIDATING = "validating"
    VALIDATED = "validated"
    APPROVED = "approved"
    """The site has signed it: machines may load it."""
    RETIRED = "retired"
    """For good: nothing is done with it any more."""


class TransitionRequest(Request):
    """Moves a version on."""

    reason: str = Field(min_length=3, max_length=300, pattern=FILLED_LINE_PATTERN)
    """Why, for the history."""


class ApproveRequest(TransitionRequest):
    """Approves a version."""

    is_without_validation: bool = False
    """Though no validation of these files passed the gates in force; kept in history and audit."""


class ApprovalBasisView(View):
    """What an approval would rest on now."""

    is_validated: bool
    """The newest validation of these files passed the gates in force."""
    sentence: str


class SiteKeyView(View):
    """A key by which the site approves versions."""

    key_id: str
    public_key: str
    """Base64 of the 32 bytes."""
    is_signing: bool
    """It signs approvals and the list of them."""
    is_revoked: bool
    since_utc: datetime | None
    """None: made at a first start of older software."""
    made_by: str
    revoked_utc: datetime | None
    revoked_by: str | None
    approval_count: int
    """Approvals in the list that it has signed."""
    machine_ids: tuple[str, ...]
    """Machines that trust it, as they last said."""


class PolicyTransitionView(View):
    """One step in the life of a version."""

    from_state: PolicyState | None
    """None: the server met the version."""
    to_state: PolicyState
    actor: str
    at_utc: datetime
    reason: str
    evidence: dict[str, JsonValue]
    """Facts that the step rests on, for example measured accuracy or the key that signed."""
