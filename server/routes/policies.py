"""Policy versions."""

from fastapi import APIRouter

from server.accounts.access import Viewer
from server.schemas.history import PolicyView
from server.services import ServicesDep

router = APIRouter(tags=["policies"])


@router.get("/policies")
def list_policies(session: Viewer, services: ServicesDep) -> list[PolicyView]:
    """All policy versions ever seen, the active ones first."""
    return services.policies.views()


@router.get("/policies/{policy_sha256}")
def read_policy(policy_sha256: str, session: Viewer, services: ServicesDep) -> PolicyView:
    """One policy version."""
    return services.policies.view(policy_sha256)
