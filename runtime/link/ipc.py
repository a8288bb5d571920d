"""The socket between control and link process: packets, bounded, never blocking.

A packet is one datagram of a SOCK_SEQPACKET pair: a kind byte, then JSON or packed numpy rows. Sending
into a full socket drops the packet and counts it; the control loop waits for nobody.
"""

import json
import socket
import threading
from enum import IntEnum
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from machine.telemetry import BALL_ROW, CONTROL_ROW, IMU_ROW, POLICY_ROW

BUFFER_BYTES: Final = 2 * 1024 * 1024
"""Asked-for socket buffer; the kernel grants at least its default (about 170 ticks) unprivileged."""
PACKET_LIMIT_BYTES: Final = 64 * 1024

TICK_ROW: Final = np.dtype(
    [
        ("t_mono_ns", np.int64),
        ("packet_count", np.int64),  # tick packets tried so far: gaps show what was dropped
        ("state_code_count", np.int8),  # index in list(ThrowState)
        ("is_logged", np.bool_),  # belongs to the open log
    ]
)
TICK_TAGS: Final = {"tick": 0, "control": 1, "policy": 2, "imu": 3, "ball": 4}
TICK_DTYPES: Final[dict[int, np.dtype[np.void]]] = {
    0: TICK_ROW,
    1: CONTROL_ROW,
    2: POLICY_ROW,
    3: IMU_ROW,
    4: BALL_ROW,
}


class Kind(IntEnum):
    """First byte of a packet. Values are never reused."""

    JOURNAL = 1
    """link -> control: {epoch_count, throw_ids, latch}, what must outlive a restart; answers a HELLO."""
    COMMAND = 2
    """link -> control: {request, command}"""
    HEARTBEAT = 3
    """link -> control: OperatorHeartbeat"""
    EVENT_ACK = 4
    """link -> control: {number}: events up to this one are on disk"""
    LINK = 5
    """link -> control: {is_connected, outbox_count, recorder_dropped_count}"""
    HELLO = 6
    """control -> link: {state, log, is_log_open, has_memory}: boot and context of the last log; the first."""
    STATUS = 7
    """control -> link: MachineState without what only the link knows."""
    REPLY = 8
    """control -> link: {request, reply}"""
    EVENT = 9
    """control -> link: {number, kind, t_mono_ns, t_utc, throw_id, plan_id, data}"""
    TICK = 10
    """control -> link: rows of one control tick, see `pack_rows`"""
    LOG_BEGIN = 11
    """control -> link: context of the log that the following ticks belong to"""
    LOG_END = 12
    """control -> link: result of the log"""
    ZONES = 13
    """link -> control: {zone_set}, the exclusion zones on the disk, null = unreadable; before the JOURNAL."""
    POLICY = 14
    """link -> control: PolicyOffer, a version on the disk to switch to while no plan is armed"""


class Packet(NamedTuple):
    """One received packet."""

    kind: Kind
    body: bytes

    @property
    def json(self) -> dict[str, Any]:
        """The body of a JSON packet."""
        return json.loads(self.body)


class PeerGoneError(Exception):
    """The other process has ended."""


class PacketSocket:
    """One end of the pair. `send` may be called from several threads, `receive` from one."""

    def __init__(self, end: socket.socket) -> None:
        end.setblocking(False)
        self._socket = end
        self._lock = threading.Lock()
        self.dropped_count = 0
        """Packets that found the socket full."""

    def fileno(self) -> int:
        """For `select`."""
        return self._socket.fileno()

    def send(self, kind: Kind, body: bytes) -> bool:
        """Send one packet or drop it; whether it went.

        Raises:
            PeerGoneError: the other process has ended.
            ValueError: the packet is longer than `PACKET_LIMIT_BYTES`.
        """
        if len(body) >= PACKET_LIMIT_BYTES:
            raise ValueError(f"a packet of {len(body)} bytes exceeds {PACKET_LIMIT_BYTES}")
        try:
            with self._lock:
                self._socket.send(bytes((kind,)) + body)
        except BlockingIOError:
            self.dropped_count += 1
            return False
        except OSError as error:
            raise PeerGoneError from error
        return True

    def send_json(self, kind: Kind, body: dict[str, Any]) -> bool:
        """Send a JSON packet; as `send`."""
        return self.send(kind, json.dumps(body, separators=(",", ":")).encode())

    def receive(self) -> Packet | None:
        """The next packet, or None when none waits.

        Raises:
            PeerGoneError: the other process has ended and all its packets are read.
        """
        try:
            data = self._receive()
        except BlockingIOError:
            return None
        except OSError as error:
            raise PeerGoneError from error
        if not data:
            raise PeerGoneError
        return Packet(Kind(data[0]), data[1:])

    def _receive(self) -> bytes:
        try:
            return self._socket.recv(PACKET_LIMIT_BYTES)
        except ConnectionResetError:
            # Said once when the peer died with unread packets; its own packets still wait behind it.
            return self._socket.recv(PACKET_LIMIT_BYTES)

    def close(self) -> None:
        """Let go of the socket."""
        self._socket.close()


def packet_pair() -> tuple[socket.socket, socket.socket]:
    """Two connected ends with large buffers, to be handed to two processes."""
    pair = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    for end in pair:
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER_BYTES)
        end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
    return pair


def pack_rows(parts: dict[int, NDArray[np.void]]) -> bytes:
    """Pack arrays of rows under small integer tags (0..255): tag, row count, bytes, each."""
    return b"".join(
        bytes((tag, len(rows))) + np.ascontiguousarray(rows).tobytes()
        for tag, rows in parts.items()
    )


def unpack_rows(body: bytes, dtypes: dict[int, np.dtype[np.void]]) -> dict[int, NDArray[np.void]]:
    """Inverse of `pack_rows`; the arrays are views into `body`.

    Raises:
        ValueError: the body does not fit the types: the two processes run different software.
    """
    parts: dict[int, NDArray[np.void]] = {}
    offset = 0
    while offset < len(body):
        if offset + 2 > len(body):
            raise ValueError("a row packet ends within a header")
        tag, count = body[offset], body[offset + 1]
        if tag not in dtypes:
            raise ValueError(f"a row packet has the unknown tag {tag}")
        offset += 2
        end = offset + count * dtypes[tag].itemsize
        if end > len(body):
            raise ValueError(f"a row packet ends within rows of tag {tag}")
        parts[tag] = np.frombuffer(body[offset:end], dtype=dtypes[tag])
        offset = end
    return parts
