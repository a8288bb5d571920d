"""Bodies of the HTTP interface for policies on machines."""

from datetime import datetime
from enum import StrEnum

from pydantic import Field

from machine.conventions import FILLED_LINE_PATTERN, Mode
from machine.policy_approval import SiteTrust
from server.schemas.console import Request, View


class MachinePolicyView(View):
    """The policy of one mode."""

    mode: Mode
    policy_sha256: str | None
    """None: no usable policy was on board."""
    policy_id: str | None
    since_utc: datetime
    """By the machine's clock."""
    version_before: str | None
    """Id of the version that a rollback asked for now goes to; None where there is none."""
    rolled_back_from: str | None
    """Id of the version that the machine had until a rollback brought the one on board; else None."""


class MachinePoliciesView(View):
    """What a machine had on board at a time."""

    machine_id: str
    at_utc: datetime
    policies: tuple[MachinePolicyView, ...]
    """Empty before the machine's first start."""


class RollBackRequest(Request):
    """Goes back to the version that the machine had before."""

    reason: str = Field(min_length=3, max_length=300, pattern=FILLED_LINE_PATTERN)
    """Why, for the history."""


class DeployRequest(RollBackRequest):
    """Asks a machine to switch to a version."""

    policy_sha256: str = Field(pattern=r"^[0-9a-f]{64}$")


class ChangeCause(StrEnum):
    """Why the policy on a machine changed."""

    DEPLOYED = "deployed"
    ROLLED_BACK = "rolled_back"
    """A person or a rollout asked the server for it."""
    AT_MACHINE = "at_machine"
    """Rolled back at the machine itself."""


class DeploymentOutcome(StrEnum):
    """What became of a deployment."""

    PENDING = "pending"
    """The machine has not answered: it is off, fetches the version, or has a plan armed."""
    SWITCHED = "switched"
    REFUSED = "refused"
    """The machine cannot use the version; `detail` says why. It throws with the one it had."""
    REPLACED = "replaced"
    """A newer deployment took its place first."""


class DeploymentView(View):
    """Who wanted which version on a machine, when and why, and what became of it."""

    machine_id: str
    mode: Mode
    deployment_count: int | None
    """None: a rollback at the machine itself."""
    policy_sha256: str
    policy_id: str
    is_rollback: bool
    reason: str
    created_by: str
    """Username; the machine's id for a rollback at the machine itself."""
    created_utc: datetime
    outcome: DeploymentOutcome
    detail: str
    ended_utc: datetime | None


class VersionFileView(View):
    """One file of a version, for machines."""

    name: str
    sha256: str
    size_bytes: int


class WantedPolicyView(View):
    """The version that a machine is to have in one mode."""

    mode: Mode
    deployment_count: int
    policy_sha256: str
    is_rollback: bool
    """The machine then keeps from going back to the version that it has now."""
    age_s: float
    """Since a person or rollout asked for it."""
    files: tuple[VersionFileView, ...]
    """Empty where the server does not have the version any more."""


class WantedPoliciesView(View):
    """What a machine is to have, one a mode at most, and what it may load."""

    policies: tuple[WantedPolicyView, ...]
    trust: SiteTrust
