import asyncio
import threading
import time
from collections.abc import Iterator
from typing import Any

import httpx
import msgpack
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin, Subprotocol

import server.viewer_proxy.proxy as proxy_module
from server.viewer_proxy.proxy import CLOSED_MALFORMED, CLOSED_SESSION_ENDED, FrameBudget
from tests.cases import each
from tests.server.viewer_app import CAMERA, PROTOCOL, ViewClient, ViewerApp, click
from tests.waiting import until


@pytest.fixture(scope="module")
def app() -> Iterator[ViewerApp]:
    opened = ViewerApp()
    yield opened
    opened.close()


def close_code(client: ViewClient) -> int:
    with pytest.raises(ConnectionClosed) as closed:
        while True:
            client.socket.recv(timeout=30.0)
    assert closed.value.rcvd is not None
    return closed.value.rcvd.code


# HTTP


def test_the_page_needs_a_session(app: ViewerApp) -> None:
    for path in ("/viewer/", "/viewer/status"):
        answer = httpx.get(app.origin + path)
        assert answer.status_code == 401
        assert answer.json()["error"]["code"] == "not_signed_in"
        assert answer.headers["cache-control"] == "no-store"


def test_the_page_comes_with_its_policy(app: ViewerApp) -> None:
    answer = httpx.get(f"{app.origin}/viewer/", cookies={"sid": "s1"})
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("text/html")
    assert f"ws://127.0.0.1:{app.port}" in answer.headers["content-security-policy"]
    assert answer.headers["cache-control"] == "no-store"


def test_the_bare_path_leads_to_the_page(app: ViewerApp) -> None:
    answer = httpx.get(f"{app.origin}/viewer", follow_redirects=False)
    assert (answer.status_code, answer.headers["location"]) == (307, "/viewer/")


@each("path", ["/viewer/index.html", "/viewer/../etc/passwd", "/viewer/assets/x"])
def test_nothing_else_lies_under_the_path(app: ViewerApp, path: str) -> None:
    assert httpx.get(app.origin + path, cookies={"sid": "s1"}).status_code == 404


# Who may open the socket


def handshake(app: ViewerApp, path: str, **changes: Any) -> int:
    """Status of a handshake: 101 when it is accepted."""
    arguments: dict[str, Any] = {
        "origin": Origin(app.origin),
        "subprotocols": [Subprotocol(PROTOCOL)],
        "additional_headers": {"Cookie": "sid=s1"},
        "compression": None,
        "proxy": None,
    } | changes
    try:
        with connect(f"ws://127.0.0.1:{app.port}{path}", **arguments):
            return 101
    except InvalidStatus as refused:
        return refused.response.status_code


@each("path", ["/viewer", "/viewer/"])
def test_both_paths_answer(app: ViewerApp, path: str) -> None:
    assert handshake(app, path) == 101


@each(
    "origin",
    [
        None,
        "null",
        "http://evil.example",
        "http://127.0.0.1",
        "http://127.0.0.1:1",
        "http://localhost:{port}",
        "https://127.0.0.1:{port}",
        "http://127.0.0.1:{port}.evil.example",
        "http://127.0.0.1:{port}/",
        "HTTP://127.0.0.1:{port}",
        "http://user@127.0.0.1:{port}",
        "file://",
    ],
)
def test_a_foreign_origin_is_refused(app: ViewerApp, origin: str | None) -> None:
    given = None if origin is None else Origin(origin.format(port=app.port))
    assert handshake(app, "/viewer", origin=given) == 403


def test_only_listed_origins_when_there_is_a_list(
    app: ViewerApp, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(app.proxy, "_allowed_origins", frozenset({"https://yard.example"}))
    assert handshake(app, "/viewer") == 403
    assert handshake(app, "/viewer", origin=Origin("https://yard.example")) == 101


def test_without_a_session_or_the_viewers_protocol_it_is_refused(app: ViewerApp) -> None:
    assert handshake(app, "/viewer", additional_headers={}) == 403
    app.ended.add("gone")
    assert handshake(app, "/viewer", additional_headers={"Cookie": "sid=gone"}) == 403
    assert handshake(app, "/viewer", subprotocols=[Subprotocol("chat")]) == 403
    assert handshake(app, "/viewer", subprotocols=None) == 403


def test_the_subprotocol_is_echoed(app: ViewerApp) -> None:
    client = ViewClient(app)
    assert client.socket.subprotocol == PROTOCOL
    client.close()


def test_a_browser_cannot_choose_its_session_by_a_header(app: ViewerApp) -> None:
    app.scene.show_machine("victim", "m001")
    client = connect(
        f"ws://127.0.0.1:{app.port}/viewer",
        origin=Origin(app.origin),
        subprotocols=[Subprotocol(PROTOCOL)],
        additional_headers={"Cookie": "sid=thief", "X-Downrange-Session": "victim"},
        proxy=None,
    )
    client.send(msgpack.packb(CAMERA))
    until(lambda: app.scene.client_count("thief"), "the thief's own view")
    assert app.scene.client_count("victim") == 0
    client.close()


# What passes


CRAFTED: list[dict[str, Any]] = [
    {"type": "ShareUrlRequest"},
    {"type": "ShareUrlDisconnect"},
    {"type": "GuiUpdateMessage", "uuid": "x", "updates": {"value": 99.0}},
    {"type": "GuiButtonHoldMessage", "uuid": "x", "frequency": 1.0},
    {"type": "GuiFormSubmitMessage", "uuid": "x"},
    {"type": "CommandTriggerMessage", "uuid": "x"},
    {"type": "FileTransferPart", "source_component_uuid": "x", "transfer_uuid": "y"},
    {
        "type": "LocalStorageGetItemResponseMessage",
        "value": "x",
        "error": None,
        "request_uuid": "y",
    },
    {"type": "GetRenderResponseMessage", "payload": b"x", "render_uuid": "y"},
    {"type": "RunJavascriptMessage", "source": "alert(1)"},
    {**CAMERA, "position": [float("nan"), 0.0, 1.0]},
    {**CAMERA, "fov": 1e9},
]


def test_crafted_frames_never_reach_viser(app: ViewerApp, monkeypatch: pytest.MonkeyPatch) -> None:
    websockets = app.scene.gate.server._websock_server
    reached: list[str] = []
    original = websockets._message_class.deserialize

    class Recording:
        @staticmethod
        def deserialize(raw: bytes) -> Any:
            message = original(raw)
            reached.append(type(message).__name__)
            return message

    client = ViewClient(app, "crafted")
    # The consumer of a connection keeps the class it was started with, so look one level deeper.
    monkeypatch.setattr("viser._messages.Message.deserialize", Recording.deserialize)
    dropped = app.proxy.dropped_count
    for message in CRAFTED:
        client.send(message)
    client.send(CAMERA)
    until(lambda: reached, "the camera to arrive")
    assert reached == ["ViewerCameraMessage"]
    assert app.proxy.dropped_count == dropped + len(CRAFTED)
    client.close()


@each("raw", [b"\xc1", msgpack.packb([1]), bytes(5000), "text"])
def test_a_frame_that_no_page_sends_closes_the_socket(app: ViewerApp, raw: bytes | str) -> None:
    client = ViewClient(app, "rude")
    client.socket.send(raw)
    assert close_code(client) == CLOSED_MALFORMED


def test_a_flood_is_cut_to_the_budget() -> None:
    budget = FrameBudget(per_s=100.0)
    passed = sum(budget.take(10.0 + tick / 1000.0) for tick in range(2000))
    # 100 at once, then 100 a second for two seconds.
    assert passed == pytest.approx(300, abs=2)
    assert budget.take(60.0)


def test_a_click_makes_the_round_trip(app: ViewerApp) -> None:
    app.scene.show_machine("s2", "m001")
    client = ViewClient(app, "s2")
    client.send(CAMERA)
    until(lambda: app.scene.client_count("s2"), "the view to be drawn")
    client.send(click((-8.0, 0.0, 8.0), (2.0, 0.25, -1.0)))
    client.until(lambda: "/target" in client.nodes, "the target mark")
    assert client.nodes["/target"]["position"][:2] == pytest.approx([8.0, 2.0])
    until(lambda: app.picks, "the pick")
    assert app.picks[-1] == ("s2", pytest.approx((8.0, 2.0, 0.0)))
    client.close()


# How it ends


def test_the_end_of_a_session_closes_its_sockets_and_no_others(app: ViewerApp) -> None:
    leaving, staying = ViewClient(app, "leaving"), ViewClient(app, "staying")
    for client in (leaving, staying):
        client.send(CAMERA)
    until(lambda: app.scene.client_count("leaving"), "the view")
    until(lambda: app.scene.client_count("staying"), "the other view")
    asyncio.run_coroutine_threadsafe(app.proxy.close_session("leaving"), _loop_of(app)).result(30.0)
    assert close_code(leaving) == CLOSED_SESSION_ENDED
    until(lambda: app.scene.client_count("leaving") == 0, "the view to go")
    staying.send(CAMERA)
    assert staying.socket.ping().wait(30.0)
    staying.close()


def test_a_session_that_ran_out_is_noticed(app: ViewerApp, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(proxy_module, "RECHECK_S", 0.05)
    client = ViewClient(app, "expiring")
    app.ended.add("expiring")
    assert close_code(client) == CLOSED_SESSION_ENDED


def test_a_browser_that_leaves_is_forgotten(app: ViewerApp) -> None:
    client = ViewClient(app, "brief")
    client.send(CAMERA)
    until(lambda: app.scene.client_count("brief"), "the view")
    client.close()
    until(lambda: app.scene.client_count("brief") == 0, "the view to go")
    until(lambda: "brief" not in app.proxy._open, "the socket to go")


def test_status_tells_whether_this_session_is_drawn(app: ViewerApp) -> None:
    cookies = {"sid": "looking"}
    client = ViewClient(app, "looking")
    client.send(CAMERA)
    until(lambda: app.scene.client_count("looking"), "the view")
    answer = httpx.get(f"{app.origin}/viewer/status", cookies=cookies)
    assert answer.json() == {"is_ready": True, "client_count": 1}
    client.close()


def _loop_of(app: ViewerApp) -> asyncio.AbstractEventLoop:
    """The loop of the test service: found by asking it for its own."""
    found: list[asyncio.AbstractEventLoop] = []

    async def probe(_: object) -> None:
        found.append(asyncio.get_running_loop())

    original = app.proxy._authenticate
    app.proxy._authenticate = probe
    try:
        httpx.get(f"{app.origin}/viewer/status")
    finally:
        app.proxy._authenticate = original
    return found[0]


def test_many_browsers_come_and_go_without_leaving_threads(app: ViewerApp) -> None:
    before = threading.active_count()
    for _ in range(5):
        clients = [ViewClient(app, f"m{i}") for i in range(3)]
        for client in clients:
            client.send(CAMERA)
            client.close()
    until(lambda: not app.proxy._open, "all sockets to go")
    time.sleep(0.1)
    # viser's callback pool may grow up to its 32 workers, the views themselves own no thread.
    assert threading.active_count() <= before + 32
