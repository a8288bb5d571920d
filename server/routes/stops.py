"""STOP over HTTP, on threads that nothing else uses.

All other operations share the framework's forty threads, and some of those wait for previews or the disk.
"""

from fastapi import APIRouter, Request

from server.accounts.access_control import AccessControl
from server.accounts.accounts import Session
from server.dependencies import AccessDep, RegistryDep, StopsDep
from server.schemas.console import Permission, StopView

router = APIRouter(tags=["machines"])


@router.post("/machines/{machine_id}/stop")
async def stop_machine(
    machine_id: str, request: Request, access: AccessDep, registry: RegistryDep, stops: StopsDep
) -> StopView:
    """STOP one machine; any role, no lease."""

    def stop() -> StopView:
        session = _admit(request, access)
        registry.get(machine_id)
        return stops.stop([machine_id], session.actor)[0]

    return await stops.in_stop_thread(stop)


@router.post("/stop")
async def stop_all(
    request: Request, access: AccessDep, registry: RegistryDep, stops: StopsDep
) -> list[StopView]:
    """STOP all machines; any role, no lease."""

    def stop() -> list[StopView]:
        session = _admit(request, access)
        return stops.stop([known.machine_id for known in registry.listed()], session.actor)

    return await stops.in_stop_thread(stop)


def _admit(request: Request, access: AccessControl) -> Session:
    return access.require(request, access.session_of(request), Permission.STOP)
