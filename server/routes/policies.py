"""Policy versions."""

from datetime import datetime

from fastapi import APIRouter

from server.dependencies import MachinePoliciesDep, PoliciesDep, Viewer
from server.schemas.deployments import MachinePoliciesView
from server.schemas.history import PolicyView

router = APIRouter(tags=["policies"])


@router.get("/policies")
def list_policies(session: Viewer, policies: PoliciesDep) -> list[PolicyView]:
    """All policy versions ever seen, the active ones first."""
    return policies.views()


@router.get("/policies/{policy_sha256}")
def read_policy(policy_sha256: str, session: Viewer, policies: PoliciesDep) -> PolicyView:
    """One policy version."""
    return policies.view(policy_sha256)


@router.get("/machines/{machine_id}/policies")
def read_machine_policies(
    machine_id: str,
    session: Viewer,
    machine_policies: MachinePoliciesDep,
    at: datetime | None = None,
) -> MachinePoliciesView:
    """What the machine had on board at a time (ISO 8601; UTC where it names no zone), or has now."""
    return machine_policies.view(machine_id, at)
