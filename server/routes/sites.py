"""What stands around a machine, and the exclusion zones there."""

from fastapi import APIRouter

from server.dependencies import SiteEditor, SitesDep, Viewer, ZoneApprover, ZonesDep
from server.schemas.sites import SiteRequest, SiteView
from server.schemas.zones import ZoneApprovalBody, ZoneChangeBody, ZonesView, ZoneVersionView

router = APIRouter(prefix="/machines/{machine_id}/site", tags=["site"])
zones_router = APIRouter(prefix="/machines/{machine_id}/zones", tags=["zones"])


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


@zones_router.get("")
def read_zones(machine_id: str, session: Viewer, zones: ZonesDep) -> ZonesView:
    """The newest version and the approved one."""
    return zones.view(machine_id)


@zones_router.get("/versions")
def list_zone_versions(machine_id: str, session: Viewer, zones: ZonesDep) -> list[ZoneVersionView]:
    """The newest hundred versions, newest first: who changed what, when and why, and who approved it."""
    return zones.versions(machine_id)


@zones_router.put("")
def change_zones(
    machine_id: str, body: ZoneChangeBody, session: SiteEditor, zones: ZonesDep
) -> ZonesView:
    """Put other zones in place of all there were, as a draft."""
    return zones.change(machine_id, body, session)


@zones_router.post("/undo")
def undo_zones(machine_id: str, session: SiteEditor, zones: ZonesDep) -> ZonesView:
    """Go back to the version before, as a new draft."""
    return zones.undo(machine_id, session)


@zones_router.post("/approve")
def approve_zones(
    machine_id: str, body: ZoneApprovalBody, session: ZoneApprover, zones: ZonesDep
) -> ZonesView:
    """Approve the newest version: previews use it at once, and the machine is sent it."""
    return zones.approve(machine_id, body, session)
