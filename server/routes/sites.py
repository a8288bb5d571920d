"""What stands around a machine."""

from fastapi import APIRouter

from server.dependencies import SiteEditor, SitesDep, Viewer
from server.schemas.sites import SiteRequest, SiteView

router = APIRouter(prefix="/machines/{machine_id}/site", tags=["site"])


@router.get("")
def read_site(machine_id: str, session: Viewer, sites: SitesDep) -> SiteView:
    """Boxes, pits and piles around a machine."""
    return sites.view(machine_id)


@router.put("")
def change_site(
    machine_id: str, body: SiteRequest, session: SiteEditor, sites: SitesDep
) -> SiteView:
    """Put other objects in place of all there were, as a new version."""
    return sites.change(machine_id, body, session)


@router.post("/undo")
def undo_site(machine_id: str, session: SiteEditor, sites: SitesDep) -> SiteView:
    """Go back to the version before, as a new version."""
    return sites.undo(machine_id, session)
