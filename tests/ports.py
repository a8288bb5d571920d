"""Ports for servers that a test starts by number."""

import os
import socket
from itertools import count

FIRST_PORT, PORT_COUNT = 20_000, 12_000
"""Below the ports that Linux gives to outgoing connections (32768 and up): none of those can take one of
these between this choice and the server's start, as it could with a port that the system chose."""
_numbers = count(os.getpid() * 1009)
"""Processes that start one after the other begin far from each other."""


def free_port(kind: int = socket.SOCK_STREAM) -> int:
    """A port of the loopback that nobody uses now and that this process has not given out before."""
    for number in _numbers:
        port = FIRST_PORT + number % PORT_COUNT
        with socket.socket(type=kind) as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port
    raise AssertionError("unreachable: the numbers do not end")
