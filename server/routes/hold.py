"""The hold WebSocket: 20 messages a second while the operator holds the button."""

import asyncio
import logging

from fastapi import APIRouter, WebSocket
from pydantic import ValidationError
from starlette.websockets import WebSocketDisconnect

from server.accounts.accounts import COOKIE, Accounts, Session
from server.dependencies import AccessDep, AccountsDep, HoldsDep, StreamsDep
from server.error_handlers import api_error_response
from server.errors import TooManyRequestsError
from server.limits.streams import StreamKind
from server.schemas.console import Permission
from server.schemas.plans import HoldMessage, HoldReply
from server.throws.hold_relay import HoldRelay

logger = logging.getLogger(__name__)

router = APIRouter()

CLOSED_REFUSED = 4403
CLOSED_SESSION_ENDED = 4401
CLOSED_MALFORMED = 4400
MAX_MESSAGE_COUNT = 1024
"""Characters; a message has under 150."""
RECHECK_S = 5.0


@router.websocket("/machines/{machine_id}/hold")
async def hold(
    websocket: WebSocket,
    machine_id: str,
    access: AccessDep,
    accounts: AccountsDep,
    streams: StreamsDep,
    holds: HoldsDep,
) -> None:
    """Relay the operator's hold; silence, closing and `holding: false` all let go."""
    session = await access.socket_session(websocket, Permission.THROW)
    if session is None:
        # Closing before accepting answers the handshake with 403.
        await websocket.close(CLOSED_REFUSED)
        return
    try:
        place = streams.take(StreamKind.HOLD, session.username, websocket)
    except TooManyRequestsError as error:
        await websocket.send_denial_response(api_error_response(error))
        return
    with place:
        await websocket.accept()
        watch = asyncio.create_task(_watch(websocket, accounts, holds, session))
        await _serve(websocket, holds, session, machine_id, watch)


async def _serve(
    websocket: WebSocket,
    holds: HoldRelay,
    session: Session,
    machine_id: str,
    watch: "asyncio.Task[None]",
) -> None:
    throw_id: str | None = None
    try:
        throw_id = await _relay(websocket, holds, session, machine_id)
    except WebSocketDisconnect:
        pass
    finally:
        watch.cancel()
        await asyncio.gather(watch, return_exceptions=True)
        holds.let_go(machine_id, session.session_id)
        logger.debug("hold of %s on %s ended at throw %s", session.username, machine_id, throw_id)


async def _relay(
    websocket: WebSocket, holds: HoldRelay, session: Session, machine_id: str
) -> str | None:
    """Pass messages on until the socket closes, and answer each."""
    while True:
        text = await websocket.receive_text()
        try:
            message = HoldMessage.model_validate_json(text[:MAX_MESSAGE_COUNT])
        except ValidationError:
            await websocket.close(CLOSED_MALFORMED, "not a hold message")
            return None
        refusal = holds.relay(
            machine_id,
            message.throw_id,
            session.session_id,
            is_holding=message.holding,
            echo_ns=message.machine_t_mono_ns,
        )
        reply = HoldReply(
            throw_id=message.throw_id,
            is_relayed=not refusal,
            detail=refusal,
            machine_t_mono_ns=holds.machine_t_mono_ns(machine_id),
        )
        await websocket.send_text(reply.model_dump_json())


async def _watch(
    websocket: WebSocket, accounts: Accounts, holds: HoldRelay, session: Session
) -> None:
    """Close the socket when its session has ended."""
    while True:
        await asyncio.sleep(RECHECK_S)
        found = await asyncio.to_thread(accounts.session_of, websocket.cookies.get(COOKIE))
        if (
            found is None
            or found.session_id != session.session_id
            or not found.may(Permission.THROW)
        ):
            holds.let_go_all(session.session_id)
            await websocket.close(CLOSED_SESSION_ENDED, "session ended")
            return
