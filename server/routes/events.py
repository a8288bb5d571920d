"""Server-sent events: one stream a browser."""

import asyncio
from collections.abc import AsyncIterator
from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi.responses import StreamingResponse

from server.accounts.access import Viewer
from server.accounts.auth import COOKIE
from server.events import Frame, HubClient
from server.schemas.events import ServerEvent
from server.services import Services, ServicesDep

router = APIRouter(tags=["events"])

KEEP_ALIVE_S = 2.0
"""A browser that hears nothing for longer calls itself not live (web/src/session/connection.ts)."""


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
    client = services.hub.subscribe(session.session_id, machine_id)
    return StreamingResponse(
        _frames(client, services, request.cookies.get(COOKIE)),
        media_type="text/event-stream",
        headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"},
    )


async def _frames(client: HubClient, services: Services, token: str | None) -> AsyncIterator[bytes]:
    try:
        yield b"retry: 1000\n\n: connected\n\n"
        while not client.is_closed:
            frames = await client.wait(KEEP_ALIVE_S)
            if frames:
                yield b"".join(_encode(frame) for frame in frames)
                continue
            if await asyncio.to_thread(services.accounts.session_of, token) is None:
                return
            yield b"event: ping\ndata: {}\n\n"
    finally:
        services.hub.unsubscribe(client)


def _encode(frame: Frame) -> bytes:
    return f"event: {frame.name}\ndata: {frame.data}\n\n".encode()
