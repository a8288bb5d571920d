"""Machines: their state, targets in mind, and the commands that are neither a throw nor STOP."""

from fastapi import APIRouter

from machine.messages import (
    AbortRequest,
    CommandReply,
    DisarmRequest,
    LoadRequest,
    StopClearRequest,
)
from server.accounts.access import Enroller, StopClearer, Thrower, Viewer
from server.accounts.auth import Session
from server.clock import new_id
from server.schemas.console import (
    CommandView,
    MachineEnrolRequest,
    MachineView,
    TargetRequest,
    TargetView,
)
from server.services import Services, ServicesDep

router = APIRouter(tags=["machines"])


@router.get("/machines")
def list_machines(session: Viewer, services: ServicesDep) -> list[MachineView]:
    """All machines of this site, those not seen any more included."""
    return [
        services.views.view(
            known.machine_id, services.targets.target_of(session.session_id, known.machine_id)
        )
        for known in services.registry.listed()
    ]


@router.post("/machines", status_code=201)
def enrol_machine(
    body: MachineEnrolRequest, session: Enroller, services: ServicesDep
) -> MachineView:
    """Add a machine to the list; one without an account gets one, which the link knows after a restart."""
    services.registry.enrol(body.machine_id, body.name, session.actor)
    return services.views.view(body.machine_id)


@router.get("/machines/{machine_id}")
def read_machine(machine_id: str, session: Viewer, services: ServicesDep) -> MachineView:
    """One machine."""
    target = services.targets.target_of(session.session_id, machine_id)
    return services.views.view(machine_id, target)


@router.put("/machines/{machine_id}/target")
def propose_target(
    machine_id: str, body: TargetRequest, session: Thrower, services: ServicesDep
) -> TargetView:
    """Set this session's proposed target."""
    services.registry.get(machine_id)
    return services.targets.propose(
        session.session_id, machine_id, body.target(), body.mode, "fields"
    )


@router.delete("/machines/{machine_id}/target", status_code=204)
def remove_target(machine_id: str, session: Thrower, services: ServicesDep) -> None:
    """Remove this session's proposed target and its preview."""
    services.registry.get(machine_id)
    services.targets.remove(session.session_id, machine_id)


@router.post("/machines/{machine_id}/load")
def load(machine_id: str, session: Thrower, services: ServicesDep) -> CommandView:
    """Take up a payload."""
    return _command(services, session, machine_id, LoadRequest)


@router.post("/machines/{machine_id}/abort")
def abort(machine_id: str, session: Thrower, services: ServicesDep) -> CommandView:
    """End the armed or running throw."""
    return _command(services, session, machine_id, AbortRequest)


@router.post("/machines/{machine_id}/disarm")
def disarm(machine_id: str, session: Thrower, services: ServicesDep) -> CommandView:
    """Give an armed plan back."""
    return _command(services, session, machine_id, DisarmRequest)


@router.post("/machines/{machine_id}/stop/clear")
def clear_stop(machine_id: str, session: StopClearer, services: ServicesDep) -> CommandView:
    """Clear a latched stop or fault; needs the privilege, and a new arm afterwards."""
    services.registry.get(machine_id)
    request = StopClearRequest(
        command_id=new_id(),
        machine_id=machine_id,
        issuer=session.username,
        epoch_count=services.leases.epoch(machine_id),
    )
    with services.stops.suspended(machine_id):
        return _view(services.commands.send(request, session.actor))


def _command(
    services: Services,
    session: Session,
    machine_id: str,
    kind: type[LoadRequest | AbortRequest | DisarmRequest],
) -> CommandView:
    lease = services.leases.require(machine_id, session)
    if kind is not LoadRequest:
        services.throw_desk.forget(machine_id)
    request = kind(
        command_id=new_id(),
        machine_id=machine_id,
        issuer=session.username,
        epoch_count=lease.epoch_count,
    )
    return _view(services.commands.send(request, session.actor))


def _view(reply: CommandReply) -> CommandView:
    return CommandView(
        machine_id=reply.machine_id,
        state=reply.state,
        epoch_count=reply.epoch_count,
        detail=reply.detail,
        is_repeat=reply.is_repeat,
    )
