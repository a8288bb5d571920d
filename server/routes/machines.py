"""Machines."""

from typing import NoReturn

from fastapi import APIRouter

from server.errors import UnavailableError
from server.schemas import CommandView, MachineView, StopView, TargetRequest, TargetView

router = APIRouter(tags=["machines"])


def _later() -> NoReturn:
    raise UnavailableError("not_ready", "this part of the service is not there yet")


@router.get("/machines")
def list_machines() -> list[MachineView]:
    """All machines of this site, those never or no longer seen included."""
    _later()


@router.get("/machines/{machine_id}")
def read_machine(machine_id: str) -> MachineView:
    """One machine."""
    _later()


@router.put("/machines/{machine_id}/target")
def propose_target(machine_id: str, body: TargetRequest) -> TargetView:
    """Set this session's proposed target."""
    _later()


@router.delete("/machines/{machine_id}/target", status_code=204)
def remove_target(machine_id: str) -> None:
    """Remove this session's proposed target."""
    _later()


@router.post("/machines/{machine_id}/load")
def load(machine_id: str) -> CommandView:
    """Take up a payload."""
    _later()


@router.post("/machines/{machine_id}/abort")
def abort(machine_id: str) -> CommandView:
    """End the armed or running throw."""
    _later()


@router.post("/machines/{machine_id}/disarm")
def disarm(machine_id: str) -> CommandView:
    """Give an armed plan back."""
    _later()


@router.post("/machines/{machine_id}/stop")
def stop_machine(machine_id: str) -> StopView:
    """STOP one machine; any role, no lease."""
    _later()


@router.post("/machines/{machine_id}/stop/clear")
def clear_stop(machine_id: str) -> CommandView:
    """Clear a latched stop or fault."""
    _later()


@router.post("/stop")
def stop_all() -> list[StopView]:
    """STOP all machines; any role, no lease."""
    _later()
