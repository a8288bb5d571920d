"""Leases: who may command a machine."""

from fastapi import APIRouter

from server.dependencies import LeasesDep, LeaseTaker, Lessee
from server.schemas.console import LeaseView, TakeRequest

router = APIRouter(tags=["leases"])


@router.post("/machines/{machine_id}/lease")
def acquire_lease(machine_id: str, session: Lessee, leases: LeasesDep) -> LeaseView:
    """Acquire a free lease, or renew one's own; renew every 5 s, it runs out after 15 s."""
    return leases.acquire(machine_id, session)


@router.delete("/machines/{machine_id}/lease")
def release_lease(machine_id: str, session: Lessee, leases: LeasesDep) -> LeaseView:
    """Give one's lease back; the machine disarms."""
    return leases.release(machine_id, session)


@router.post("/machines/{machine_id}/lease/take")
def take_lease(
    machine_id: str, body: TakeRequest, session: LeaseTaker, leases: LeasesDep
) -> LeaseView:
    """Take a lease from another person; the machine disarms."""
    return leases.take(machine_id, session, body.reason)
