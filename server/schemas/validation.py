"""Bodies of the HTTP interface for validations of policy versions, gates, and comparisons."""

from datetime import datetime
from enum import StrEnum
from typing import Literal

from pydantic import AwareDatetime, Field

from evaluation.shadow.results import ShadowFigures, ShadowReport
from evaluation.validation.gates import Gates
from evaluation.validation.results import ValidationPlan
from evaluation.validation.validation import ValidationResult
from machine.conventions import FILLED_LINE_PATTERN, Mode
from server.schemas.console import Request, View
from server.schemas.history import ThrowStats
from sim_twin.confidence_intervals import Interval
from sim_twin.throws.accuracy_comparison import Verdict

MAX_THROWS_PER_TARGET = 1000
MAX_UNSEEN_UNITS = 50
MAX_SHADOW_THROWS = 48


class ValidationState(StrEnum):
    """Life of a validation; a restart of the server goes on with what is open."""

    QUEUED = "queued"
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"


class ValidationRequest(Request):
    """Validate a version."""

    protocol: Literal["short", "full"] = "short"
    throws_per_target: int | None = Field(default=None, ge=2, le=MAX_THROWS_PER_TARGET)
    """Instead of the protocol's."""
    unseen_unit_count: int | None = Field(default=None, ge=0, le=MAX_UNSEEN_UNITS)
    """Instead of the protocol's."""


class ShadowRequest(Request):
    """Run a version over recorded throws of its mode."""

    machine_id: str | None = Field(default=None, min_length=1, max_length=32)
    """None: throws of all machines."""
    since_utc: AwareDatetime | None = None
    until_utc: AwareDatetime | None = None
    throws_count: int = Field(default=12, ge=1, le=MAX_SHADOW_THROWS)
    """The newest in the period."""


class ShadowRunSummary(View):
    """A shadow that was run, without its throws."""

    shadow_id: str
    policy_sha256: str
    policy_id: str
    machine_id: str | None
    """As asked for; None: all machines."""
    since_utc: datetime | None
    until_utc: datetime | None
    created_by: str
    created_utc: datetime
    figures: ShadowFigures


class ShadowRunView(ShadowRunSummary):
    """A shadow that was run."""

    report: ShadowReport


class ValidationView(View):
    """A validation of a version."""

    validation_id: str
    policy_sha256: str
    policy_id: str
    active_sha256: str | None
    """Version that throws beside it."""
    created_by: str
    created_utc: datetime
    started_utc: datetime | None
    ended_utc: datetime | None
    state: ValidationState
    progress_ratio: float
    step: str
    """What is being done."""
    detail: str
    """Why it has no result."""
    plan: ValidationPlan
    gates: Gates
    is_passed: bool | None
    result: ValidationResult | None


class GatesView(View):
    """Gates of a mode that the next validation is checked against."""

    mode: Mode
    gates: Gates
    defaults: Gates
    version_count: int
    """0: nobody has set any, the defaults are in force."""
    reason: str
    set_by: str | None
    set_utc: datetime | None


class GatesRequest(Request):
    """Sets the gates of a mode."""

    gates: Gates
    reason: str = Field(min_length=3, max_length=300, pattern=FILLED_LINE_PATTERN)
    """Why, for the history."""


class DifferenceView(View):
    """One quantity at one target range, of two versions."""

    range_m: float
    height_m: float
    quantity: str
    a: float | None
    b: float | None
    """m, or a share of the throws."""
    difference: Interval | None
    """b minus a; for standard deviations b over a."""
    verdict: Verdict
    """Of b beside a."""
    a_throw_count: int
    b_throw_count: int


class ComparisonSource(StrEnum):
    """Throws that a comparison rests on."""

    VALIDATION = "validation"
    HISTORY = "history"


class ComparisonView(View):
    """Two versions by one source of throws."""

    source: ComparisonSource
    basis: str
    """Which throws, in words; or why there is no comparison."""
    differences: tuple[DifferenceView, ...]
    """Empty where there is no comparison."""
    stats: ThrowStats | None
    """Landings of both for the plots; groups are the versions' hashes."""


class PolicyComparisonView(View):
    """Two versions side by side."""

    a_sha256: str
    a_policy_id: str
    b_sha256: str
    b_policy_id: str
    mode: Mode
    comparisons: tuple[ComparisonView, ...]
