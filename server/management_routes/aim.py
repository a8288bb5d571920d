"""Aim corrections of machines: what is proposed, put in force, undone."""

from fastapi import APIRouter

from machine.conventions import Mode
from server.aim.aim_views import AimApplyRequest, AimView
from server.dependencies import AimDep, AimKeeper, Viewer

router = APIRouter(prefix="/machines/{machine_id}/aim", tags=["aim"])


@router.get("")
def read_aim(machine_id: str, session: Viewer, aim: AimDep) -> AimView:
    """Aim corrections of a machine by mode: in force, proposed from its throws, and earlier ones."""
    return aim.view(machine_id)


@router.post("/{mode}/apply")
def apply_aim(
    machine_id: str, mode: Mode, body: AimApplyRequest, session: AimKeeper, aim: AimDep
) -> AimView:
    """Put the proposal that was shown in force; plans hold it from now on."""
    return aim.apply(machine_id, mode, body.proposal_sha256, session)


@router.post("/{mode}/undo")
def undo_aim(machine_id: str, mode: Mode, session: AimKeeper, aim: AimDep) -> AimView:
    """End the correction in force; the one before comes back if it still fits."""
    return aim.undo(machine_id, mode, session)
