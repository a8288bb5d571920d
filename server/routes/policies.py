"""Policy versions."""

from fastapi import APIRouter

from server.dependencies import PoliciesDep, Viewer
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
