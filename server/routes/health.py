"""Health."""

from typing import NoReturn

from fastapi import APIRouter

from server.errors import UnavailableError
from server.schemas import HealthView

router = APIRouter(tags=["health"])


def _later() -> NoReturn:
    raise UnavailableError("not_ready", "this part of the service is not there yet")


@router.get("/health")
def read_health() -> HealthView:
    """Whether the service can do its work."""
    _later()
