"""Ports of the demo: held for its server from the choice on."""

import socket

import pytest

from cli.service.demo import _held_port
from server.serve import open_socket


def test_a_held_port_is_the_server_s_and_nobody_else_s() -> None:
    with _held_port() as held:
        host, port = held.getsockname()
        with socket.socket() as other, pytest.raises(OSError):
            other.bind((host, port))
        with open_socket(host, port) as server:
            server.listen()
            with socket.create_connection((host, port)):
                pass
