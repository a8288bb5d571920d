"""Floods of streams and connections against a running server: refused with words; STOP and holds go on."""

import contextlib
import json
import socket

import httpx
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from server.accounts.accounts import COOKIE
from server.limits.streams import StreamKind
from tests.server.hold_client import Hold
from tests.server.server_bench import wait_for

MANY = 40
"""More than a person may have open, few enough for a test."""
PLAN = {"mode": "2d", "target": {"range_m": 6.03, "azimuth_rad": 0.02}, "rollout_count": 50}


def websocket(running, client, path, **more):
    headers = {"Origin": running.url, "Cookie": f"{COOKIE}={client.cookies.get(COOKIE)}"}
    return connect(
        f"ws{running.url.removeprefix('http')}{path}",
        additional_headers=headers,
        proxy=None,
        **more,
    )


def open_hold(running, client):
    return websocket(running, client, "/api/v1/machines/m001/hold")


def open_events(running, client):
    return websocket(running, client, "/api/v1/events/socket?machine_id=m001")


def open_view(running, client):
    return websocket(running, client, "/viewer/", subprotocols=["viser-v1.1.1"])


def flood(stack, running, client, open_one, kind):
    """Open as many as are let in; returns how many, and the answer to the first that was not."""
    for count in range(MANY):
        try:
            stack.enter_context(open_one(running, client))
        except InvalidStatus as refusal:
            return count, refusal.response.status_code, json.loads(refusal.response.body)["error"]
    pytest.fail(f"{MANY} {kind} of one person were let in")


@pytest.mark.parametrize(
    ("open_one", "kind"), [(open_hold, StreamKind.HOLD), (open_view, StreamKind.VIEW)]
)
def test_one_person_opens_so_many_sockets_and_no_more(running, ada, open_one, kind):
    streams = running.parts.streams
    with contextlib.ExitStack() as stack:
        count, status, error = flood(stack, running, ada, open_one, kind)
        assert (status, error["code"]) == (429, "too_many_streams")
        assert f"ada has {count} {kind} open" in error["message"]
        assert count == streams.limits.per_person_count == streams.count(kind)
        # Somebody else's are not refused for it.
        with running.client("bob") as bob, open_one(running, bob):
            pass
    wait_for(lambda: streams.count(kind) == 0)
    with open_one(running, ada):
        pass


def test_one_person_opens_so_many_event_streams_and_no_more(running, ada):
    streams, hub = running.parts.streams, running.parts.hub
    listening_count = hub.client_count
    with contextlib.ExitStack() as stack:
        for _ in range(streams.limits.per_person_count):
            reply = stack.enter_context(ada.stream("GET", "/events"))
            assert reply.status_code == 200
        refused = ada.get("/events")
        assert (refused.status_code, refused.json()["error"]["code"]) == (429, "too_many_streams")
        assert refused.json()["error"]["detail"]["kind"] == "events"
    wait_for(lambda: streams.count(StreamKind.EVENTS) == 0)
    assert hub.client_count == listening_count


def test_a_page_learns_why_it_gets_no_events(running, ada):
    streams, hub = running.parts.streams, running.parts.hub
    listening_count = hub.client_count
    with contextlib.ExitStack() as stack:
        for _ in range(streams.limits.per_person_count):
            stack.enter_context(open_events(running, ada))
        wait_for(lambda: streams.count(StreamKind.EVENTS) == streams.limits.per_person_count)
        refused = stack.enter_context(open_events(running, ada))
        with pytest.raises(ConnectionClosed) as caught:
            refused.recv(timeout=30.0)
        assert caught.value.rcvd.code == 4429
        assert "ada has 32 event streams open" in caught.value.rcvd.reason
    wait_for(lambda: streams.count(StreamKind.EVENTS) == 0)
    assert hub.client_count == listening_count


def test_streams_whose_browser_is_gone_at_once_leave_nothing(running, ada):
    streams, hub = running.parts.streams, running.parts.hub
    listening_count = hub.client_count
    request = (
        f"GET /api/v1/events HTTP/1.1\r\nHost: h\r\nCookie: {COOKIE}={ada.cookies.get(COOKIE)}\r\n\r\n"
    ).encode()
    for _ in range(100):
        with connection(running) as gone:
            gone.sendall(request)
    wait_for(lambda: streams.count(StreamKind.EVENTS) == 0 and hub.client_count == listening_count)


def test_a_throw_and_stop_go_on_in_a_flood(running, machine, ada):
    assert ada.post("/machines/m001/lease").status_code == 200
    plan_id = ada.post("/machines/m001/plans", json=PLAN).json()["plan_id"]
    wait_for(lambda: ada.get(f"/plans/{plan_id}").json()["state"] == "ready")
    plan_hash = ada.get(f"/plans/{plan_id}").json()["plan_hash"]
    machine.swing_s = 60.0
    with contextlib.ExitStack() as stack:
        hold = stack.enter_context(Hold(running.url, ada))
        assert ada.post(f"/plans/{plan_id}/arm", json={"plan_hash": plan_hash}).status_code == 200
        hold.throw_id = ada.post(f"/plans/{plan_id}/fire").json()["throw_id"]
        # The same person's other pages, and somebody who is not signed in.
        flood(stack, running, ada, open_hold, StreamKind.HOLD)
        for _ in range(300):
            stack.enter_context(connection(running))
        before_count = len(machine.heartbeats)
        wait_for(lambda: len(machine.heartbeats) > before_count + 5)
        with running.client("vic") as viewer:
            assert viewer.post("/machines/m001/stop").status_code == 200
        wait_for(lambda: machine.stop_latched)
    wait_for(lambda: running.parts.streams.count(StreamKind.HOLD) == 0)


# Connections that ask for nothing -----------------------------------------------------------------


def connection(running, address="127.0.0.1"):
    """A connection from one of this computer's addresses."""
    port = httpx.URL(running.url).port
    return socket.create_connection(("127.0.0.1", port), timeout=60.0, source_address=(address, 0))


def is_closed(opened):
    opened.settimeout(0.001)
    try:
        return opened.recv(1) == b""
    except TimeoutError:
        return False
    except ConnectionResetError:
        return True


def test_silent_connections_make_room_for_those_that_ask(running):
    with contextlib.ExitStack() as stack:
        elsewhere = stack.enter_context(connection(running, "127.0.0.3"))
        silent = [stack.enter_context(connection(running, "127.0.0.2")) for _ in range(200)]
        wait_for(lambda: sum(is_closed(each) for each in silent) == 200 - 128)
        assert all(is_closed(each) for each in silent[:72])  # those that waited longest
        assert not is_closed(elsewhere)
        asked = stack.enter_context(connection(running, "127.0.0.2"))
        asked.sendall(b"GET /api/v1/health HTTP/1.1\r\nHost: h\r\n\r\n")
        assert asked.recv(12) == b"HTTP/1.1 200"
