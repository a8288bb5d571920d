"""Server-sent events: one stream a browser."""

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from server.accounts.access import Viewer
from server.accounts.auth import COOKIE
from server.events import Frame, HubClient
from server.limits.streams import StreamKind
from server.schemas.events import ServerEvent
from server.services import Services, ServicesDep

router = APIRouter(tags=["events"])

KEEP_ALIVE_S = 2.0
"""A browser that hears nothing for longer calls itself not live (web/src/session/connection.ts)."""
RECHECK_S = 2.0
"""How often a stream's session is checked again: it may run out, or its person may be disabled."""


@router.get(
    "/events",
    response_class=StreamingResponse,
    responses={200: {"model": ServerEvent, "description": "server-sent events"}},
)
async def stream_events(
    request: Request,
    session: Viewer,
    services: ServicesDep,
    machine_id: Annotated[str | None, Query(max_length=32)] = None,
) -> StreamingResponse:
    """Everything that happens; states of `machine_id` at full rate, of the others once a second."""
    place = services.streams.take(StreamKind.EVENTS, session.username, request)
    client = services.hub.subscribe(session.session_id, machine_id)

    def end() -> None:
        services.hub.unsubscribe(client)
        place.give_back()

    return _EventStream(_frames(client, services, request.cookies.get(COOKIE)), end)


class _EventStream(StreamingResponse):
    """Ends what was opened for it, also when the browser is gone before the first frame."""

    def __init__(self, frames: AsyncIterator[bytes], end: Callable[[], None]) -> None:
        headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
        super().__init__(frames, media_type="text/event-stream", headers=headers)
        self._end = end

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._end()


async def _frames(client: HubClient, services: Services, token: str | None) -> AsyncIterator[bytes]:
    checked_s = time.monotonic()
    yield b"retry: 1000\n\n: connected\n\n"
    while not client.is_closed:
        frames = await client.wait(KEEP_ALIVE_S)
        # By the clock: a machine's states leave no pause in which the end of a session would be noticed.
        if time.monotonic() - checked_s >= RECHECK_S:
            if await asyncio.to_thread(services.accounts.session_of, token) is None:
                return
            checked_s = time.monotonic()
        yield b"".join(_encode(frame) for frame in frames) or b"event: ping\ndata: {}\n\n"


def _encode(frame: Frame) -> bytes:
    return f"event: {frame.name}\ndata: {frame.data}\n\n".encode()
