"""Drifts of machines, and their diagnoses."""

from fastapi import APIRouter

from machine.conventions import Mode
from server.dependencies import DriftDiagnosesDep, GapRunner, Viewer
from server.drift.drift_diagnosis import DriftView
from server.schemas.gap import GapRunRow

router = APIRouter(prefix="/machines/{machine_id}/drifts", tags=["gap"])


@router.get("")
def list_drifts(machine_id: str, session: Viewer, drifts: DriftDiagnosesDep) -> list[DriftView]:
    """Drifts that last, at most one a mode, each with its diagnosis."""
    return drifts.view(machine_id)


@router.post("/{mode}/gap-runs", status_code=202)
def create_drift_run(
    machine_id: str, mode: Mode, session: GapRunner, drifts: DriftDiagnosesDep
) -> GapRunRow:
    """Queue the diagnosis of a drift: throws since the change against throws of before."""
    return drifts.start(machine_id, mode, session.actor)
