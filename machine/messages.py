"""Every message between machine and server, in one place: JSON on Zenoh, frozen, with a schema version.

Toward the machine unknown fields are refused (it must not act on what it does not understand); from the
machine they are ignored (a fleet upgrades one machine at a time). Units stand in the names.
"""

import hashlib
import json
import math
from enum import StrEnum
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from machine.conventions import DEFAULT_PACE_RATIO, Mode
from machine.registration import MAX_CORRECTION_M
from machine.site.objects import SiteObjects
from machine.site.thrown_material import MaterialFootprint, ThrownMaterial
from machine.site.zones import ZoneSet

SCHEMA_VERSION = 1
PROTOCOL_VERSION = 4
"""What a machine of this software understands. 2: age of every command, clears that name their latch.
3: exclusion zones. 4: bulk material of a plan."""
ZONES_VERSION = 3
"""First protocol version with exclusion zones."""
MATERIAL_VERSION = 4
"""First protocol version whose plans name bulk material."""


class ThrowState(StrEnum):
    """States of the machine, as operators see them."""

    DISARMED = "disarmed"
    ARMED = "armed"
    ALIGNING = "aligning"
    THROWING = "throwing"
    COMMITTED = "committed"
    SETTLING = "settling"
    STOPPED = "stopped"
    FAULT = "fault"


class RejectReason(StrEnum):
    """Why a machine or the server refuses a command or a plan; shared by runtime, server and console."""

    WRONG_MACHINE = "wrong_machine"
    STALE_EPOCH = "stale_epoch"
    NO_LEASE = "no_lease"
    LEASE_HELD = "lease_held"
    NOT_DISARMED = "not_disarmed"
    NOT_ARMED = "not_armed"
    NONCE_UNKNOWN = "nonce_unknown"
    NONCE_EXPIRED = "nonce_expired"
    COMMAND_STALE = "command_stale"
    """A command was too long on its way, or is from before the machine's last start."""
    PLAN_MISMATCH = "plan_mismatch"
    MODEL_MISMATCH = "model_mismatch"
    POLICY_MISMATCH = "policy_mismatch"
    POLICY_UNUSABLE = "policy_unusable"
    TARGET_INVALID = "target_invalid"
    TARGET_OUT_OF_REACH = "target_out_of_reach"
    TARGET_TOO_NEAR = "target_too_near"
    TARGET_IN_ZONE = "target_in_zone"
    ZONES_MISMATCH = "zones_mismatch"
    """A plan was made with other exclusion zones than are approved, or than the machine has."""
    AIM_MISMATCH = "aim_mismatch"
    """A plan's aim correction is not in force, or not of the policy and calibration on board."""
    PREVIEW_REFUSED = "preview_refused"
    """The predicted throw should not be done."""
    PREVIEW_FAILED = "preview_failed"
    """There is no prediction: an error, or a newer preview took its place."""
    PREVIEW_INCOMPLETE = "preview_incomplete"
    """The spread of the landings is not predicted yet, or with too few throws."""
    PLAN_EXPIRED = "plan_expired"
    """The plan is too old."""
    PLAN_USED = "plan_used"
    """The plan was thrown already."""
    MACHINE_MOVED = "machine_moved"
    """The joints are not where the preview started."""
    SITE_CHANGED = "site_changed"
    """Objects or material around the machine were changed since the preview."""
    CHECK_FAILED = "check_failed"
    STOP_LATCHED = "stop_latched"
    FAULT = "fault"
    NO_PAYLOAD = "no_payload"
    BUSY = "busy"
    MALFORMED = "malformed"
    MACHINE_LOST = "machine_lost"
    UNKNOWN_OUTCOME = "unknown_outcome"


class _ToMachine(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    schema_version: Literal[1] = SCHEMA_VERSION


class _FromMachine(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore")
    schema_version: int = SCHEMA_VERSION


class Target(BaseModel):
    """A point to hit, frame `machine` of the machine that throws."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    x_m: float = Field(ge=-60.0, le=60.0)
    y_m: float = Field(ge=-60.0, le=60.0)
    z_m: float = Field(
        default=0.0, ge=-5.0, le=10.0, description="height of the target surface above ground"
    )


class AimShift(BaseModel):
    """Correction of the aim of one plan: the miss that earlier throws lead to expect without it."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    version_count: int = Field(ge=1)
    """Of the aim corrections of the machine."""
    downrange_m: float = Field(ge=-MAX_CORRECTION_M, le=MAX_CORRECTION_M)
    crossrange_m: float = Field(ge=-MAX_CORRECTION_M, le=MAX_CORRECTION_M)
    """Positive to the left."""
    policy_sha256: str
    calibration_sha256: str
    """What the machine threw with when it missed so: with anything else the correction is void."""

    def aimed(self, target: Target) -> Target:
        """The point, frame `machine`, to aim at so that loads come down at the target on average."""
        range_m = math.hypot(target.x_m, target.y_m)
        cos, sin = (target.x_m / range_m, target.y_m / range_m) if range_m > 0.0 else (1.0, 0.0)
        return target.model_copy(
            update={
                "x_m": target.x_m - cos * self.downrange_m + sin * self.crossrange_m,
                "y_m": target.y_m - sin * self.downrange_m - cos * self.crossrange_m,
            }
        )


class LandingEllipse(BaseModel):
    """Predicted spread of landings, frame `throw` (x downrange, y crossrange left of the target line)."""

    model_config = ConfigDict(frozen=True)
    mean_downrange_error_m: float
    mean_crossrange_error_m: float
    sd_downrange_m: float
    sd_crossrange_m: float
    correlation_ratio: float = Field(ge=-1.0, le=1.0)
    rollout_count: int
    landed_count: int


JointPose = tuple[float, float, float, float, float, float]
MAX_PATH_COUNT = 64
"""Poses of a plan's path: 0.1 s apart in a throw of 6 s, in 3 kB."""


class ThrowPlan(_ToMachine):
    """What the operator saw and agreed to; `plan_hash` binds it to what the machine runs."""

    plan_id: str
    machine_id: str
    mode: Mode
    target: Target
    pace_ratio: float = Field(default=DEFAULT_PACE_RATIO, ge=0.0, le=1.0)
    """0 careful .. 1 fast; policies that were not trained with a pace throw as they always do."""
    policy_sha256: str
    model_sha256: str
    twin_profile_version: int
    predicted_impact_m: tuple[float, float, float]
    predicted_ellipse: LandingEllipse | None = None
    site: SiteObjects = ()
    """What stood around the machine when the throw was previewed, frame `machine`."""
    allowed_radius_m: float | None = Field(default=None, gt=0.0, le=20.0)
    """Of the region around the target in which the machine's safety gate lets the load come down; None = its
    own default."""
    zones_sha256: str | None = None
    """Set of exclusion zones that the preview was checked against (machine.site.zones); None = no zones."""
    swept_path_rad_m: tuple[JointPose, ...] | None = Field(default=None, max_length=MAX_PATH_COUNT)
    """Joint poses of the previewed motion at equal times, from where the arm stands to the end of settling. A
    machine with exclusion zones checks them; None = the preview saw no zones."""
    aim: AimShift | None = None
    """None = the policy aims at the target; the machine's registration counts in any case."""
    material: ThrownMaterial | None = None
    """Bulk material that is thrown for a job; None = the ball. The motion is planned for the ball."""

    @property
    def aim_target(self) -> Target:
        """The point that the policy is given as its target."""
        return self.target if self.aim is None else self.aim.aimed(self.target)

    @property
    def plan_hash(self) -> str:
        """sha256 of the canonical JSON: sorted keys, no spaces, full float precision."""
        content = self.model_dump(mode="json")
        for name in ("allowed_radius_m", "zones_sha256", "swept_path_rad_m", "aim", "material"):
            if content[name] is None:
                # As hashed by software that does not know the field.
                del content[name]
        text = json.dumps(content, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()


class _Command(_ToMachine):
    """What every command carries: a repeated id is answered, not executed again."""

    command_id: str
    machine_id: str
    issuer: str


class _AgedCommand(_Command):
    """A command that says how old it can be."""

    seen_t_mono_ns: int | None = Field(default=None, ge=0)
    """Newest `t_mono_ns` of the machine's own messages that the sender had seen. The machine derives from it,
    on its own clock, the highest age of this command. Without it the command counts as too old."""


class LeaseNotice(_AgedCommand):
    """Tells the machine the current lease epoch; a higher epoch than the known one disarms."""

    kind: Literal["lease"] = "lease"
    epoch_count: int = Field(ge=0)


class ArmRequest(_AgedCommand):
    """Asks for permission to throw one plan."""

    kind: Literal["arm"] = "arm"
    epoch_count: int = Field(ge=0)
    plan: ThrowPlan


class FireRequest(_AgedCommand):
    """Starts the armed throw; valid once, and only while the machine's nonce lives."""

    kind: Literal["fire"] = "fire"
    throw_id: str
    epoch_count: int = Field(ge=0)
    nonce: str
    plan_hash: str


class AbortRequest(_AgedCommand):
    """Ends the armed or running throw; honoured until the commit point, reported after it."""

    kind: Literal["abort"] = "abort"
    epoch_count: int = Field(ge=0)


class DisarmRequest(_AgedCommand):
    """Gives an armed plan back."""

    kind: Literal["disarm"] = "disarm"
    epoch_count: int = Field(ge=0)


class StopRequest(_Command):
    """STOP: any role, no lease, no age limit; latched. It never gets fields that older machines refuse."""

    kind: Literal["stop"] = "stop"


class StopClearRequest(_AgedCommand):
    """Clears one latched stop or fault; needs the privilege and sight of the machine, then a new arm."""

    kind: Literal["stop_clear"] = "stop_clear"
    epoch_count: int = Field(ge=0)
    latch_id: str | None = None
    """The latch to clear, as the machine's state names it: a clear never undoes a later stop."""
    sighted_by: str | None = None
    """Who sees the machine and its surroundings while this is sent."""
    reason: str | None = None
    """Why the machine may move again, in that person's words."""


class LoadRequest(_AgedCommand):
    """Take up a payload (on the virtual machine: a ball appears in the gripper)."""

    kind: Literal["load"] = "load"
    epoch_count: int = Field(ge=0)


class ZonesRequest(_AgedCommand):
    """Gives the machine the approved set of exclusion zones; it keeps it over restarts.

    It needs no lease: zones only take permission away, and plans name the set that they were made with.
    """

    kind: Literal["zones"] = "zones"
    zone_set: ZoneSet


Command = (
    LeaseNotice
    | ArmRequest
    | FireRequest
    | AbortRequest
    | DisarmRequest
    | StopRequest
    | StopClearRequest
    | LoadRequest
    | ZonesRequest
)


_SINCE_VERSION_2 = frozenset({"seen_t_mono_ns", "latch_id", "sighted_by", "reason"})


def command_json(command: Command, protocol_version: int = PROTOCOL_VERSION) -> str:
    """A command as JSON that a machine of this protocol version can read."""
    if protocol_version >= 2 or isinstance(command, FireRequest):
        return command.model_dump_json(exclude_none=True)
    return command.model_dump_json(exclude=set(_SINCE_VERSION_2), exclude_none=True)


class CommandReply(_FromMachine):
    """Answer to every command. `accepted` is about this command, `state` about the machine after it."""

    command_id: str
    machine_id: str
    accepted: bool
    state: ThrowState
    epoch_count: int
    reason: RejectReason | None = None
    detail: str = ""
    """The numbers and the remedy, for people."""
    nonce: str | None = None
    nonce_valid_s: float | None = None
    throw_id: str | None = None
    is_repeat: bool = False
    latch_id: str = ""
    """The latched stop or fault after this command; empty = none."""


class OperatorHeartbeat(_ToMachine):
    """20 Hz while the operator holds the button; silence or `is_holding` false lets go."""

    machine_id: str
    throw_id: str
    epoch_count: int = Field(ge=0)
    sequence_count: int = Field(ge=0)
    is_holding: bool
    seen_t_mono_ns: int | None = Field(default=None, ge=0)
    """The machine's time at which it was sent, as far as its sender knows it: time on its way is silence."""


class CheckResult(BaseModel):
    """One arming check, as the operator reads it."""

    model_config = ConfigDict(frozen=True)
    check_id: str
    passed: bool
    severity: Literal["info", "warning", "error"]
    text: str
    remedy: str = ""


class MachineState(_FromMachine):
    """10 Hz: what the machine is doing, and whether it could throw."""

    machine_id: str
    boot_id: str
    t_mono_ns: int
    state: ThrowState
    mode: Mode | None = None
    epoch_count: int
    plan_id: str | None = None
    throw_id: str | None = None
    joint_position_rad_m: tuple[float, float, float, float, float, float]
    payload_held: bool
    stop_latched: bool
    latch_id: str = ""
    """Names the latched stop or fault, for the clear; empty = none."""
    latched_reason: str = ""
    fault: str = ""
    checks: tuple[CheckResult, ...] = ()
    model_sha256: str
    policy_sha256: dict[str, str] = {}
    """Mode -> hash of the policy on board."""
    calibration_sha256: str | None = None
    """Of valve tables and registrations on board; null = older software, which takes no aim corrections."""
    zones_sha256: str | None = None
    """Set of exclusion zones on board; empty = none are approved, null = unreadable, or older software."""
    heartbeat_age_s: float | None = None
    outbox_count: int = 0
    recorder_dropped_count: int = 0
    late_tick_ratio: float = 0.0
    operating_s: float | None = Field(default=None, ge=0.0, le=1e10)
    """Time that the control process has run since the machine is new; null = older software."""
    idle_s: float | None = Field(default=None, ge=0.0, le=1e10)
    """Of that, time without a motion of a throw."""
    software: str = ""
    protocol_version: int = 1
    """Of the machine; see `PROTOCOL_VERSION`."""


class JointStream(_FromMachine):
    """25 Hz: joints, load in flight, for the 3D view."""

    machine_id: str
    t_mono_ns: int
    joint_position_rad_m: tuple[float, float, float, float, float, float]
    joint_velocity_rad_m_per_s: tuple[float, float, float, float, float, float]
    state: ThrowState
    payload_held: bool
    ball_position_m: tuple[float, float, float] | None = None
    """A tracked load in flight, frame `machine`; null when held or not tracked."""


class EventKind(StrEnum):
    """Durable events: each reaches the server's database exactly once."""

    BOOTED = "booted"
    ARMED = "armed"
    DISARMED = "disarmed"
    THROW_ACCEPTED = "throw_accepted"
    THROW_STARTED = "throw_started"
    RELEASE_COMMANDED = "release_commanded"
    ABORTED = "aborted"
    IMPACT = "impact"
    THROW_ENDED = "throw_ended"
    STOP_LATCHED = "stop_latched"
    STOP_CLEARED = "stop_cleared"
    FAULT = "fault"
    COMMAND_REFUSED = "command_refused"
    LOG_STORED = "log_stored"
    POLICY_SWITCHED = "policy_switched"
    POLICY_REFUSED = "policy_refused"


class MachineEvent(_FromMachine):
    """One record of the outbox; unique by (machine_id, boot_id, sequence_count)."""

    machine_id: str
    boot_id: str
    sequence_count: int
    t_mono_ns: int
    t_utc: str
    """ISO 8601 with zone, for people; order comes from the sequence."""
    kind: EventKind
    throw_id: str | None = None
    plan_id: str | None = None
    data: dict[str, Any] = {}
    """IMPACT: ImpactSurvey; THROW_ENDED: ThrowEnd; LOG_STORED: {log_sha256, size_bytes};
    POLICY_SWITCHED and POLICY_REFUSED: {mode, policy_sha256, deployment_count, ...}; else details."""


class ImpactSurvey(_FromMachine):
    """Where a load came down, as measured; frame `machine`."""

    position_m: tuple[float, float, float]
    sd_m: float
    source: Literal["survey", "tracker", "manual"]
    footprint: MaterialFootprint | None = None
    """Of bulk material; `position_m` is then its centre. None = a ball, or not measured."""


class ThrowEnd(_FromMachine):
    """How a throw ended."""

    outcome: Literal["landed", "aborted", "stopped", "fault", "interrupted"]
    detail: str = ""
    is_policys_own: bool | None = None
    """Of an abort: whether what the policy did is its reason; None from older software."""
    release_speed_m_per_s: float | None = None
    release_position_m: tuple[float, float, float] | None = None
    throw_duration_s: float | None = None


class EventBatch(_FromMachine):
    """Outbox records in order, sent to the server as one query; the answer is an `EventAck`."""

    machine_id: str
    boot_id: str
    events: tuple[MachineEvent, ...]


class EventAck(BaseModel):
    """The server has committed all events of this boot up to and including this sequence."""

    model_config = ConfigDict(frozen=True)
    boot_id: str
    sequence_count: int
