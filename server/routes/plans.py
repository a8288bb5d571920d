"""Plans: preview, arm, fire."""

from fastapi import APIRouter

from server.accounts.access import Thrower, Viewer
from server.schemas.plans import ArmBody, ArmView, FireView, PlanFrames, PlanRequest, PlanView
from server.services import ServicesDep

router = APIRouter(tags=["plans"])


@router.post("/machines/{machine_id}/plans", status_code=201)
def create_plan(
    machine_id: str, body: PlanRequest, session: Thrower, services: ServicesDep
) -> PlanView:
    """Preview a throw: first numbers at once, the ellipse by events."""
    return services.planner.create(machine_id, body, session)


@router.get("/plans/{plan_id}")
def read_plan(plan_id: str, session: Viewer, services: ServicesDep) -> PlanView:
    """One plan."""
    return services.plans.view(plan_id)


@router.get("/plans/{plan_id}/frames")
def read_plan_frames(plan_id: str, session: Viewer, services: ServicesDep) -> PlanFrames:
    """The predicted motion."""
    return services.plans.frames(plan_id)


@router.post("/plans/{plan_id}/arm")
def arm_plan(plan_id: str, body: ArmBody, session: Thrower, services: ServicesDep) -> ArmView:
    """Arm the machine for this plan."""
    return services.throw_desk.arm(plan_id, body.plan_hash, session)


@router.post("/plans/{plan_id}/fire")
def fire_plan(plan_id: str, session: Thrower, services: ServicesDep) -> FireView:
    """Fire the armed plan, once; then hold on the WebSocket until the machine is committed."""
    return services.throw_desk.fire(plan_id, session)
