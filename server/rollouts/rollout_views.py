"""Bodies of the HTTP interface for rollouts of policy versions."""

from datetime import datetime
from enum import StrEnum
from typing import Literal

from pydantic import Field

from evaluation.measures import Estimate
from machine.conventions import Mode
from server.schemas.console import Request, View
from server.schemas.deployments import DeployRequest, RollBackRequest

StageTest = Literal["waiting", "asked", "testing", "passed", "worse", "error"]


class RolloutState(StrEnum):
    """Where a rollout stands."""

    RUNNING = "running"
    PAUSED = "paused"
    COMPLETED = "completed"
    ABORTED = "aborted"
    ROLLED_BACK = "rolled_back"
    """Its throws were worse: every machine was asked to go back."""


class StageRequest(Request):
    """Machines that get the version together: by name, by tag, or both."""

    machine_ids: tuple[str, ...] = Field(default=(), max_length=200)
    tags: tuple[str, ...] = Field(default=(), max_length=20)


class RolloutRequest(DeployRequest):
    """Brings a version to machines in stages."""

    stages: tuple[StageRequest, ...] = Field(min_length=1, max_length=10)
    throws_count: int = Field(default=12, ge=4, le=200)
    """Measured throws of a machine until it has passed."""
    deadline_s: float = Field(default=600.0, ge=10.0, le=7 * 86_400.0)
    """Within which a machine has to switch."""


class RolloutChangeRequest(RollBackRequest):
    """Pauses, resumes, promotes or aborts a rollout."""


class StagePlan(View):
    """A stage as it was resolved when the rollout began."""

    name: str
    machine_ids: tuple[str, ...]


class ThrowFigures(View):
    """Misses of throws, m, with 95 % intervals."""

    throw_count: int
    mean_downrange_error_m: Estimate
    sd_downrange_m: Estimate
    mean_crossrange_error_m: Estimate
    sd_crossrange_m: Estimate


class RolloutMachineView(View):
    """A machine of a rollout."""

    machine_id: str
    stage_count: int
    state: StageTest
    sentence: str
    """What is wrong with it; empty where nothing is."""
    failed_count: int
    """Throws with the version that failed."""
    before_policy_id: str | None
    before: ThrowFigures | None
    """Newest throws with the version before; None before it was asked."""
    since: ThrowFigures | None
    """Throws with the version; None before it was asked."""


class RolloutStepView(View):
    """What happened, when and by whom."""

    state: RolloutState
    stage_count: int
    actor: str
    sentence: str
    at_utc: datetime


class RolloutView(View):
    """A rollout with its machines."""

    rollout_id: str
    mode: Mode
    policy_sha256: str
    policy_id: str
    state: RolloutState
    stage_count: int
    """The stage that is under way, from 0."""
    stages: tuple[StagePlan, ...]
    machines: tuple[RolloutMachineView, ...]
    steps: tuple[RolloutStepView, ...]
    """Oldest first."""
    reason: str
    throws_count: int
    deadline_s: float
    false_alarm_ratio: float
    """Share of rollouts of a version that is no worse that are rolled back, at most."""
    created_by: str
    created_utc: datetime


class ChannelsView(View):
    """Versions of a mode by channel."""

    mode: Mode
    candidate_policy_id: str | None
    """Of the open rollout."""
    stable_policy_id: str | None
    """Of the newest completed rollout; before one, the active version of the policies folder."""
