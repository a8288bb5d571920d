"""Machines beside each other, one machine over its life, and how people call it."""

from fastapi import APIRouter

from server.dependencies import MachineEditor, RegistryDep, SummariesDep, Viewer, ViewsDep
from server.schemas.console import MachineView
from server.schemas.fleet import FleetRowView, MachineEditRequest, MachineLifeView

router = APIRouter(tags=["fleet"])


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
