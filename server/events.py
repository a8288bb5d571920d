"""Events."""

from typing import NoReturn

from fastapi import APIRouter
from fastapi.responses import StreamingResponse

from server.schemas_history import ServerEvent
from server.errors import UnavailableError

router = APIRouter(tags=["events"])


def _later() -> NoReturn:
    raise UnavailableError("not_ready", "this part of the service is not there yet")


@router.get(
    "/events",
    response_class=StreamingResponse,
    responses={200: {"model": ServerEvent, "description": "server-sent events"}},
)
def stream_events(machine_id: str | None = None) -> StreamingResponse:
    """Everything that happens, as server-sent events."""
    _later()
