"""Patience with connections: short for requests that do not come, long for those that come slowly."""

import contextlib
import socket
import threading
import time
from collections.abc import Iterator

import pytest
import uvicorn
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from server.limits.connections import ConnectionLimits, IdleConnectionLimit, timed_http_protocol
from tests.server.server_bench import wait_for

HEADERS_S, SILENCE_S = 0.4, 0.4
WHOLE_GET = b"GET / HTTP/1.1\r\nHost: h\r\n\r\n"
BEGUN_POST = b"POST / HTTP/1.1\r\nHost: h\r\nContent-Length: 12\r\n\r\n"


async def count_body(scope: Scope, receive: Receive, send: Send) -> None:
    body = await Request(scope, receive).body()
    await Response(f"{len(body)} bytes")(scope, receive, send)


@pytest.fixture
def idle_limit() -> IdleConnectionLimit:
    return IdleConnectionLimit(ConnectionLimits(headers_s=HEADERS_S, silence_s=SILENCE_S))


@pytest.fixture
def opened(idle_limit: IdleConnectionLimit) -> Iterator[socket.socket]:
    config = uvicorn.Config(
        count_body,
        port=0,
        lifespan="off",
        log_config=None,
        timeout_keep_alive=60,
        http=timed_http_protocol(idle_limit),
    )
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run)
    thread.start()
    wait_for(lambda: server.started)
    address = server.servers[0].sockets[0].getsockname()
    with socket.create_connection(address, timeout=60.0) as connection:
        yield connection
    server.should_exit = True
    thread.join(timeout=60.0)


def read_answer(opened: socket.socket) -> bytes:
    said = b""
    while not said.endswith(b" bytes"):
        said += opened.recv(4096)
    return said


def read_to_the_end(opened: socket.socket) -> bytes:
    said = b""
    with contextlib.suppress(ConnectionResetError):
        while part := opened.recv(4096):
            said += part
    return said


@pytest.mark.parametrize(
    "begun",
    [
        b"",
        b"GET / HTTP/1.1\r\nHos",
        BEGUN_POST + b"{",
        # A second request on a connection that was answered.
        WHOLE_GET + b"GET / HTTP/1.1\r\nHos",
    ],
)
def test_a_request_that_does_not_come_is_not_waited_for(
    opened: socket.socket, idle_limit: IdleConnectionLimit, begun: bytes
) -> None:
    if begun.startswith(WHOLE_GET):
        opened.sendall(WHOLE_GET)
        assert b"0 bytes" in read_answer(opened)
    opened.sendall(begun.removeprefix(WHOLE_GET))
    assert read_to_the_end(opened) == b""
    wait_for(lambda: idle_limit.count == 0)
    assert idle_limit.closed_count == 1


def test_a_body_that_comes_slowly_is_waited_for(
    opened: socket.socket, idle_limit: IdleConnectionLimit
) -> None:
    opened.sendall(BEGUN_POST)
    for _ in range(12):
        time.sleep((HEADERS_S + SILENCE_S) / 8.0)
        opened.sendall(b"x")
    assert b"12 bytes" in read_answer(opened)
    assert (idle_limit.count, idle_limit.closed_count) == (0, 0)


@pytest.mark.parametrize("begun", [b"GET / HTTP/1.1\r\nHost: h\r\nX: ", BEGUN_POST])
def test_a_request_in_pieces_of_one_byte_is_not_read_on(
    opened: socket.socket, idle_limit: IdleConnectionLimit, begun: bytes
) -> None:
    idle_limit.limits = ConnectionLimits(piece_count=4)
    opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    opened.sendall(begun)
    with contextlib.suppress(ConnectionError):
        for _ in range(10):
            opened.sendall(b"x")
            time.sleep(0.02)
    assert read_to_the_end(opened) == b""
    assert idle_limit.closed_count == 1


def test_an_answered_connection_may_rest(
    opened: socket.socket, idle_limit: IdleConnectionLimit
) -> None:
    for _ in range(3):
        opened.sendall(WHOLE_GET)
        assert b"0 bytes" in read_answer(opened)
        time.sleep(HEADERS_S + SILENCE_S)
    assert (idle_limit.count, idle_limit.closed_count) == (0, 0)
