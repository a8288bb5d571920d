"""Plans."""

from typing import NoReturn

from fastapi import APIRouter

from server.errors import UnavailableError
from server.schemas import ArmBody, ArmView, PlanFrames, PlanRequest, PlanView

router = APIRouter(tags=["plans"])


def _later() -> NoReturn:
    raise UnavailableError("not_ready", "this part of the service is not there yet")


@router.post("/machines/{machine_id}/plans", status_code=201)
def create_plan(machine_id: str, body: PlanRequest) -> PlanView:
    """Preview a throw: first numbers at once, the ellipse by events."""
    _later()


@router.get("/plans/{plan_id}")
def read_plan(plan_id: str) -> PlanView:
    """One plan."""
    _later()


@router.get("/plans/{plan_id}/frames")
def read_plan_frames(plan_id: str) -> PlanFrames:
    """The predicted motion."""
    _later()


@router.post("/plans/{plan_id}/arm")
def arm_plan(plan_id: str, body: ArmBody) -> ArmView:
    """Arm the machine for this plan."""
    _later()
