"""Bodies of the HTTP interface for plans and throws in the making: preview, arm, fire, hold."""

from datetime import datetime
from enum import StrEnum
from typing import Literal

from pydantic import Field

from machine.conventions import DEFAULT_PACE_RATIO, Mode
from machine.messages import AimShift, LandingEllipse
from machine.site.objects import GROUND
from machine.site.thrown_material import ThrownMaterial
from server.schemas.console import Request, TargetRequest, TargetView, View


class PlanRequest(Request):
    """Preview a throw."""

    mode: Mode
    target: TargetRequest
    pace_ratio: float = Field(default=DEFAULT_PACE_RATIO, ge=0.0, le=1.0)
    """0 careful .. 1 fast."""
    rollout_count: int = Field(default=200, ge=0, le=1000)
    """Throws behind the landing ellipse; with fewer than 50 the plan is to look at and cannot be armed."""


class PlanState(StrEnum):
    """Life of a plan."""

    PREVIEWING = "previewing"
    READY = "ready"
    REFUSED = "refused"
    FAILED = "failed"


class RefusalView(View):
    """Why a plan may not be thrown, with numbers and remedy."""

    reason: str
    detail: str
    surface_m: float | None = None
    """Height that puts the target on a surface, where that is what is wrong."""


class ClearanceView(View):
    """Distance to a limit at the nearest moment; metres or radians, the other pair is null."""

    name: str
    value_m: float | None
    limit_m: float | None
    value_rad: float | None
    limit_rad: float | None
    at_s: float
    """When, from the first frame of the plan."""


class PredictionView(View):
    """What the twin says a throw will do."""

    impact_m: tuple[float, float, float]
    downrange_error_m: float
    crossrange_error_m: float
    ellipse: LandingEllipse | None
    """Null until enough of the rollouts are done."""
    release_s: float
    flight_s: float
    duration_s: float
    release_speed_m_per_s: float
    lands_on: str = GROUND
    """Name of what the load touches first."""
    clearances: tuple[ClearanceView, ...]
    ball_path_m: tuple[tuple[float, float, float], ...]
    compute_s: float


class PlanView(View):
    """A plan: target, policy, and what the twin predicts."""

    plan_id: str
    machine_id: str
    state: PlanState
    mode: Mode
    target: TargetView
    pace_ratio: float
    policy_id: str | None
    policy_sha256: str | None
    model_sha256: str
    twin_profile_version: int
    aim: AimShift | None
    """Aim correction that the machine throws with."""
    material: ThrownMaterial | None
    """Bulk material of the load; the prediction is for a ball."""
    plan_hash: str | None
    """Binds what is shown to what runs; changes until the preview is complete, fixed by arming."""
    is_complete: bool
    """The landing ellipse is final."""
    refusals: tuple[RefusalView, ...]
    prediction: PredictionView | None
    created_by: str
    created_utc: datetime
    expires_utc: datetime


class PlanFrames(View):
    """The predicted motion, for an animation."""

    plan_id: str
    frame_period_s: float
    frames_rad_m: tuple[tuple[float, ...], ...]
    """Joint positions, joint order, 50 Hz."""
    release_s: float | None
    """From the first frame; null when nothing is released."""
    flight_s: float | None
    ball_path_m: tuple[tuple[float, float, float], ...]
    """Equal times from release to impact."""


class ArmBody(Request):
    """Arm a plan; with the hash that was shown, a plan that changed since is refused."""

    plan_hash: str | None = Field(default=None, pattern=r"^[0-9a-f]{64}$")


class ArmView(View):
    """The machine is armed for this plan."""

    plan_id: str
    machine_id: str
    plan_hash: str
    epoch_count: int
    valid_s: float
    """How long the machine waits for fire, on its own clock."""


class FireView(View):
    """The throw has a name from now on, whatever the machine answered."""

    throw_id: str
    machine_id: str
    state: Literal["accepted", "unknown"]
    detail: str


class HoldMessage(Request):
    """Browser to server on the hold WebSocket, 20 Hz."""

    throw_id: str = Field(max_length=64)
    holding: bool
    machine_t_mono_ns: int | None = Field(default=None, ge=0, lt=2**63)
    """That of the newest reply, ns of the machine's clock; a hold without it is answered, not passed on."""


class HoldReply(View):
    """Server to browser on the hold WebSocket, one a message: passed on, or why the hold does not count."""

    throw_id: str
    is_relayed: bool
    detail: str
    machine_t_mono_ns: int | None
    """Time of the machine's clock, ns, for the next message: its age is the time on the way."""
