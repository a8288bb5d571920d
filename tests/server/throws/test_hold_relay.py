import json
import time
from types import SimpleNamespace

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from server.accounts.accounts import COOKIE
from server.metrics import ServiceMetrics
from server.schemas.console import Role
from server.store.models import User
from server.throws.hold_relay import GRANT_S, HoldRelay
from tests.cases import each
from tests.server.server_bench import PASSWORD, run_out


def open_hold(running, client, machine_id="m001", **headers):
    given = {"Origin": running.url, "Cookie": f"{COOKIE}={client.cookies.get(COOKIE)}"}
    return connect(
        f"ws{running.url.removeprefix('http')}/api/v1/machines/{machine_id}/hold",
        additional_headers=given | headers,
        proxy=None,
    )


@each(
    "headers",
    [
        {"Origin": "https://evil.example"},
        {"Origin": ""},
        {"Cookie": ""},
        {"Cookie": f"{COOKIE}=guess"},
    ],
)
def test_other_callers_are_refused(running, ada, headers):
    with pytest.raises(InvalidStatus) as caught, open_hold(running, ada, **headers):
        pass
    assert caught.value.response.status_code == 403


def test_viewers_are_not_let_in(running):
    with (
        running.client("vic") as viewer,
        pytest.raises(InvalidStatus),
        open_hold(running, viewer),
    ):
        pass


@each(
    "message",
    ["", "x", "[]", '{"throw_id": 1, "holding": true}', '{"throw_id": "t"}', "{" * 5000],
)
def test_nonsense_closes_the_socket(running, ada, message):
    with open_hold(running, ada) as socket:
        socket.send(message)
        with pytest.raises(ConnectionClosed) as caught:
            socket.recv(timeout=30.0)
    assert caught.value.rcvd.code == 4400


def test_bytes_close_the_socket(running, ada):
    with open_hold(running, ada) as socket:
        socket.send(b"\x00\x01")
        with pytest.raises(ConnectionClosed):
            socket.recv(timeout=30.0)


def test_holding_nothing_is_answered_and_relayed_to_nobody(running, machine, ada):
    with open_hold(running, ada) as socket:
        for _ in range(3):
            socket.send(json.dumps({"throw_id": "t", "holding": True}))
        reply = json.loads(socket.recv(timeout=30.0))
        assert not reply["is_relayed"]
        assert reply["detail"]
    assert not machine.heartbeats


def test_signing_out_closes_the_socket(running, monkeypatch):
    monkeypatch.setattr("server.routes.hold.RECHECK_S", 0.1)
    with running.client("bob") as bob, open_hold(running, bob) as socket:
        bob.post("/auth/logout")
        with pytest.raises(ConnectionClosed) as caught:
            socket.recv(timeout=30.0)
    assert caught.value.rcvd.code == 4401


def test_a_session_that_runs_out_closes_the_socket(running, monkeypatch):
    monkeypatch.setattr("server.routes.hold.RECHECK_S", 0.1)
    with running.client("bob") as bob, open_hold(running, bob) as socket:
        run_out(running.parts, bob)
        with pytest.raises(ConnectionClosed) as caught:
            socket.recv(timeout=30.0)
    assert caught.value.rcvd.code == 4401


def test_a_person_who_may_not_throw_any_more_holds_nothing(running, monkeypatch):
    monkeypatch.setattr("server.routes.hold.RECHECK_S", 0.1)
    running.parts.accounts.create_user("tom", PASSWORD, Role.OPERATOR)
    with running.client("tom") as tom, open_hold(running, tom) as socket:
        with running.parts.database.write() as database:
            database.get(User, "tom").role = Role.VIEWER.value
        with pytest.raises(ConnectionClosed) as caught:
            socket.recv(timeout=30.0)
    assert caught.value.rcvd.code == 4401


SEEN_NS = 40_000_000_000


class Wire:
    """Takes what would go to the machine."""

    def __init__(self):
        self.sent = []

    def put_heartbeat(self, heartbeat):
        self.sent.append(heartbeat)


@pytest.fixture
def desk():
    wire = Wire()
    registry = SimpleNamespace(machine_t_mono_ns=lambda _: SEEN_NS + 100_000_000)
    desk = HoldRelay(wire, registry, ServiceMetrics())
    desk.begin("m001", "t1", "s1", 7)
    return desk, wire


def test_only_the_session_that_fired_holds_only_this_throw(desk):
    holds, wire = desk
    assert holds.relay("m001", "t1", "s1", is_holding=True, echo_ns=SEEN_NS) == ""
    assert "another session" in holds.relay("m001", "t1", "s2", is_holding=True, echo_ns=SEEN_NS)
    assert "t1" in holds.relay("m001", "t2", "s1", is_holding=True, echo_ns=SEEN_NS)
    assert holds.relay("m002", "t1", "s1", is_holding=True, echo_ns=SEEN_NS)
    assert [(beat.sequence_count, beat.epoch_count) for beat in wire.sent] == [(1, 7)]


def test_each_message_is_one_heartbeat_and_silence_is_silence(desk):
    holds, wire = desk
    for _ in range(5):
        holds.relay("m001", "t1", "s1", is_holding=True, echo_ns=SEEN_NS)
    time.sleep(0.2)
    assert [beat.sequence_count for beat in wire.sent] == [1, 2, 3, 4, 5]


def test_a_hold_is_as_old_as_the_machines_time_that_the_browser_echoes(desk):
    holds, wire = desk
    for echo_ns in (None, SEEN_NS, SEEN_NS + 900_000_000):
        holds.relay("m001", "t1", "s1", is_holding=True, echo_ns=echo_ns)
    holds.relay("m001", "t1", "s1", is_holding=False, echo_ns=None)
    seen = [beat.seen_t_mono_ns - SEEN_NS for beat in wire.sent]
    assert seen == [0, 100_000_000, 100_000_000]
    assert [beat.is_holding for beat in wire.sent] == [True, True, False]


def test_a_lease_that_changes_hands_ends_the_hold(desk):
    holds, wire = desk
    holds.revoke("m001")
    assert "changed hands" in holds.relay("m001", "t1", "s1", is_holding=True, echo_ns=SEEN_NS)
    holds.let_go("m001", "s1")
    assert not wire.sent


def test_the_end_of_a_throw_and_of_time_end_the_hold(desk, monkeypatch):
    holds, wire = desk
    holds.end("another")
    assert holds.relay("m001", "t1", "s1", is_holding=True, echo_ns=SEEN_NS) == ""
    now_s = time.monotonic()
    monkeypatch.setattr("server.throws.hold_relay.time.monotonic", lambda: now_s + GRANT_S + 1.0)
    assert holds.relay("m001", "t1", "s1", is_holding=True, echo_ns=SEEN_NS)
    monkeypatch.undo()
    holds.end("t1")
    assert holds.relay("m001", "t1", "s1", is_holding=True, echo_ns=SEEN_NS)
    assert len(wire.sent) == 1


def test_letting_go_is_said_once_by_the_one_who_held(desk):
    holds, wire = desk
    holds.let_go("m001", "s1")
    assert not wire.sent  # nothing was held yet: the deadman of the machine counts from its start
    holds.relay("m001", "t1", "s1", is_holding=True, echo_ns=SEEN_NS)
    holds.let_go("m001", "s2")
    holds.let_go_all("s1")
    assert [beat.is_holding for beat in wire.sent] == [True, False]
