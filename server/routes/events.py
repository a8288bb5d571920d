"""Events."""

from typing import NoReturn

from fastapi import APIRouter
from fastapi.responses import StreamingResponse

from server.errors import UnavailableError
from server.schemas_history import ServerEvent

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
