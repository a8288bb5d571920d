"""Proxy of the 3D view: same origin, signed in, and only the frames that a viewer page needs.

Registers /viewer and /viewer/ for HTTP and WebSocket (the viewer cuts its trailing slash, and a
WebSocket does not follow redirects). viser itself listens on loopback behind a secret of its own.
"""

import asyncio
import inspect
import logging
import time
from collections.abc import Awaitable, Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any, Protocol
from urllib.parse import urlsplit

import websockets
from fastapi import APIRouter, Request, Response, WebSocket
from fastapi.responses import JSONResponse, RedirectResponse
from starlette.requests import HTTPConnection
from starlette.websockets import WebSocketDisconnect, WebSocketState
from websockets.asyncio.client import ClientConnection, connect
from websockets.typing import Subprotocol

from server.error_handlers import api_error_response
from server.errors import ApiError
from server.viewer.scene import ViewerScene
from server.viewer.viewer_server import SECRET_HEADER, SESSION_HEADER
from server.viewer_proxy.frames import MalformedFrameError, filter_frame
from server.viewer_proxy.page import page_headers, viewer_page

logger = logging.getLogger(__name__)

CLOSED_SESSION_ENDED = 4401
CLOSED_VIEW_AWAY = 1013
CLOSED_MALFORMED = 1008
FRAMES_PER_S = 120.0
"""The page sends at most 50 camera positions a second and a click now and then."""
RECHECK_S = 15.0
"""How often a session that has a view open is checked again."""


class ViewerSession(Protocol):
    """What the proxy needs to know of a session."""

    @property
    def session_id(self) -> str:
        """Opaque id, the same for all sockets of a session."""
        ...


Admit = Callable[["ViewerSession", WebSocket], AbstractContextManager[object]]
"""Gives a socket of a session its place, or refuses it with an `ApiError`."""
Authenticate = Callable[[HTTPConnection], "ViewerSession | Awaitable[ViewerSession | None] | None"]


class FrameBudget:
    """Token bucket over the frames of one socket."""

    def __init__(self, per_s: float = FRAMES_PER_S) -> None:
        self._per_s = per_s
        self._left = per_s
        self._last_s: float | None = None

    def take(self, now_s: float) -> bool:
        """Whether one more frame fits now."""
        if self._last_s is not None:
            self._left = min(self._per_s, self._left + (now_s - self._last_s) * self._per_s)
        self._last_s = now_s
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


class ViewerProxy:
    """Routes of the 3D view and its open sockets."""

    def __init__(
        self,
        scene: ViewerScene,
        authenticate: Authenticate,
        *,
        allowed_origins: frozenset[str] | None = None,
        admit: Admit | None = None,
    ) -> None:
        """Prepare the routes.

        Args:
            scene: the view; started before the first request.
            authenticate: session of a request or WebSocket by its cookie, or None; may be a coroutine.
            allowed_origins: exact origins that may open the view; by default the host that is asked.
            admit: how many sockets there may be; all of them by default.
        """
        self._scene = scene
        self._authenticate = authenticate
        self._allowed_origins = allowed_origins
        self._admit = admit or (lambda *_: nullcontext())
        self._open: dict[str, set[WebSocket]] = {}
        self.dropped_count = 0
        """Frames that were not passed on, of all sockets since the start."""
        self.router = APIRouter(include_in_schema=False)
        self.router.add_api_route("/viewer", self._redirect, methods=["GET"])
        self.router.add_api_route("/viewer/", self._page, methods=["GET"])
        self.router.add_api_route("/viewer/status", self._status, methods=["GET"])
        self.router.add_api_websocket_route("/viewer", self._socket)
        self.router.add_api_websocket_route("/viewer/", self._socket)

    # HTTP -------------------------------------------------------------------------------------------

    async def _redirect(self) -> Response:
        return RedirectResponse("/viewer/", status_code=307)

    async def _page(self, request: Request) -> Response:
        if await self._session(request) is None:
            return _signed_out()
        page = await asyncio.to_thread(viewer_page)
        headers = page_headers(request.headers.get("host", ""))
        return Response(page.html, media_type="text/html; charset=utf-8", headers=headers)

    async def _status(self, request: Request) -> Response:
        """Whether the view runs, and how many browsers of this session it draws for."""
        session = await self._session(request)
        if session is None:
            return _signed_out()
        count = self._scene.client_count(session.session_id)
        body = {"is_ready": True, "client_count": count}
        return JSONResponse(body, headers={"Cache-Control": "no-store"})

    # WebSocket --------------------------------------------------------------------------------------

    async def _session(self, connection: HTTPConnection) -> ViewerSession | None:
        found = self._authenticate(connection)
        return await found if inspect.isawaitable(found) else found

    def _is_own_origin(self, websocket: WebSocket) -> bool:
        """Exact check; a WebSocket is not held to the same-origin rule by the browser."""
        origin = websocket.headers.get("origin")
        if origin is None:
            return False
        if self._allowed_origins is not None:
            return origin in self._allowed_origins
        parts = urlsplit(origin)
        expected = {"ws": "http", "wss": "https"}[websocket.url.scheme]
        return (
            parts.scheme == expected and origin == f"{expected}://{websocket.headers.get('host')}"
        )

    async def _socket(self, websocket: WebSocket) -> None:
        session = await self._session(websocket) if self._is_own_origin(websocket) else None
        offered = [p for p in websocket.scope.get("subprotocols", []) if p.startswith("viser-v")]
        if session is None or not offered:
            # Closing before accepting answers the handshake with 403.
            await websocket.close(CLOSED_SESSION_ENDED)
            return
        try:
            place = self._admit(session, websocket)
        except ApiError as error:
            await websocket.send_denial_response(api_error_response(error))
            return
        with place:
            await self._connect(websocket, session, offered[0])

    async def _connect(self, websocket: WebSocket, session: ViewerSession, protocol: str) -> None:
        gate = self._scene.gate
        headers = {SESSION_HEADER: session.session_id, SECRET_HEADER: gate.secret}
        try:
            upstream = await connect(
                f"ws://127.0.0.1:{gate.port}/",
                subprotocols=[Subprotocol(protocol)],
                additional_headers=headers,
                compression=None,
                max_size=None,
                proxy=None,
                open_timeout=5.0,
            )
        except (OSError, TimeoutError, websockets.WebSocketException):
            logger.exception("3D view: its server does not answer")
            await websocket.close(CLOSED_VIEW_AWAY)
            return
        async with upstream:
            await websocket.accept(subprotocol=protocol)
            await self._relay(websocket, upstream, session.session_id)

    async def _relay(
        self, websocket: WebSocket, upstream: ClientConnection, session_id: str
    ) -> None:
        self._open.setdefault(session_id, set()).add(websocket)
        jobs = [
            asyncio.create_task(self._to_view(websocket, upstream)),
            asyncio.create_task(_to_browser(websocket, upstream)),
            asyncio.create_task(self._watch(websocket, session_id)),
        ]
        try:
            await asyncio.wait(jobs, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for job in jobs:
                job.cancel()
            await asyncio.gather(*jobs, return_exceptions=True)
            sockets = self._open.get(session_id, set())
            sockets.discard(websocket)
            if not sockets:
                self._open.pop(session_id, None)
            await _close(websocket, CLOSED_VIEW_AWAY, "view away")

    async def _to_view(self, websocket: WebSocket, upstream: ClientConnection) -> None:
        budget = FrameBudget()
        while True:
            try:
                raw = await websocket.receive_bytes()
                frame = filter_frame(raw) if budget.take(time.monotonic()) else None
                if frame is None:
                    self.dropped_count += 1
                else:
                    await upstream.send(frame)
            except (MalformedFrameError, KeyError) as error:
                self.dropped_count += 1
                logger.warning("3D view: socket closed, malformed frame (%s)", error)
                await _close(websocket, CLOSED_MALFORMED, "malformed frame")
                return
            except (WebSocketDisconnect, websockets.ConnectionClosed):
                return

    async def _watch(self, websocket: WebSocket, session_id: str) -> None:
        """Close the socket when its session is found ended (expiry has no event of its own)."""
        while True:
            await asyncio.sleep(RECHECK_S)
            session = await self._session(websocket)
            if session is None or session.session_id != session_id:
                await self.close_session(session_id)
                return

    async def close_session(self, session_id: str) -> None:
        """Close a session's sockets (4401) and forget its view: logout, expiry or a changed role."""
        for websocket in list(self._open.get(session_id, ())):
            await _close(websocket, CLOSED_SESSION_ENDED, "session ended")
        self._scene.end_session(session_id)


async def _to_browser(websocket: WebSocket, upstream: ClientConnection) -> None:
    try:
        async for message in upstream:
            if isinstance(message, bytes):
                await websocket.send_bytes(message)
    except (WebSocketDisconnect, websockets.ConnectionClosed, RuntimeError):
        return


async def _close(websocket: WebSocket, code: int, reason: str) -> None:
    if WebSocketState.DISCONNECTED in (websocket.application_state, websocket.client_state):
        return
    try:
        await websocket.close(code, reason)
    except RuntimeError:
        logger.debug("3D view: socket was closed already")


def _signed_out() -> Response:
    error: dict[str, Any] = {
        "code": "not_signed_in",
        "message": "Sign in to see the 3D view.",
        "detail": "",
    }
    return JSONResponse({"error": error}, status_code=401, headers={"Cache-Control": "no-store"})
