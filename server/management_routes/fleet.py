"""Machines beside each other, one machine over its life, and how people call it."""

from typing import Annotated

from fastapi import APIRouter, Depends

from server.dependencies import (
    AuditDep,
    DatabaseDep,
    MachineEditor,
    RegistryDep,
    SitesDep,
    SummariesDep,
    Viewer,
    ViewsDep,
    ZonesDep,
)
from server.fleet.yard_map import MapMachineView, PlaceRequest, YardMap
from server.schemas.console import MachineView
from server.schemas.fleet import FleetRowView, MachineEditRequest, MachineLifeView

router = APIRouter(tags=["fleet"])


def _yard(
    database: DatabaseDep, audit: AuditDep, registry: RegistryDep, sites: SitesDep, zones: ZonesDep
) -> YardMap:
    return YardMap(database, audit, registry, sites, zones)


YardDep = Annotated[YardMap, Depends(_yard)]


@router.get("/fleet")
def list_fleet(session: Viewer, summaries: SummariesDep) -> list[FleetRowView]:
    """Every machine: versions on board, last throw, accuracy now and at first."""
    return summaries.fleet()


@router.get("/machines/{machine_id}/life")
def read_machine_life(machine_id: str, session: Viewer, summaries: SummariesDep) -> MachineLifeView:
    """One machine: counts, measured throws and versions over time."""
    return summaries.life(machine_id)


@router.patch("/machines/{machine_id}")
def edit_machine(
    machine_id: str,
    body: MachineEditRequest,
    session: MachineEditor,
    registry: RegistryDep,
    views: ViewsDep,
) -> MachineView:
    """Give a machine another name or other tags."""
    registry.edit(machine_id, session.actor, name=body.name, tags=body.tags)
    views.publish(machine_id)
    return views.view(machine_id)


@router.get("/fleet/map")
def read_yard_map(session: Viewer, yard: YardDep) -> list[MapMachineView]:
    """Every machine with its place in the yard, objects, zones in force and last impacts."""
    return yard.machines()


@router.put("/machines/{machine_id}/place", status_code=204)
def place_machine(
    machine_id: str, body: PlaceRequest, session: MachineEditor, yard: YardDep
) -> None:
    """Say where a machine stands in the yard."""
    yard.place(machine_id, body, session)


@router.delete("/machines/{machine_id}/place", status_code=204)
def unplace_machine(machine_id: str, session: MachineEditor, yard: YardDep) -> None:
    """Take a machine off the plan."""
    yard.remove(machine_id, session)
