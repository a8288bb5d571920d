"""This session's 3D view: which machine, which camera, which colours."""

from fastapi import APIRouter

from server.dependencies import RegistryDep, TargetsDep, Viewer
from server.schemas.console import ViewRequest

router = APIRouter(tags=["view"])


@router.put("/view", status_code=204)
def set_view(
    body: ViewRequest, session: Viewer, registry: RegistryDep, targets: TargetsDep
) -> None:
    """Change what this session's 3D view shows."""
    if body.machine_id is not None:
        registry.get(body.machine_id)
    targets.set_view(session.session_id, body)
