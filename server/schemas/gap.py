"""Bodies of the HTTP interface for diagnoses of machines against their twins, and for twin profiles."""

from datetime import datetime
from enum import StrEnum
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from diagnosis.report.diagnosis_words import DiagnosisWords, FactWords
from diagnosis.verdict import Diagnosis, VerdictKind
from machine.conventions import Mode
from server.schemas.console import Request, TargetView, View
from server.schemas.plans import PredictionView, RefusalView
from sim_twin.effects.effect import Effect

MIN_THROWS_COUNT = 6
MAX_THROWS_COUNT = 60
MIN_REFERENCE_THROWS_COUNT = 3
MAX_MATERIAL_M = 1.0


class GapState(StrEnum):
    """Life of a diagnosis."""

    QUEUED = "queued"
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"
    INTERRUPTED = "interrupted"
    """The server ended while it ran or waited."""


ThrowId = Annotated[str, Field(max_length=64)]


class GapRunRequest(Request):
    """Diagnose a machine: throws by name, or its newest ones that landed and have a log."""

    throw_ids: tuple[ThrowId, ...] | None = Field(
        default=None, min_length=MIN_THROWS_COUNT, max_length=MAX_THROWS_COUNT
    )
    newest_count: int | None = Field(default=None, ge=MIN_THROWS_COUNT, le=MAX_THROWS_COUNT)
    mode: Mode | None = None
    """With `newest_count`: only throws of this mode."""
    reference_throw_ids: tuple[ThrowId, ...] | None = Field(
        default=None, min_length=MIN_REFERENCE_THROWS_COUNT, max_length=MAX_THROWS_COUNT
    )
    """Throws of this machine while it was healthy, to compare with. `newest_count` leaves them out."""
    against: Literal["kept", "type"] | None = None
    """Without `reference_throw_ids`: `type` compares with healthy machines of the type; else the kept
    reference throws of the machine are compared with, if there are enough."""

    material_m: float | None = Field(default=None, gt=0.0, le=MAX_MATERIAL_M)
    """An effect that moves the impact by less is reported as seen, not claimed."""

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        if (self.throw_ids is None) == (self.newest_count is None):
            raise ValueError("give either throw_ids or newest_count")
        if self.throw_ids is not None and self.mode is not None:
            raise ValueError("mode goes with newest_count; throw_ids name the throws already")
        for named in (self.throw_ids or (), self.reference_throw_ids or ()):
            if len(set(named)) < len(named):
                raise ValueError("a throw is named twice")
        both = set(self.throw_ids or ()) & set(self.reference_throw_ids or ())
        if both:
            raise ValueError(
                f"{len(both)} throws are to be diagnosed and to be compared with: {min(both)}. "
                "Leave them out of one of the two"
            )
        return self


class KeptReferenceView(View):
    """Reference throws that are kept for a machine."""

    day_throw_count: dict[str, int]
    """Number of throws by day, YYYY-MM-DD, oldest first."""
    throw_count: int
    is_used: bool
    """Whether there are enough for a diagnosis to compare with."""
    words: str
    """What there is, and what is recommended."""


class CommissionedStepView(View):
    """One step of a commissioning."""

    name: str
    done_utc: str | None
    """YYYY-MM-DDTHH:MM:SSZ; None: not yet."""
    words: str
    """What was measured."""


class CommissionedJointView(View):
    """What the twin's drive of one joint explains of motions that it was not fitted to."""

    joint: str
    model: str
    explained_ratio: float
    """Share of the variance of the speed."""
    linear_explained_ratio: float
    """The same of the linear drive."""
    rest: str
    """Where most of the rest lies."""
    at_bound: tuple[str, ...]
    """Parameters at an end of the range that was searched."""


class CommissioningView(View):
    """The last commissioning of a machine."""

    command: str
    """Command that commissions it, or goes on with it; PLANT stands for what is driven."""
    steps: tuple[CommissionedStepView, ...]
    joints: tuple[CommissionedJointView, ...]
    quantities: tuple[FactWords, ...]
    """Identified numbers with their intervals."""
    flags: tuple[str, ...]
    """What an engineer should look at."""
    reference: str
    """Kept reference throws, and what is recommended."""
    has_report: bool
    problem: str
    """Why nothing is shown of it; empty where there is none."""


class GapRunRow(View):
    """One line of the history of diagnoses."""

    gap_run_id: str
    machine_id: str
    created_by: str
    created_utc: datetime
    started_utc: datetime | None
    ended_utc: datetime | None
    state: GapState
    progress_ratio: float
    step: str
    """What is being done."""
    usual_s: tuple[float, float] | None = None
    """Shortest and longest time of earlier diagnoses like it, while it waits or runs; None without any."""
    detail: str
    """Why it has no result."""
    throw_count: int
    reference_throw_count: int
    """Healthy throws of this machine that it is compared with; 0: healthy machines of the type."""
    compared_with: str
    """The same in words."""
    profile_version_count: int
    verdict: VerdictKind | None
    sentence: str
    effect_count: int
    """Effects that can be applied to the twin."""
    applied_version_count: int | None


class GapRunPage(View):
    """Diagnoses of a machine, newest first; pass `next_cursor` to go on."""

    rows: tuple[GapRunRow, ...]
    next_cursor: str | None


class GapRunView(View):
    """One diagnosis."""

    row: GapRunRow
    throw_ids: tuple[str, ...]
    reference_throw_ids: tuple[str, ...]
    result: Diagnosis | None
    words: DiagnosisWords | None
    """Texts of the result."""


class GapSideView(View):
    """What one version of the twin says a throw would do."""

    version_count: int
    prediction: PredictionView | None
    refusals: tuple[RefusalView, ...]


class GapPreviewView(View):
    """A throw previewed without and with what a diagnosis found, all else equal."""

    machine_id: str
    mode: Mode
    target: TargetView
    is_machine_pose: bool
    """From the pose in which the machine stands; else from the pose for throwing."""
    before: GapSideView
    after: GapSideView


class TwinVersionView(View):
    """Where a version of a twin profile came from."""

    version_count: int
    before_version_count: int | None
    cause: Literal["applied", "undone"]
    gap_run_id: str | None
    created_by: str
    created_utc: datetime


class TwinProfileView(View):
    """The twin profile that previews of a machine use now."""

    machine_id: str
    version_count: int
    note: str
    effects: tuple[Effect, ...]
    undo_version_count: int | None
    """Version whose content undo brings back; null when there is nothing to undo."""
    versions: tuple[TwinVersionView, ...]
    """Newest first."""
