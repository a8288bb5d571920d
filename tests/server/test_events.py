import asyncio
import json
import threading
import time

import httpx
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from server.accounts.accounts import COOKIE
from server.event_hub import QUEUE_LENGTH, EventHub
from server.schemas.events import AlertEvent, ServerEvent
from tests.cases import each
from tests.server.server_bench import run_out, wait_for


class Listener:
    """A browser's event stream in a thread."""

    def __init__(self, client: httpx.Client, **params: str):
        self.events: list[dict] = []
        self.is_open = False
        self._client, self._params = client, params
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self):
        self._thread.start()
        wait_for(lambda: self.is_open)
        return self

    def __exit__(self, *_):
        self._response.close()
        self._thread.join(timeout=30.0)

    def _run(self):
        with self._client.stream("GET", "/events", params=self._params, timeout=120.0) as response:
            self._response = response
            self.is_open = response.status_code == 200
            name = ""
            try:
                for line in response.iter_lines():
                    if line.startswith("event: "):
                        name = line.removeprefix("event: ")
                    elif line.startswith("data: ") and name != "ping":
                        event = json.loads(line.removeprefix("data: "))
                        assert event["kind"] == name
                        ServerEvent.model_validate(event)
                        self.events.append(event)
            except (httpx.StreamError, httpx.ReadError, AttributeError, ValueError):
                pass
        self.is_open = False

    def of(self, kind):
        return [event for event in list(self.events) if event["kind"] == kind]


def test_states_leases_targets_and_loss_are_streamed(running, ada):
    with Listener(ada, machine_id="m001") as listener:
        with running.machine():
            wait_for(lambda: len(listener.of("machine.state")) > 3)
            ada.post("/machines/m001/lease")
            wait_for(lambda: listener.of("lease.changed"))
            assert listener.of("lease.changed")[-1]["lease"]["holder"] == "ada"
            ada.put("/machines/m001/target", json={"x_m": 30.0, "y_m": 0.0, "mode": "2d"})
            proposed = wait_for(lambda: listener.of("target.proposed"))[-1]
            assert "30.00 m" in proposed["refusal"]
            ada.put("/machines/m001/target", json={"x_m": 9.0, "y_m": 0.0})
            wait_for(lambda: listener.of("target.proposed")[-1]["refusal"] == "")
            gone_s = time.monotonic()
        wait_for(lambda: listener.of("machine.lost"))
        assert time.monotonic() - gone_s < 15.0
        wait_for(lambda: listener.of("machine.state")[-1]["machine"]["lamp"] == "lost")
        shown = ada.get("/machines/m001").json()
        assert shown["lamp_text"].startswith("lost since")
        assert shown["state"] is not None
        ada.delete("/machines/m001/lease")


def test_private_events_stay_private(running, ada):
    with running.client("bob") as bob, Listener(ada) as mine, Listener(bob) as other:
        ada.put("/machines/m001/target", json={"x_m": 9.0, "y_m": 0.0})
        wait_for(lambda: mine.of("target.proposed"))
        running.parts.hub.alert("test", "for everybody")
        wait_for(lambda: other.of("alert"))
        assert not other.of("target.proposed")


def test_logout_ends_the_stream(running):
    with running.client("bob") as bob, Listener(bob) as listener:
        bob.post("/auth/logout")
        wait_for(lambda: not listener.is_open)


def test_a_session_that_runs_out_ends_the_stream_although_states_leave_no_pause(running, machine):
    with running.client("bob") as bob, Listener(bob, machine_id="m001") as listener:
        wait_for(lambda: len(listener.of("machine.state")) > 3)
        run_out(running.parts, bob)
        wait_for(lambda: not listener.is_open, 20.0)


def test_streams_need_a_session(running):
    with running.client() as nobody:
        assert nobody.get("/events").status_code == 401


def alert(number: int) -> AlertEvent:
    return AlertEvent(severity="info", code="n", text=str(number), machine_id=None)


def test_discrete_events_keep_their_order_and_are_all_there():
    async def main():
        hub = EventHub()
        client = hub.subscribe("s", None)
        for number in range(100):
            hub.publish(alert(number))
        frames = await client.wait(1.0)
        assert [json.loads(f.data)["text"] for f in frames] == [str(n) for n in range(100)]
        assert await client.wait(0.01) == []

    asyncio.run(main())


def test_a_client_that_does_not_read_is_closed_and_costs_a_bounded_queue():
    async def main():
        hub = EventHub()
        slow, quick = hub.subscribe("s", None), hub.subscribe("s", None)
        for number in range(QUEUE_LENGTH * 3):
            hub.publish(alert(number))
            if number % 100 == 0:
                await quick.wait(0.1)
        assert slow.is_closed
        assert len(await slow.wait(0.1)) <= QUEUE_LENGTH
        assert not quick.is_closed

    asyncio.run(main())


@pytest.fixture
def state_event(assembled):
    from server.schemas.events import MachineStateEvent

    assembled.parts.registry.enrol("m001", "", assembled.session().actor)
    return MachineStateEvent(machine=assembled.parts.views.view("m001"))


def test_states_replace_each_other_and_are_made_once_for_all_that_are_due(state_event):
    made = []

    def make():
        made.append(1)
        return state_event

    async def main():
        hub = EventHub()
        hub.publish_state("m001", make)
        assert not made
        clients = [hub.subscribe("s", watched) for watched in ("m002", None, "m001")]
        for _ in range(50):
            hub.publish_state("m001", make)
        assert len(made) == 1
        hub.publish_state("m001", make, is_urgent=True)
        for client in clients:
            assert len(await client.wait(0.1)) == 1
        assert len(made) == 2

    asyncio.run(main())


# Over a WebSocket -----------------------------------------------------------------------------------


def open_events(running, client, **headers):
    given = {"Origin": running.url, "Cookie": f"{COOKIE}={client.cookies.get(COOKIE)}"}
    return connect(
        f"ws{running.url.removeprefix('http')}/api/v1/events/socket?machine_id=m001",
        additional_headers=given | headers,
        proxy=None,
    )


def test_the_console_has_the_same_events_over_a_websocket(running, ada):
    with open_events(running, ada) as socket, running.machine():
        kinds = set()
        while not {"machine.state", "lease.changed"} <= kinds:
            for event in json.loads(socket.recv(timeout=30.0)):
                ServerEvent.model_validate(event)
                if event["kind"] == "machine.state" and "machine.state" not in kinds:
                    ada.post("/machines/m001/lease")
                kinds.add(event["kind"])
        ada.delete("/machines/m001/lease")


def test_a_quiet_socket_says_that_the_server_is_there(running, ada):
    with open_events(running, ada) as socket:
        wait_for(lambda: json.loads(socket.recv(timeout=30.0)) == [])


@each(
    "headers", [{"Origin": "https://evil.example"}, {"Cookie": ""}, {"Cookie": f"{COOKIE}=guess"}]
)
def test_other_callers_get_no_events(running, ada, headers):
    with pytest.raises(InvalidStatus) as caught, open_events(running, ada, **headers):
        pass
    assert caught.value.response.status_code == 403


def test_a_socket_ends_with_its_session(running):
    with running.client("bob") as bob, open_events(running, bob) as socket:
        bob.post("/auth/logout")
        with pytest.raises(ConnectionClosed) as caught:
            while True:
                socket.recv(timeout=30.0)
    assert caught.value.rcvd.code == 4401


def test_a_socket_ends_when_its_session_runs_out(running):
    with running.client("bob") as bob, open_events(running, bob) as socket:
        run_out(running.parts, bob)
        with pytest.raises(ConnectionClosed) as caught:
            while True:
                socket.recv(timeout=30.0)
    assert caught.value.rcvd.code == 4401


def test_a_browser_that_talks_loses_its_socket_and_leaves_nothing(running, ada):
    listening_count = running.parts.hub.client_count
    with open_events(running, ada) as socket:
        socket.send("hello")
        with pytest.raises(ConnectionClosed):
            while True:
                socket.recv(timeout=30.0)
    wait_for(lambda: running.parts.hub.client_count == listening_count)
