"""Leases: who may command a machine."""

from fastapi import APIRouter

from server.accounts.access import LeaseTaker, Lessee
from server.schemas.console import LeaseView, TakeRequest
from server.services import ServicesDep

router = APIRouter(tags=["leases"])


@router.post("/machines/{machine_id}/lease")
def acquire_lease(machine_id: str, session: Lessee, services: ServicesDep) -> LeaseView:
    """Acquire a free lease, or renew one's own; renew every 5 s, it runs out after 15 s."""
    return services.leases.acquire(machine_id, session)


@router.delete("/machines/{machine_id}/lease")
def release_lease(machine_id: str, session: Lessee, services: ServicesDep) -> LeaseView:
    """Give one's lease back; the machine disarms."""
    return services.leases.release(machine_id, session)


@router.post("/machines/{machine_id}/lease/take")
def take_lease(
    machine_id: str, body: TakeRequest, session: LeaseTaker, services: ServicesDep
) -> LeaseView:
    """Take a lease from another person; the machine disarms."""
    return services.leases.take(machine_id, session, body.reason)
