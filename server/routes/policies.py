"""Policy versions."""

from datetime import datetime
from typing import Literal

from fastapi import APIRouter
from fastapi.responses import FileResponse

from machine.conventions import Mode
from machine.policy_approval import Approval
from server.dependencies import (
    ApprovalsDep,
    Approver,
    DatabaseDep,
    Deployer,
    DeploymentsDep,
    MachineCaller,
    MachinePoliciesDep,
    PoliciesDep,
    Viewer,
)
from server.plans.policy_life import history
from server.schemas.deployments import (
    DeploymentView,
    DeployRequest,
    MachinePoliciesView,
    RollBackRequest,
    WantedPoliciesView,
)
from server.schemas.history import PolicyView
from server.schemas.policies import PolicyTransitionView, TransitionRequest

router = APIRouter(tags=["policies"])


@router.get("/policies")
def list_policies(session: Viewer, policies: PoliciesDep) -> list[PolicyView]:
    """All policy versions ever seen, the active ones first."""
    return policies.views()


@router.get("/policies/{policy_sha256}")
def read_policy(policy_sha256: str, session: Viewer, policies: PoliciesDep) -> PolicyView:
    """One policy version."""
    return policies.view(policy_sha256)


@router.get("/policy-approvals")
def list_policy_approvals(session: Viewer, approvals: ApprovalsDep) -> list[Approval]:
    """What the site has approved: machines load nothing else."""
    return list(approvals.trust().approvals)


@router.get("/policies/{policy_sha256}/history")
def read_policy_history(
    policy_sha256: str, session: Viewer, database: DatabaseDep
) -> list[PolicyTransitionView]:
    """The steps of the version's life, oldest first: who, when, why, and on what evidence."""
    with database.read() as reading:
        return history(reading, policy_sha256)


@router.post("/policies/{policy_sha256}/approve", status_code=201)
def approve_policy(
    policy_sha256: str, body: TransitionRequest, session: Approver, approvals: ApprovalsDep
) -> Approval:
    """Approve the version by the site's key, as it lies there."""
    return approvals.approve(policy_sha256, body.reason, session)


@router.post("/policies/{policy_sha256}/withdraw", status_code=204)
def withdraw_policy(
    policy_sha256: str, body: TransitionRequest, session: Approver, approvals: ApprovalsDep
) -> None:
    """Withdraw an approval: machines stop using the version while no plan is armed."""
    approvals.withdraw(policy_sha256, body.reason, session)


@router.post("/policies/{policy_sha256}/retire", status_code=204)
def retire_policy(
    policy_sha256: str, body: TransitionRequest, session: Approver, approvals: ApprovalsDep
) -> None:
    """Take the version out of use for good; refused while a machine runs it or may go back to it."""
    approvals.retire(policy_sha256, body.reason, session)


@router.get("/machines/{machine_id}/policies")
def read_machine_policies(
    machine_id: str,
    session: Viewer,
    machine_policies: MachinePoliciesDep,
    at: datetime | None = None,
) -> MachinePoliciesView:
    """What the machine had on board at a time (ISO 8601; UTC where it names no zone), or has now."""
    return machine_policies.view(machine_id, at)


@router.get("/machines/{machine_id}/deployments")
def list_deployments(
    machine_id: str, session: Viewer, deployments: DeploymentsDep
) -> list[DeploymentView]:
    """The newest hundred, newest first: who wanted which version, when and why, and what became of it."""
    return deployments.list(machine_id)


@router.post("/machines/{machine_id}/policies/{mode}/deploy", status_code=201)
def deploy_policy(
    machine_id: str, mode: Mode, body: DeployRequest, session: Deployer, deployments: DeploymentsDep
) -> DeploymentView:
    """Ask the machine to switch to a version; it does so while no plan is armed."""
    return deployments.deploy(machine_id, mode, body, session)


@router.post("/machines/{machine_id}/policies/{mode}/rollback", status_code=201)
def roll_back_policy(
    machine_id: str,
    mode: Mode,
    body: RollBackRequest,
    session: Deployer,
    deployments: DeploymentsDep,
) -> DeploymentView:
    """Ask the machine to go back to the version that it had before."""
    return deployments.roll_back(machine_id, mode, body.reason, session)


@router.get("/machines/{machine_id}/policies/wanted")
def read_wanted_policies(
    machine_id: MachineCaller, deployments: DeploymentsDep
) -> WantedPoliciesView:
    """For the machine itself: the version that it is to have in each mode."""
    return deployments.wanted(machine_id)


@router.get(
    "/machines/{machine_id}/policy-files/{policy_sha256}/{name}", response_class=FileResponse
)
def read_policy_file(
    machine_id: MachineCaller,
    policy_sha256: str,
    name: Literal["policy.onnx", "card.json"],
    deployments: DeploymentsDep,
) -> FileResponse:
    """For the machine itself: a file of a version, whole or a range of bytes."""
    return FileResponse(
        deployments.file(policy_sha256, name), media_type="application/octet-stream"
    )
