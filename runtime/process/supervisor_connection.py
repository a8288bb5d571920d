"""The socket between the supervisor and each child process: settings and sockets down, readiness up.

A child whose socket is closed at the other end finishes in order. A killed supervisor therefore leaves no
child behind, and no signal is needed.
"""

import json
import signal
import socket
from typing import Any, Final

MESSAGE_LIMIT_BYTES: Final = 64 * 1024
_PORT: Final = b"P"
"""Message that carries a socket to the other child."""


class SupervisorConnection:
    """The child's end."""

    def __init__(self, end: socket.socket) -> None:
        self._socket = end
        self.is_gone = False
        """The supervisor has gone, or wants this process to end."""

    @classmethod
    def from_argument(cls, argument: str) -> "SupervisorConnection":
        """From the descriptor's number on the command line; interrupts are left to the supervisor."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        supervisor = cls(socket.socket(fileno=int(argument)))
        signal.signal(signal.SIGTERM, lambda *_: supervisor.leave())
        return supervisor

    def leave(self) -> None:
        """Ask this process to end in order."""
        self.is_gone = True

    def fileno(self) -> int:
        """For `select`."""
        return self._socket.fileno()

    def settings(self) -> dict[str, Any]:
        """The first message; waits for it.

        Raises:
            EOFError: the supervisor has gone.
        """
        self._socket.setblocking(True)
        data = self._socket.recv(MESSAGE_LIMIT_BYTES)
        self._socket.setblocking(False)
        if not data:
            raise EOFError
        return json.loads(data)

    def poll(self) -> socket.socket | None:
        """A socket to the other child, when a new one has come."""
        if self.is_gone:
            return None
        try:
            data, descriptors, _, _ = socket.recv_fds(self._socket, MESSAGE_LIMIT_BYTES, 1)
        except BlockingIOError:
            return None
        except OSError:
            data, descriptors = b"", []
        if not data:
            self.is_gone = True
            return None
        return socket.socket(fileno=descriptors[0]) if descriptors else None

    def tell(self, **message: Any) -> None:
        """Tell the supervisor something; a supervisor that has gone hears nothing."""
        try:
            self._socket.send(json.dumps(message).encode())
        except OSError:
            self.is_gone = True


def hand_port(connection: socket.socket, port: socket.socket) -> None:
    """Supervisor: hand a socket to a child, and forget it here.

    Raises:
        OSError: the child has ended.
    """
    try:
        socket.send_fds(connection, [_PORT], [port.fileno()])
    finally:
        port.close()
