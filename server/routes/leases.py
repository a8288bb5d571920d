"""Leases."""

from typing import NoReturn

from fastapi import APIRouter

from server.errors import UnavailableError
from server.schemas import LeaseView, TakeRequest

router = APIRouter(tags=["leases"])


def _later() -> NoReturn:
    raise UnavailableError("not_ready", "this part of the service is not there yet")


@router.post("/machines/{machine_id}/lease")
def acquire_lease(machine_id: str) -> LeaseView:
    """Acquire a free lease, or renew one's own."""
    _later()


@router.delete("/machines/{machine_id}/lease")
def release_lease(machine_id: str) -> LeaseView:
    """Give one's lease back; disarms."""
    _later()


@router.post("/machines/{machine_id}/lease/take")
def take_lease(machine_id: str, body: TakeRequest) -> LeaseView:
    """Take a lease from another person; disarms."""
    _later()
