"""The hold WebSocket: 20 messages a second while the operator holds the button."""

import asyncio
import logging

from fastapi import APIRouter, WebSocket
from pydantic import ValidationError
from starlette.websockets import WebSocketDisconnect

from server.accounts.access import socket_session
from server.accounts.auth import COOKIE, Session
from server.error_shape import api_error_response
from server.errors import TooManyRequestsError
from server.limits.streams import StreamKind
from server.schemas.console import Permission
from server.schemas.plans import HoldMessage, HoldReply
from server.services import Services, get_services

logger = logging.getLogger(__name__)

router = APIRouter()

CLOSED_REFUSED = 4403
CLOSED_SESSION_ENDED = 4401
CLOSED_MALFORMED = 4400
MAX_MESSAGE_COUNT = 1024
"""Characters; a message has under 100."""
RECHECK_S = 5.0


@router.websocket("/machines/{machine_id}/hold")
async def hold(websocket: WebSocket, machine_id: str) -> None:
    """Relay the operator's hold; silence, closing and `holding: false` all let go."""
    services = get_services(websocket)
    session = await socket_session(websocket, services, Permission.THROW)
    if session is None:
        # Closing before accepting answers the handshake with 403.
        await websocket.close(CLOSED_REFUSED)
        return
    try:
        place = services.streams.take(StreamKind.HOLD, session.username, websocket)
    except TooManyRequestsError as error:
        await websocket.send_denial_response(api_error_response(error))
        return
    with place:
        await _serve(websocket, services, session, machine_id)


async def _serve(
    websocket: WebSocket, services: Services, session: Session, machine_id: str
) -> None:
    await websocket.accept()
    watch = asyncio.create_task(_watch(websocket, services, session))
    throw_id: str | None = None
    try:
        throw_id = await _relay(websocket, services, session, machine_id)
    except WebSocketDisconnect:
        pass
    finally:
        watch.cancel()
        await asyncio.gather(watch, return_exceptions=True)
        services.holds.let_go(machine_id, session.session_id)
        logger.debug("hold of %s on %s ended at throw %s", session.username, machine_id, throw_id)


async def _relay(
    websocket: WebSocket, services: Services, session: Session, machine_id: str
) -> str | None:
    """Pass messages on until the socket closes; the browser is told when its standing changes."""
    told: tuple[str, str] | None = None
    while True:
        text = await websocket.receive_text()
        try:
            message = HoldMessage.model_validate_json(text[:MAX_MESSAGE_COUNT])
        except ValidationError:
            await websocket.close(CLOSED_MALFORMED, "not a hold message")
            return None
        refusal = services.holds.relay(
            machine_id, message.throw_id, session.session_id, is_holding=message.holding
        )
        if told != (message.throw_id, refusal):
            told = (message.throw_id, refusal)
            reply = HoldReply(throw_id=message.throw_id, is_relayed=not refusal, detail=refusal)
            await websocket.send_text(reply.model_dump_json())


async def _watch(websocket: WebSocket, services: Services, session: Session) -> None:
    """Close the socket when its session has ended."""
    while True:
        await asyncio.sleep(RECHECK_S)
        found = await asyncio.to_thread(services.accounts.session_of, websocket.cookies.get(COOKIE))
        if (
            found is None
            or found.session_id != session.session_id
            or not found.may(Permission.THROW)
        ):
            services.holds.let_go_all(session.session_id)
            await websocket.close(CLOSED_SESSION_ENDED, "session ended")
            return
