"""STOP over HTTP, on threads of its own: whatever else the server is asked for cannot hold it up.

All other operations share the framework's forty threads, and some of those wait for previews or the disk.
"""

from fastapi import APIRouter, Request

from server.accounts.access import current_session, requires
from server.accounts.auth import Session
from server.schemas.console import Permission, StopView
from server.services import Services, get_services

router = APIRouter(tags=["machines"])
_check = requires(Permission.STOP)


@router.post("/machines/{machine_id}/stop")
async def stop_machine(machine_id: str, request: Request) -> StopView:
    """STOP one machine; any role, no lease."""
    services = get_services(request)

    def stop() -> StopView:
        session = _admit(request, services)
        services.registry.get(machine_id)
        return _stop(services, [machine_id], session)[0]

    return await services.stops.in_lane(stop)


@router.post("/stop")
async def stop_all(request: Request) -> list[StopView]:
    """STOP all machines; any role, no lease."""
    services = get_services(request)

    def stop() -> list[StopView]:
        session = _admit(request, services)
        return _stop(services, [known.machine_id for known in services.registry.listed()], session)

    return await services.stops.in_lane(stop)


def _admit(request: Request, services: Services) -> Session:
    return _check(request, services, current_session(request, services))


def _stop(services: Services, machine_ids: list[str], session: Session) -> list[StopView]:
    for machine_id in machine_ids:
        services.throw_desk.forget(machine_id)
    return services.stops.stop(machine_ids, session.actor)
