"""This session's 3D view: which machine, which camera, which colours."""

from fastapi import APIRouter

from server.accounts.access import Viewer
from server.schemas.console import ViewRequest
from server.services import ServicesDep

router = APIRouter(tags=["view"])


@router.put("/view", status_code=204)
def set_view(body: ViewRequest, session: Viewer, services: ServicesDep) -> None:
    """Change what this session's 3D view shows."""
    if body.machine_id is not None:
        services.registry.get(body.machine_id)
    services.targets.set_view(session.session_id, body)
