"""Health."""

from typing import NoReturn

from fastapi import APIRouter

from server.schemas import HealthView
from server.errors import UnavailableError

router = APIRouter(tags=["health"])


def _later() -> NoReturn:
    raise UnavailableError("not_ready", "this part of the service is not there yet")


@router.get("/health")
def read_health() -> HealthView:
    """Whether the service can do its work."""
    _later()
