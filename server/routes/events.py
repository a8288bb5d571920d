"""What happens, as it happens: over a WebSocket for the console, as server-sent events for programs.

A browser opens six HTTP/1.1 connections to a server and no more, of all its pages together. Six pages that
each held a stream open left none for a seventh page, nor for STOP; WebSockets are not counted among the six.
"""

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from typing import Annotated

from fastapi import APIRouter, Query, Request, WebSocket
from fastapi.responses import StreamingResponse
from starlette.types import Receive, Scope, Send
from starlette.websockets import WebSocketDisconnect, WebSocketState

from server.accounts.accounts import COOKIE, Accounts
from server.dependencies import AccessDep, AccountsDep, HubDep, StreamsDep, Viewer
from server.errors import TooManyRequestsError
from server.event_hub import Frame, HubClient
from server.limits.streams import StreamKind
from server.schemas.console import Permission
from server.schemas.events import ServerEvent

router = APIRouter(tags=["events"])

KEEP_ALIVE_S = 2.0
"""A browser that hears nothing for longer calls itself not live (web/src/session/connection.ts)."""
RECHECK_S = 2.0
"""How often a stream's session is checked again: it may run out, or its person may be disabled."""

CLOSED_REFUSED = 4403
CLOSED_ENDED = 4401
CLOSED_TOO_MANY = 4429
MAX_REASON_COUNT = 120
"""Bytes; a close frame takes 123."""


@router.get(
    "/events",
    response_class=StreamingResponse,
    responses={200: {"model": ServerEvent, "description": "server-sent events"}},
)
async def stream_events(
    request: Request,
    session: Viewer,
    accounts: AccountsDep,
    hub: HubDep,
    streams: StreamsDep,
    machine_id: Annotated[str | None, Query(max_length=32)] = None,
) -> StreamingResponse:
    """Everything that happens; states of `machine_id` at full rate, of the others once a second."""
    place = streams.take(StreamKind.EVENTS, session.username, request)
    client = hub.subscribe(session.session_id, machine_id)

    def end() -> None:
        hub.unsubscribe(client)
        place.give_back()

    return _EventStream(_frames(client, accounts, request.cookies.get(COOKIE)), end)


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


@router.websocket("/events/socket")
async def events_socket(
    websocket: WebSocket,
    access: AccessDep,
    accounts: AccountsDep,
    hub: HubDep,
    streams: StreamsDep,
    machine_id: Annotated[str | None, Query(max_length=32)] = None,
) -> None:
    """The same as JSON lists of events; an empty list says that the server is there."""
    session = await access.socket_session(websocket, Permission.VIEW)
    if session is None:
        # Closing before accepting answers the handshake with 403.
        await websocket.close(CLOSED_REFUSED)
        return
    try:
        place = streams.take(StreamKind.EVENTS, session.username, websocket)
    except TooManyRequestsError as error:
        # Accept first: browsers show pages the reason of a close, not of a refused handshake.
        await websocket.accept()
        await websocket.close(CLOSED_TOO_MANY, error.message[:MAX_REASON_COUNT])
        return
    client = hub.subscribe(session.session_id, machine_id)
    try:
        await websocket.accept()
        await _serve(websocket, client, accounts)
    finally:
        hub.unsubscribe(client)
        place.give_back()


async def _serve(websocket: WebSocket, client: HubClient, accounts: Accounts) -> None:
    sending = asyncio.create_task(_send(websocket, client, accounts))
    listening = asyncio.create_task(_until_gone(websocket))
    try:
        await asyncio.wait((sending, listening), return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in (sending, listening):
            task.cancel()
        await asyncio.gather(sending, listening, return_exceptions=True)
    if websocket.client_state is not WebSocketState.DISCONNECTED:
        with suppress(RuntimeError, WebSocketDisconnect):
            await websocket.close(CLOSED_ENDED, "stream ended")


async def _send(websocket: WebSocket, client: HubClient, accounts: Accounts) -> None:
    async for frames in _batches(client, accounts, websocket.cookies.get(COOKIE)):
        await websocket.send_text(f"[{','.join(frame.data for frame in frames)}]")


async def _until_gone(websocket: WebSocket) -> None:
    """A browser has nothing to say here; what it says ends its stream."""
    await websocket.receive()


async def _frames(client: HubClient, accounts: Accounts, token: str | None) -> AsyncIterator[bytes]:
    yield b"retry: 1000\n\n: connected\n\n"
    async for frames in _batches(client, accounts, token):
        yield b"".join(_encode(frame) for frame in frames) or b"event: ping\ndata: {}\n\n"


async def _batches(
    client: HubClient, accounts: Accounts, token: str | None
) -> AsyncIterator[list[Frame]]:
    """What comes in until the stream or its session ends; nothing every `KEEP_ALIVE_S`."""
    checked_s = time.monotonic()
    while not client.is_closed:
        frames = await client.wait(KEEP_ALIVE_S)
        # By the clock: a machine's states leave no pause in which the end of a session would be noticed.
        if time.monotonic() - checked_s >= RECHECK_S:
            if await asyncio.to_thread(accounts.session_of, token) is None:
                return
            checked_s = time.monotonic()
        yield frames


def _encode(frame: Frame) -> bytes:
    return f"event: {frame.name}\ndata: {frame.data}\n\n".encode()
