"""Throws."""

from typing import NoReturn

from fastapi import APIRouter

from server.errors import UnavailableError
from server.schemas import FireView

router = APIRouter(tags=["throws"])


def _later() -> NoReturn:
    raise UnavailableError("not_ready", "this part of the service is not there yet")


@router.post("/plans/{plan_id}/fire")
def fire_plan(plan_id: str) -> FireView:
    """Fire the armed plan, once."""
    _later()
