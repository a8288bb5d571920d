"""Machines: their state, leases, targets in mind, and the commands that are neither a throw nor STOP."""

from fastapi import APIRouter

from machine.messages import (
    AbortRequest,
    CommandReply,
    DisarmRequest,
    LoadRequest,
    StopClearRequest,
)
from server.accounts.accounts import Session
from server.clock import new_id
from server.dependencies import (
    CommandsDep,
    LeasesDep,
    LeaseTaker,
    Lessee,
    RegistryDep,
    StopClearer,
    StopsDep,
    TargetsDep,
    Thrower,
    ThrowServiceDep,
    Viewer,
    ViewsDep,
)
from server.errors import ConflictError
from server.machines.lease_service import LeaseService
from server.machines.machine_commands import MachineCommands
from server.schemas.console import (
    CommandView,
    LeaseView,
    MachineView,
    StopClearBody,
    TakeRequest,
    TargetRequest,
    TargetView,
)
from server.throws.throw_service import ThrowService

router = APIRouter(tags=["machines"])
leases_router = APIRouter(tags=["leases"])


@router.get("/machines")
def list_machines(
    session: Viewer, views: ViewsDep, targets: TargetsDep, registry: RegistryDep
) -> list[MachineView]:
    """All machines of this site, those not seen any more included."""
    return [
        views.view(known.machine_id, targets.target_of(session.session_id, known.machine_id))
        for known in registry.listed()
    ]


@router.get("/machines/{machine_id}")
def read_machine(
    machine_id: str, session: Viewer, targets: TargetsDep, views: ViewsDep
) -> MachineView:
    """One machine."""
    target = targets.target_of(session.session_id, machine_id)
    return views.view(machine_id, target)


@router.put("/machines/{machine_id}/target")
def propose_target(
    machine_id: str,
    body: TargetRequest,
    session: Thrower,
    registry: RegistryDep,
    targets: TargetsDep,
) -> TargetView:
    """Set this session's proposed target."""
    registry.get(machine_id)
    return targets.propose(session.session_id, machine_id, body.target(), body.mode, "fields")


@router.delete("/machines/{machine_id}/target", status_code=204)
def remove_target(
    machine_id: str, session: Thrower, registry: RegistryDep, targets: TargetsDep
) -> None:
    """Remove this session's proposed target and its preview."""
    registry.get(machine_id)
    targets.remove(session.session_id, machine_id)


@router.post("/machines/{machine_id}/load")
def load(
    machine_id: str,
    session: Thrower,
    leases: LeasesDep,
    commands: CommandsDep,
    throw_service: ThrowServiceDep,
) -> CommandView:
    """Take up a payload."""
    return _command(leases, commands, throw_service, session, machine_id, LoadRequest)


@router.post("/machines/{machine_id}/abort")
def abort(
    machine_id: str,
    session: Thrower,
    leases: LeasesDep,
    commands: CommandsDep,
    throw_service: ThrowServiceDep,
) -> CommandView:
    """End the armed or running throw."""
    return _command(leases, commands, throw_service, session, machine_id, AbortRequest)


@router.post("/machines/{machine_id}/disarm")
def disarm(
    machine_id: str,
    session: Thrower,
    leases: LeasesDep,
    commands: CommandsDep,
    throw_service: ThrowServiceDep,
) -> CommandView:
    """Give an armed plan back."""
    return _command(leases, commands, throw_service, session, machine_id, DisarmRequest)


@router.post("/machines/{machine_id}/stop/clear")
def clear_stop(
    machine_id: str,
    session: StopClearer,
    registry: RegistryDep,
    leases: LeasesDep,
    stops: StopsDep,
    commands: CommandsDep,
    body: StopClearBody,
) -> CommandView:
    """Clear a latched stop or fault that was shown, by a person who sees the machine."""
    state = registry.get(machine_id).state
    if state is not None and state.latch_id and state.latch_id != body.latch_id:
        raise ConflictError(
            "latch_changed",
            f"{machine_id} was stopped again since this was shown ({state.latched_reason}). "
            "Look at the machine again, then clear what is latched now.",
        )
    stops.require_confirmed(machine_id)
    request = StopClearRequest(
        command_id=new_id(),
        machine_id=machine_id,
        issuer=session.username,
        epoch_count=leases.epoch(machine_id),
        latch_id=body.latch_id,
        sighted_by=session.username,
        reason=body.reason,
    )
    return _view(commands.send(request, session.actor))


@leases_router.post("/machines/{machine_id}/lease")
def acquire_lease(machine_id: str, session: Lessee, leases: LeasesDep) -> LeaseView:
    """Acquire a free lease, or renew one's own; renew every 5 s, it runs out after 15 s."""
    return leases.acquire(machine_id, session)


@leases_router.delete("/machines/{machine_id}/lease")
def release_lease(machine_id: str, session: Lessee, leases: LeasesDep) -> LeaseView:
    """Give one's lease back; the machine disarms."""
    return leases.release(machine_id, session)


@leases_router.post("/machines/{machine_id}/lease/take")
def take_lease(
    machine_id: str, body: TakeRequest, session: LeaseTaker, leases: LeasesDep
) -> LeaseView:
    """Take a lease from another person; the machine disarms."""
    return leases.take(machine_id, session, body.reason)


def _command(
    leases: LeaseService,
    commands: MachineCommands,
    throw_service: ThrowService,
    session: Session,
    machine_id: str,
    kind: type[LoadRequest | AbortRequest | DisarmRequest],
) -> CommandView:
    lease = leases.require(machine_id, session)
    if kind is not LoadRequest:
        throw_service.forget(machine_id)
    request = kind(
        command_id=new_id(),
        machine_id=machine_id,
        issuer=session.username,
        epoch_count=lease.epoch_count,
    )
    return _view(commands.send(request, session.actor))


def _view(reply: CommandReply) -> CommandView:
    return CommandView(
        machine_id=reply.machine_id,
        state=reply.state,
        epoch_count=reply.epoch_count,
        detail=reply.detail,
        is_repeat=reply.is_repeat,
    )
