from collections.abc import Iterator

import msgpack
import pytest
import viser
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from server.viewer.viewer_server import SECRET_HEADER, SESSION_HEADER, ViewerServer
from tests.cases import each
from tests.server.viewer_app import CAMERA, PROTOCOL
from tests.waiting import until


@pytest.fixture(scope="module")
def gate() -> Iterator[ViewerServer]:
    opened = ViewerServer()
    yield opened
    opened.stop()


def dial(gate: ViewerServer, headers: dict[str, str]) -> ClientConnection:
    return connect(
        f"ws://127.0.0.1:{gate.port}/",
        subprotocols=[Subprotocol(PROTOCOL)],
        additional_headers=headers,
        compression=None,
        max_size=None,
        proxy=None,
    )


@each(
    "headers",
    [
        {},
        {SESSION_HEADER: "s1"},
        {SESSION_HEADER: "s1", SECRET_HEADER: "guess"},
        {SECRET_HEADER: ""},
    ],
)
def test_whoever_does_not_come_through_the_proxy_is_turned_away(
    gate: ViewerServer, headers: dict[str, str]
) -> None:
    with dial(gate, headers) as socket:
        with pytest.raises(ConnectionClosed) as closed:
            while True:
                socket.recv(timeout=30.0)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 4403
    assert gate.server.get_clients() == {}


def test_the_session_of_the_header_is_known_and_the_handle_tells_when_it_is_gone(
    gate: ViewerServer,
) -> None:
    with dial(gate, {SESSION_HEADER: "s7", SECRET_HEADER: gate.secret}) as socket:
        socket.send(msgpack.packb(CAMERA))
        until(gate.server.get_clients, "the client to be known")
        ((client_id, client),) = gate.server.get_clients().items()
        assert gate.session_of(client_id) == "s7"
        assert gate.is_open(client)
    until(lambda: not gate.is_open(client), "the handle to be closed")
    until(lambda: gate.session_of(client_id) is None, "the session to be forgotten")


def test_a_tunnel_cannot_be_asked_for(gate: ViewerServer, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    monkeypatch.setattr(gate.server, "request_share_url", lambda *_: asked.append("request"))
    monkeypatch.setattr(gate.server, "disconnect_share_url", lambda *_: asked.append("disconnect"))
    with dial(gate, {SESSION_HEADER: "s1", SECRET_HEADER: gate.secret}) as socket:
        socket.send(msgpack.packb({"type": "ShareUrlRequest"}))
        socket.send(msgpack.packb({"type": "ShareUrlDisconnect"}))
        socket.send(msgpack.packb(CAMERA))
        until(gate.server.get_clients, "the frames to be handled")
    assert asked == []


def test_it_listens_on_loopback_only(gate: ViewerServer) -> None:
    assert gate.server.get_host() == "127.0.0.1"
    assert gate.port > 0


def test_the_pinned_viser_is_the_one_installed() -> None:
    # The gate reads private attributes: another version needs this file's other tests looked at.
    assert viser.__version__ == "1.1.1"
