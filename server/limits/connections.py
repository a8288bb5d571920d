"""Connections that ask for nothing: closed when they take too long, the oldest first when there are many.

Whoever can reach the port can open connections without signing in; left alone they stay for ever, until the
process has no file left for the one that brings STOP. A new connection is never refused for them.
"""

import asyncio
import logging
import resource
from collections import OrderedDict
from dataclasses import dataclass

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class ConnectionLimits:
    """For connections whose request is not there yet, or not whole."""

    headers_s: float = 15.0
    """From the connection, or the first byte of a later request, to the end of the headers."""
    silence_s: float = 30.0
    """Without another byte of a request's body; a machine on a weak network sends its log slowly."""
    per_address_count: int = 128
    total_count: int = 512


class WaitingRoom:
    """The connections that wait, oldest first; used in the event loop only."""

    def __init__(self, limits: ConnectionLimits | None = None) -> None:
        self.limits = limits or ConnectionLimits()
        self.closed_count = 0
        """Connections closed to make room or for their silence, since the start."""
        self._waiting: dict[str, OrderedDict[PatientProtocol, None]] = {}

    @property
    def count(self) -> int:
        """Connections that wait now."""
        return sum(len(room) for room in self._waiting.values())

    def enter(self, address: str, connection: "PatientProtocol") -> None:
        """A connection waits; where there are too many the one that waits longest is closed."""
        room = self._waiting.setdefault(address, OrderedDict())
        room[connection] = None
        if len(room) > self.limits.per_address_count:
            self.close(address, next(iter(room)), "too many of one address")
        elif self.count > self.limits.total_count:
            fullest = max(self._waiting, key=lambda name: len(self._waiting[name]))
            self.close(fullest, next(iter(self._waiting[fullest])), "too many in all")

    def leave(self, address: str, connection: "PatientProtocol") -> None:
        """Its request is there, or it is gone."""
        room = self._waiting.get(address, OrderedDict())
        room.pop(connection, None)
        if not room:
            self._waiting.pop(address, None)

    def close(self, address: str, connection: "PatientProtocol", reason: str) -> None:
        """End a connection that waits."""
        self.leave(address, connection)
        self.closed_count += 1
        logger.debug("connection of %s closed: %s", address, reason)
        connection.transport.abort()


class PatientProtocol(H11Protocol):
    """HTTP/1.1 of uvicorn with limited patience; `room` is set by `patient_protocol`."""

    room: WaitingRoom
    _timer: asyncio.TimerHandle | None = None
    _address = ""
    _heard_s = 0.0
    _is_waiting = False
    _is_websocket = False

    def connection_made(self, transport: asyncio.Transport) -> None:
        """Begin to wait for the first request."""
        super().connection_made(transport)
        self._address = self.client[0] if self.client else "unknown"
        self._wait(self.room.limits.headers_s)

    def data_received(self, data: bytes) -> None:
        """Wait on for what is missing of the request, or no longer."""
        self._heard_s = self.loop.time()
        super().data_received(data)
        if self._is_websocket:
            return
        if self.conn.their_state not in (h11.IDLE, h11.SEND_BODY):
            self._wait_no_more()
        elif not self._is_waiting and not self.transport.is_closing():
            self._wait(self.room.limits.headers_s)

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """From here on the connection is another protocol's."""
        self._is_websocket = True
        self._wait_no_more()
        super().handle_websocket_upgrade(event)

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget it."""
        self._wait_no_more()
        super().connection_lost(exc)

    def _wait(self, patience_s: float) -> None:
        self._is_waiting = True
        self._timer = self.loop.call_later(patience_s, self._look)
        self.room.enter(self._address, self)

    def _wait_no_more(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._is_waiting:
            self._is_waiting = False
            self.room.leave(self._address, self)

    def _look(self) -> None:
        """Time is up: headers that are still missing are not waited for, a body while it comes."""
        left_s = self._heard_s + self.room.limits.silence_s - self.loop.time()
        if self.conn.their_state is h11.SEND_BODY and left_s > 0.0:
            self._timer = self.loop.call_later(left_s, self._look)
            return
        self._wait_no_more()
        self.room.close(self._address, self, "its request did not come")


def patient_protocol(room: WaitingRoom) -> type[asyncio.Protocol]:
    """The protocol class of one server, with its waiting room."""
    return type("PatientProtocol", (PatientProtocol,), {"room": room})


def allow_open_files() -> None:
    """Raise the process's limit of open files to what the system allows; many systems begin at 1024."""
    soft_count, hard_count = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft_count != hard_count:
        resource.setrlimit(resource.RLIMIT_NOFILE, (hard_count, hard_count))
