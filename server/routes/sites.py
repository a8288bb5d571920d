"""What stands around a machine."""

from fastapi import APIRouter

from server.accounts.access import SiteEditor, Viewer
from server.schemas.sites import SiteRequest, SiteView
from server.services import ServicesDep

router = APIRouter(prefix="/machines/{machine_id}/site", tags=["site"])


@router.get("")
def read_site(machine_id: str, session: Viewer, services: ServicesDep) -> SiteView:
    """Boxes, pits and piles around a machine."""
    return services.sites.view(machine_id)


@router.put("")
def change_site(
    machine_id: str, body: SiteRequest, session: SiteEditor, services: ServicesDep
) -> SiteView:
    """Put other objects in place of all there were, as a new version."""
    return services.sites.change(machine_id, body, session)


@router.post("/undo")
def undo_site(machine_id: str, session: SiteEditor, services: ServicesDep) -> SiteView:
    """Go back to the version before, as a new version."""
    return services.sites.undo(machine_id, session)
