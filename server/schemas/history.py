"""Bodies of the HTTP interface for throws, statistics, and policies.

Errors are in frame `throw`: downrange positive when long, crossrange positive to the left of the line
from the slew axis to the target.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from typing import Literal, Self

from pydantic import Field, JsonValue, model_validator

from machine.conventions import LINE_PATTERN, Mode
from machine.messages import EventKind
from machine.policy_card import PolicyCard
from server.schemas.console import Request, TargetView, View
from server.schemas.plans import PlanView
from server.schemas.policies import PolicyState


class ThrowPhase(StrEnum):
    """Where a throw is, as the server knows it."""

    REQUESTED = "requested"
    UNKNOWN = "unknown"
    ACCEPTED = "accepted"
    ALIGNING = "aligning"
    THROWING = "throwing"
    COMMITTED = "committed"
    SETTLING = "settling"
    ENDED = "ended"


class Outcome(StrEnum):
    """How a throw ended."""

    LANDED = "landed"
    ABORTED = "aborted"
    STOPPED = "stopped"
    FAULT = "fault"
    INTERRUPTED = "interrupted"
    REFUSED = "refused"
    NOT_EXECUTED = "not_executed"


class ThrowRow(View):
    """One line of the history."""

    throw_id: str
    machine_id: str
    plan_id: str
    created_utc: datetime
    operator: str
    mode: Mode
    target: TargetView
    pace_ratio: float
    """0 careful .. 1 fast."""
    policy_id: str
    policy_sha256: str
    phase: ThrowPhase
    outcome: Outcome | None
    detail: str
    predicted_downrange_error_m: float | None
    predicted_crossrange_error_m: float | None
    predicted_sd_downrange_m: float | None
    predicted_sd_crossrange_m: float | None
    measured_downrange_error_m: float | None
    """Of the impact that counts: the newest manual mark, else the newest survey."""
    measured_crossrange_error_m: float | None
    impact_source: str | None
    release_speed_m_per_s: float | None
    throw_duration_s: float | None
    has_log: bool


class ThrowPage(View):
    """A page, newest first; pass `next_cursor` to go on."""

    rows: tuple[ThrowRow, ...]
    next_cursor: str | None


class ImpactView(View):
    """One record of where the load came down; records are only ever added."""

    impact_id: str
    throw_id: str
    source: Literal["survey", "tracker", "manual"]
    x_m: float
    y_m: float
    z_m: float
    downrange_error_m: float
    crossrange_error_m: float
    sd_m: float | None
    recorded_by: str
    note: str
    created_utc: datetime
    is_current: bool


class ImpactRequest(Request):
    """Where the operator saw it come down: errors in frame `throw`, or a point in frame `machine`."""

    downrange_error_m: float | None = Field(default=None, ge=-60.0, le=60.0)
    crossrange_error_m: float | None = Field(default=None, ge=-60.0, le=60.0)
    x_m: float | None = Field(default=None, ge=-120.0, le=120.0)
    y_m: float | None = Field(default=None, ge=-120.0, le=120.0)
    note: str = Field(default="", max_length=500, pattern=LINE_PATTERN)

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        errors = (self.downrange_error_m is not None, self.crossrange_error_m is not None)
        point = (self.x_m is not None, self.y_m is not None)
        if all(errors) == all(point) or (any(errors) and any(point)):
            raise ValueError("give either downrange_error_m and crossrange_error_m, or x_m and y_m")
        return self


class ThrowEventView(View):
    """An event of a throw, as the machine reported it."""

    boot_id: str
    sequence_count: int
    t_mono_ns: int
    t_utc: str
    kind: EventKind
    data: JsonValue


class ThrowLogView(View):
    """The throw's log file."""

    log_sha256: str
    size_bytes: int
    received_utc: datetime


class ThrowDetail(View):
    """Everything about one throw."""

    row: ThrowRow
    plan: PlanView | None
    epoch_count: int
    impacts: tuple[ImpactView, ...]
    events: tuple[ThrowEventView, ...]
    log: ThrowLogView | None


class PhaseBand(View):
    """A phase of a throw on the time axis."""

    name: str
    start_s: float
    end_s: float


class ThrowSeries(View):
    """Time series of a throw from its log; units stand in the column names."""

    throw_id: str
    t_s: tuple[float, ...]
    """Since the first control tick of the log."""
    columns: dict[str, Sequence[float | None]]
    phases: tuple[PhaseBand, ...]
    release_s: float | None
    impact_s: float | None
    ball_t_s: tuple[float, ...]
    ball_position_m: tuple[tuple[float, float, float], ...]


class ReplayRequest(Request):
    """Show a recorded throw in this session's 3D view: at a moment, playing, or stop showing it."""

    at_s: float | None = Field(default=None, ge=0.0, le=3600.0)
    playing: bool | None = None
    close: bool = False


class ReplayView(View):
    """What the 3D view now shows."""

    throw_id: str
    duration_s: float
    at_s: float
    is_playing: bool


class GroupBy(StrEnum):
    """What tells groups of the statistics apart."""

    POLICY = "policy"
    MODE = "mode"
    MACHINE = "machine"
    OPERATOR = "operator"


class GroupStats(View):
    """Accuracy of one group and its 1 sigma ellipse."""

    group: str
    label: str
    throw_count: int
    mean_downrange_error_m: float
    mean_crossrange_error_m: float
    sd_downrange_m: float | None
    """Null below two throws."""
    sd_crossrange_m: float | None
    correlation_ratio: float | None
    ellipse_major_m: float | None
    """Semi-axis, 1 sigma."""
    ellipse_minor_m: float | None
    ellipse_angle_rad: float | None
    """From downrange to the major axis, positive to the left."""
    mean_miss_m: float
    median_miss_m: float


# No model: statistics hold thousands of these, and a model takes eight times as long to make.
@dataclass(slots=True)
class ScatterPoint:
    """One landing in throw coordinates."""

    throw_id: str
    group: str
    range_m: float
    downrange_error_m: float
    crossrange_error_m: float
    predicted_downrange_error_m: float | None
    predicted_crossrange_error_m: float | None


class RangeStats(View):
    """Accuracy of one group in a bin of target ranges."""

    group: str
    range_m: float
    """Mean target range of the bin's throws."""
    throw_count: int
    mean_downrange_error_m: float
    mean_crossrange_error_m: float
    sd_downrange_m: float | None
    sd_crossrange_m: float | None


class ThrowStats(View):
    """Accuracy over the newest throws that match, with a measured impact."""

    considered_count: int
    is_truncated: bool
    """There are more; only the newest `considered_count` were used."""
    group_by: GroupBy
    groups: tuple[GroupStats, ...]
    points: tuple[ScatterPoint, ...]
    by_range: tuple[RangeStats, ...]


class PolicyView(View):
    """A policy version that the server knows."""

    policy_id: str
    policy_sha256: str
    mode: Mode
    state: PolicyState
    is_active: bool
    is_present: bool
    """Its files are in the policies folder."""
    problem: str | None
    first_seen_utc: datetime
    throw_count: int
    card: PolicyCard
