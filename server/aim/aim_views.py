"""Bodies of the HTTP interface for aim corrections; misses are in frame `throw`, in m."""

from datetime import datetime
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from machine.conventions import Mode
from machine.registration import Registration
from server.schemas.console import Request, View


class AimProposal(BaseModel):
    """A correction, what it was made from, and what it is worth."""

    model_config = ConfigDict(frozen=True, json_schema_serialization_defaults_required=True)
    table: Registration
    """Mean miss over the range; loads are aimed by as much the other way."""
    downrange_sd_m: tuple[float, ...]
    """Standard deviation of the mean miss at the table's ranges."""
    crossrange_sd_m: tuple[float, ...]
    throw_count: int
    newest_throw_id: str
    before_m: float
    """Mean distance from the target on held-out throws, with what is in force."""
    after_m: float
    """The same with this correction."""
    gain_low_m: float
    """90 % interval of the difference."""
    gain_high_m: float


class AimVersionView(View):
    """One version; in force where it has no end."""

    version_count: int
    mode: Mode
    policy_sha256: str
    policy_id: str
    cause: Literal["applied", "undone"]
    created_by: str
    created_utc: datetime
    ended_utc: datetime | None
    ended_by: str | None
    end_reason: str
    content: AimProposal


class AimModeView(View):
    """The aim of a machine in one mode."""

    mode: Mode
    in_force: AimVersionView | None
    proposal: AimProposal | None
    proposal_sha256: str | None
    """Names the proposal when it is applied."""
    throw_count: int
    """Measured throws with the policy, calibration and twin profile of now."""
    problem: str
    """Why nothing is proposed; empty where something is."""


class AimView(View):
    """Aim corrections of a machine."""

    machine_id: str
    modes: tuple[AimModeView, ...]
    history: tuple[AimVersionView, ...]
    """Newest first."""


class AimApplyRequest(Request):
    """Put the proposal that was shown in force."""

    proposal_sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
