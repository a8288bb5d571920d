"""Bodies of the HTTP interface for people, machines and plans; history is in `history`.

Numbers carry their unit in their name; points are in frame `machine` of the machine concerned, errors in
frame `throw`. What a client sends is checked for finite numbers and refuses unknown fields.
"""

import math
from datetime import datetime
from enum import StrEnum
from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, JsonValue, model_validator

from machine.conventions import FILLED_LINE_PATTERN, Mode
from machine.messages import MachineState, Target, ThrowState
from machine.site.zones import MAX_CORNER_COUNT, Corner


class Request(BaseModel):
    """What a client sends."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class View(BaseModel):
    """What the server answers; every field is always present."""

    model_config = ConfigDict(frozen=True, json_schema_serialization_defaults_required=True)


class ErrorDetail(View):
    """One error: a stable code, a sentence with numbers and remedy, and facts for programs."""

    code: str
    message: str
    detail: JsonValue = None


class ErrorBody(View):
    """The one shape of every error answer."""

    error: ErrorDetail


class Role(StrEnum):
    """What a person may do, from least to most."""

    VIEWER = "viewer"
    OPERATOR = "operator"
    SUPERVISOR = "supervisor"
    ENGINEER = "engineer"
    ADMIN = "admin"


class Permission(StrEnum):
    """One right; roles are sets of these (server/accounts/accounts.py)."""

    VIEW = "view"
    STOP = "stop"
    LEASE = "lease"
    THROW = "throw"
    IMPACT_MARK = "impact.mark"
    ALERT_ACKNOWLEDGE = "alert.acknowledge"
    LEASE_TAKE = "lease.take"
    STOP_CLEAR = "stop.clear"
    AUDIT_READ = "audit.read"
    GAP_RUN = "gap.run"
    TWIN_APPLY = "twin.apply"
    AIM_APPLY = "aim.apply"
    POLICY_UPLOAD = "policy.upload"
    POLICY_VALIDATE = "policy.validate"
    POLICY_APPROVE = "policy.approve"
    POLICY_DEPLOY = "policy.deploy"
    SITE_EDIT = "site.edit"
    ZONES_APPROVE = "zones.approve"
    MACHINE_EDIT = "machine.edit"
    MACHINE_ENROL = "machine.enrol"
    ADMIN = "admin"


class LoginRequest(Request):
    """A local account."""

    username: str = Field(min_length=1, max_length=64)
    password: str = Field(min_length=1, max_length=256)


class SessionView(View):
    """Who is signed in."""

    session_id: str
    """Public name of this session; leases and targets refer to it."""
    username: str
    role: Role
    permissions: tuple[Permission, ...]
    expires_utc: datetime


class TargetRequest(Request):
    """A point to hit: x and y, or range and azimuth (0 = machine x, positive to the left)."""

    x_m: float | None = Field(default=None, ge=-60.0, le=60.0)
    y_m: float | None = Field(default=None, ge=-60.0, le=60.0)
    range_m: float | None = Field(default=None, gt=0.0, le=60.0)
    azimuth_rad: float | None = Field(default=None, ge=-2.0 * math.pi, le=2.0 * math.pi)
    z_m: float = Field(default=0.0, ge=-5.0, le=10.0)
    mode: Mode | None = None

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        cartesian = self.x_m is not None and self.y_m is not None
        polar = self.range_m is not None and self.azimuth_rad is not None
        mixed = cartesian and (self.range_m is not None or self.azimuth_rad is not None)
        mixed |= polar and (self.x_m is not None or self.y_m is not None)
        if cartesian == polar or mixed:
            raise ValueError("give either x_m and y_m, or range_m and azimuth_rad")
        return self

    def target(self) -> Target:
        """The same point in x and y."""
        if self.x_m is not None and self.y_m is not None:
            return Target(x_m=self.x_m, y_m=self.y_m, z_m=self.z_m)
        range_m, azimuth_rad = self.range_m or 0.0, self.azimuth_rad or 0.0
        return Target(
            x_m=range_m * math.cos(azimuth_rad),
            y_m=range_m * math.sin(azimuth_rad),
            z_m=self.z_m,
        )


class TargetView(View):
    """A target in both forms."""

    x_m: float
    y_m: float
    z_m: float
    range_m: float
    azimuth_rad: float

    @classmethod
    def of(cls, target: Target) -> Self:
        """Both forms of a message's target."""
        return cls(
            x_m=target.x_m,
            y_m=target.y_m,
            z_m=target.z_m,
            range_m=math.hypot(target.x_m, target.y_m),
            azimuth_rad=math.atan2(target.y_m, target.x_m),
        )


class LeaseView(View):
    """Who may command a machine."""

    machine_id: str
    epoch_count: int
    holder: str | None
    """Name of the person; null when free."""
    holder_session_id: str | None
    acquired_utc: datetime | None
    expires_utc: datetime | None
    """Unless renewed before."""
    idle_release_utc: datetime | None
    """When it is given back for lack of activity."""


class TakeRequest(Request):
    """Taking a lease away needs a reason, which the other person and the audit see."""

    reason: str = Field(min_length=3, max_length=300, pattern=FILLED_LINE_PATTERN)


class LinkView(View):
    """Quality of the link to a machine."""

    is_connected: bool
    last_seen_utc: datetime | None
    last_seen_age_s: float | None
    round_trip_s: float | None
    """Of the last command that was answered."""
    state_rate_hz: float | None


class ModeReach(View):
    """What a machine's policy was trained for: the version on board; until it says which, the active one."""

    mode: Mode
    policy_id: str
    policy_sha256: str
    range_min_m: float
    range_max_m: float
    """On the ground; a raised target is reached less far."""
    raised_range_max_m: float
    """At `height_max_m`."""
    height_min_m: float
    height_max_m: float
    has_pace: bool
    """Whether the policy was trained to throw carefully or fast as asked; others throw in one way."""


class ReachView(View):
    """Radii of the rings around the machine."""

    static_reach_m: float
    modes: tuple[ModeReach, ...]


class Lamp(StrEnum):
    """The state lamp: the machine's own state, or why it is not known."""

    DISARMED = "disarmed"
    ARMED = "armed"
    ALIGNING = "aligning"
    THROWING = "throwing"
    COMMITTED = "committed"
    SETTLING = "settling"
    STOPPED = "stopped"
    FAULT = "fault"
    LOST = "lost"
    NEVER_SEEN = "never_seen"


class MachineView(View):
    """Everything the console shows about one machine."""

    machine_id: str
    site: str
    name: str
    lamp: Lamp
    lamp_text: str
    """In words: `lost since 14 s`."""
    link: LinkView
    lease: LeaseView
    state: MachineState | None
    """The last one received, with the arming checks; null before the first."""
    reach: ReachView
    target: TargetView | None
    """The proposed target of the session that asks; null in broadcasts."""
    unknown_throw_id: str | None
    """A fired throw whose answer was lost: the machine is blocked until its events tell."""
    is_stop_pending: bool
    """STOP was pressed and the machine has not confirmed it yet; it is being repeated."""


class StopClearBody(Request):
    """What a person says who clears a stop or fault; who it is comes from the session."""

    latch_id: str = Field(min_length=1, max_length=100)
    """The latch that was shown, as the machine's state names it."""
    is_sighted: Literal[True]
    """This person sees the machine, and nobody is in reach of it."""
    reason: str = Field(min_length=3, max_length=300, pattern=FILLED_LINE_PATTERN)
    """Why the machine may move again."""


class CommandView(View):
    """A command that the machine accepted."""

    machine_id: str
    state: ThrowState
    epoch_count: int
    detail: str
    is_repeat: bool


class StopView(View):
    """Answer to STOP; pending means that it is repeated until the machine confirms."""

    machine_id: str
    is_latched: bool
    is_pending: bool
    detail: str


class ZoneSketch(Request):
    """A zone on its way: corners so far, frame `machine`."""

    corners_m: tuple[Corner, ...] = Field(max_length=MAX_CORNER_COUNT)
    bottom_m: float = Field(default=0.0, ge=-5.0, le=30.0)
    top_m: float = Field(default=3.0, ge=-5.0, le=40.0)


class ViewRequest(Request):
    """What this session's 3D view shows; what is left out stays."""

    machine_id: str | None = Field(default=None, max_length=32)
    mode: Mode | None = None
    """Ground out of this mode's reach is dimmed."""
    theme: Literal["light", "dark"] | None = None
    camera: Literal["3d", "top", "side"] | None = None
    is_picking: bool | None = None
    """Whether clicks count."""
    pick_for: Literal["target", "point"] | None = None
    """Whether a click places the target, or is only reported (event `point.picked`)."""
    sketch: ZoneSketch | None = None
    """The zone that is being drawn or changed; no corners: none."""
    play_preview: bool = False
    """Play the plan's ghost once more."""


class HealthView(View):
    """Whether the service can do its work."""

    status: Literal["ok", "degraded"]
    software: str
    database: str
    link: str
    viewer: str
    preview: str
    disk: str
    machine_count: int
    connected_count: int
