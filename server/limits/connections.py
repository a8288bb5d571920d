"""Limits of connections without a complete request: by time and by count, the oldest is closed first.

Anybody who reaches the port can open connections without signing in. Unlimited, they would use up the
process's file descriptors and block STOP. A new connection is never refused because of idle ones.
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
    """Limits for connections whose request has not arrived completely."""

    headers_s: float = 15.0
    """From the connection, or the first byte of a later request, to the end of the headers."""
    piece_count: int = 64
    """Pieces in which a request may arrive, however small; a browser sends one or two."""
    mean_piece_bytes: int = 128
    """Of more pieces, at least; reading costs as much for one byte as for all of a network's segment."""
    silence_s: float = 30.0
    """Without another byte of a request's body; a machine on a weak network sends its log slowly."""
    per_address_count: int = 128
    total_count: int = 512


class IdleConnectionLimit:
    """Connections that wait for a request, oldest first; used in the event loop only."""

    def __init__(self, limits: ConnectionLimits | None = None) -> None:
        self.limits = limits or ConnectionLimits()
        self.closed_count = 0
        """Connections closed because of a limit or a timeout, since the start."""
        self._waiting: dict[str, OrderedDict[TimedHttpProtocol, None]] = {}

    @property
    def count(self) -> int:
        """Connections that wait now."""
        return sum(len(waiting) for waiting in self._waiting.values())

    def enter(self, address: str, connection: "TimedHttpProtocol") -> None:
        """Add a waiting connection; above a limit the oldest one is closed."""
        waiting = self._waiting.setdefault(address, OrderedDict())
        waiting[connection] = None
        if len(waiting) > self.limits.per_address_count:
            self.close(address, next(iter(waiting)), "too many of one address")
        elif self.count > self.limits.total_count:
            fullest = max(self._waiting, key=lambda name: len(self._waiting[name]))
            self.close(fullest, next(iter(self._waiting[fullest])), "too many in all")

    def leave(self, address: str, connection: "TimedHttpProtocol") -> None:
        """Remove a connection whose request is complete or that is gone."""
        waiting = self._waiting.get(address, OrderedDict())
        waiting.pop(connection, None)
        if not waiting:
            self._waiting.pop(address, None)

    def close(self, address: str, connection: "TimedHttpProtocol", reason: str) -> None:
        """End a connection that waits."""
        self.leave(address, connection)
        self.closed_count += 1
        logger.debug("connection of %s closed: %s", address, reason)
        connection.transport.abort()


class TimedHttpProtocol(H11Protocol):
    """uvicorn's HTTP/1.1 protocol with these limits; `idle_limit` is set by `timed_http_protocol`."""

    idle_limit: IdleConnectionLimit
    _timer: asyncio.TimerHandle | None = None
    _address = ""
    _heard_s = 0.0
    _piece_count = 0
    _byte_count = 0
    _is_waiting = False
    _is_websocket = False

    def connection_made(self, transport: asyncio.Transport) -> None:
        """Begin to wait for the first request."""
        super().connection_made(transport)
        self._address = self.client[0] if self.client else "unknown"
        self._wait(self.idle_limit.limits.headers_s)

    def data_received(self, data: bytes) -> None:
        """Keep waiting while the request is incomplete."""
        self._heard_s = self.loop.time()
        super().data_received(data)
        if self._is_websocket:
            return
        if self.conn.their_state not in (h11.IDLE, h11.SEND_BODY):
            self._wait_no_more()
        elif not self._is_waiting and not self.transport.is_closing():
            self._wait(self.idle_limit.limits.headers_s)
        if self._is_waiting:
            self._count_pieces(len(data))
        else:
            self._piece_count = self._byte_count = 0

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """Leave the connection to the WebSocket protocol."""
        self._is_websocket = True
        self._wait_no_more()
        super().handle_websocket_upgrade(event)

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget it."""
        self._wait_no_more()
        super().connection_lost(exc)

    def _count_pieces(self, byte_count: int) -> None:
        """Close the connection when its request comes in many small pieces."""
        limits = self.idle_limit.limits
        self._piece_count += 1
        self._byte_count += byte_count
        needed_bytes = limits.mean_piece_bytes * self._piece_count
        if self._piece_count > limits.piece_count and self._byte_count < needed_bytes:
            self._wait_no_more()
            self.idle_limit.close(self._address, self, "its request comes in small pieces")

    def _wait(self, patience_s: float) -> None:
        self._is_waiting = True
        self._timer = self.loop.call_later(patience_s, self._look)
        self.idle_limit.enter(self._address, self)

    def _wait_no_more(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._is_waiting:
            self._is_waiting = False
            self.idle_limit.leave(self._address, self)

    def _look(self) -> None:
        """Close the connection on timeout, unless a body is still arriving."""
        left_s = self._heard_s + self.idle_limit.limits.silence_s - self.loop.time()
        if self.conn.their_state is h11.SEND_BODY and left_s > 0.0:
            self._timer = self.loop.call_later(left_s, self._look)
            return
        self._wait_no_more()
        self.idle_limit.close(self._address, self, "its request did not come")


def timed_http_protocol(idle_limit: IdleConnectionLimit) -> type[asyncio.Protocol]:
    """The protocol class of one server, with its limit."""
    return type("TimedHttpProtocol", (TimedHttpProtocol,), {"idle_limit": idle_limit})


def allow_open_files() -> None:
    """Raise the process's limit of open files to what the system allows; many systems begin at 1024."""
    soft_count, hard_count = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft_count != hard_count:
        resource.setrlimit(resource.RLIMIT_NOFILE, (hard_count, hard_count))
