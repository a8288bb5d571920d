"""Plans: preview, arm, fire; and what this session's 3D view shows."""

from fastapi import APIRouter

from server.dependencies import (
    PlannerDep,
    PlansDep,
    RegistryDep,
    TargetsDep,
    Thrower,
    ThrowServiceDep,
    Viewer,
)
from server.schemas.console import ViewRequest
from server.schemas.plans import ArmBody, ArmView, FireView, PlanFrames, PlanRequest, PlanView

router = APIRouter(tags=["plans"])
view_router = APIRouter(tags=["view"])


@router.post("/machines/{machine_id}/plans", status_code=201)
def create_plan(
    machine_id: str, body: PlanRequest, session: Thrower, planner: PlannerDep
) -> PlanView:
    """Preview a throw: first numbers at once, the ellipse by events."""
    return planner.create(machine_id, body, session)


@router.get("/plans/{plan_id}")
def read_plan(plan_id: str, session: Viewer, plans: PlansDep) -> PlanView:
    """One plan."""
    return plans.view(plan_id)


@router.get("/plans/{plan_id}/frames")
def read_plan_frames(plan_id: str, session: Viewer, plans: PlansDep) -> PlanFrames:
    """The predicted motion."""
    return plans.frames(plan_id)


@router.post("/plans/{plan_id}/arm")
def arm_plan(
    plan_id: str, body: ArmBody, session: Thrower, throw_service: ThrowServiceDep
) -> ArmView:
    """Arm the machine for this plan."""
    return throw_service.arm(plan_id, body.plan_hash, session)


@router.post("/plans/{plan_id}/fire")
def fire_plan(plan_id: str, session: Thrower, throw_service: ThrowServiceDep) -> FireView:
    """Fire the armed plan, once; then hold on the WebSocket until the machine is committed."""
    return throw_service.fire(plan_id, session)


@view_router.put("/view", status_code=204)
def set_view(
    body: ViewRequest, session: Viewer, registry: RegistryDep, targets: TargetsDep
) -> None:
    """Change what this session's 3D view shows."""
    if body.machine_id is not None:
        registry.get(body.machine_id)
    targets.set_view(session.session_id, body)
