import threading
import time

import pytest
import zenoh

from machine.channels import machine_key
from machine.messages import ThrowState
from runtime.link.zenoh_config import client_config
from server.store.models import Audit, Machine
from tests.server.server_bench import (
    add_people,
    clear_stop,
    make_settings,
    running_server,
    wait_for,
)


def stop_rows(running):
    with running.parts.database.read() as database:
        rows = database.query(Audit).filter_by(action="stop").order_by(Audit.sequence_count).all()
        return [(row.actor, row.phase) for row in rows]


@pytest.fixture
def clear(running):
    def _clear():
        with running.client("sue") as sue:
            wait_for(lambda: clear_stop(sue).is_success)

    return _clear


def test_anyone_may_stop_without_lease_and_only_the_privileged_clear(running, machine, clear):
    with running.client("vic") as viewer, running.client("bob") as operator:
        reply = viewer.post("/machines/m001/stop").json()
        assert (reply["is_latched"], reply["is_pending"]) == (True, False)
        assert machine.stop_latched
        assert clear_stop(operator).status_code == 403
    assert stop_rows(running)[-2:] == [("vic", "intent"), ("vic", "outcome")]
    clear()
    assert not machine.stop_latched
    wait_for(lambda: not running.parts.stops.is_pending("m001"))
    time.sleep(0.3)
    assert not machine.stop_latched  # nothing goes on stopping it


def test_a_clear_says_which_latch_and_that_the_machine_is_seen(running, machine, clear):
    with running.client("vic") as viewer, running.client("sue") as sue:
        viewer.post("/machines/m001/stop")
        latch_id = wait_for(lambda: sue.get("/machines/m001").json()["state"]["latch_id"])
        said = {"latch_id": latch_id, "is_sighted": True, "reason": "nobody is in reach"}
        for odd in (
            {},
            {"latch_id": latch_id},
            said | {"is_sighted": False},
            said | {"reason": "   "},
            said | {"latch_id": ""},
            said | {"sighted_by": "somebody else"},
        ):
            assert sue.post("/machines/m001/stop/clear", json=odd).status_code == 422, odd
        old = clear_stop(sue, "an earlier latch")
        assert (old.status_code, old.json()["error"]["code"]) == (409, "latch_changed")
        assert "clear what is latched now" in old.json()["error"]["message"]
        assert machine.stop_latched
        assert sue.post("/machines/m001/stop/clear", json=said).status_code == 200
    command = next(c for c in machine.commands if c.kind == "stop_clear")
    assert (command.sighted_by, command.reason) == ("sue", "nobody is in reach")
    assert command.latch_id == latch_id


def test_stop_all(running, machine, clear):
    with running.client("vic") as viewer:
        replies = viewer.post("/stop").json()
    assert {r["machine_id"]: r["is_latched"] for r in replies}["m001"]
    assert machine.stop_latched
    clear()
    for known in running.parts.registry.listed():
        running.parts.stops._pending.pop(known.machine_id, None)


def test_stop_reaches_a_machine_whose_answers_are_lost(running, machine, clear):
    machine.drops_replies_of.add("stop")
    with running.client("vic") as viewer:
        reply = viewer.post("/machines/m001/stop").json()
    assert machine.stop_latched
    # Its own state confirms what the lost answer could not.
    wait_for(lambda: not running.parts.stops.is_pending("m001"))
    assert reply["detail"]
    clear()


def test_stop_is_repeated_until_confirmed(running, machine, clear):
    machine.ignores |= {"stop", "stop_put"}
    with running.client("vic") as viewer:
        reply = viewer.post("/machines/m001/stop").json()
        assert (reply["is_latched"], reply["is_pending"]) == (False, True)
        assert viewer.get("/machines/m001").json()["is_stop_pending"]
    received = machine.stops_received
    wait_for(lambda: machine.stops_received > received + 4)
    machine.ignores.clear()
    wait_for(lambda: machine.stop_latched)
    wait_for(lambda: not running.parts.stops.is_pending("m001"))
    clear()


def test_an_earlier_latch_neither_confirms_a_stop_nor_can_be_cleared_before_it_arrives(
    running, machine, clear
):
    with running.client("vic") as viewer, running.client("sue") as sue:
        assert viewer.post("/machines/m001/stop").json()["is_latched"]
        first = wait_for(lambda: sue.get("/machines/m001").json()["state"]["latch_id"])
        machine.ignores |= {"stop", "stop_put"}
        assert viewer.post("/machines/m001/stop").json()["is_pending"]
        received = machine.stops_received
        # The machine's states tell of the first latch all the while.
        wait_for(lambda: machine.stops_received > received + 8)
        assert running.parts.stops.is_pending("m001")
        reply = clear_stop(sue, first)
        assert (reply.status_code, reply.json()["error"]["code"]) == (409, "stop_pending")
        assert machine.stop_latched and machine.latch_id == first
        assert running.parts.stops.is_pending("m001")
        machine.ignores.clear()
        wait_for(lambda: not running.parts.stops.is_pending("m001"))
        assert machine.latch_id != first
        assert clear_stop(sue, first).status_code == 409
        assert machine.stop_latched
    clear()


def test_of_many_clears_at_once_none_undoes_a_later_stop(running, machine, clear):
    with running.client("vic") as viewer, running.client("sue") as sue:
        viewer.post("/machines/m001/stop")
        first = wait_for(lambda: sue.get("/machines/m001").json()["state"]["latch_id"])
        end, answers = threading.Event(), []

        def clear_first():
            with running.client("sue") as another:
                while not end.is_set():
                    answers.append(clear_stop(another, first).status_code)

        threads = [threading.Thread(target=clear_first) for _ in range(4)]
        for thread in threads:
            thread.start()
        try:
            wait_for(lambda: not machine.stop_latched)
            assert viewer.post("/machines/m001/stop").json()["is_latched"]
            count = len(answers)
            wait_for(lambda: len(answers) > count + 8)
            assert machine.stop_latched
            assert set(answers[count + 4 :]) == {409}
        finally:
            end.set()
            for thread in threads:
                thread.join()
    clear()


def test_stop_is_sent_even_if_the_audit_cannot_be_written(running, machine, clear, monkeypatch):
    def fail(*_args, **_kwargs):
        raise OSError("disk full")

    with running.client("vic") as viewer:
        monkeypatch.setattr(running.parts.audit, "append", fail)
        assert viewer.post("/machines/m001/stop").json()["is_latched"]
    assert machine.stop_latched
    monkeypatch.undo()
    clear()


def test_stop_is_sent_even_if_the_database_is_busy(running, machine, clear):
    with running.client("vic") as viewer, running.parts.database.write():
        # Not over HTTP: the check of rights reads, but records a denial only if there is one.
        assert viewer.post("/machines/m001/stop").json()["is_latched"]
        assert machine.stop_latched
    clear()


def test_stop_is_sent_although_every_thread_of_the_server_waits(
    running, machine, clear, monkeypatch
):
    is_over, waiting = threading.Event(), []

    def wait(*_):
        waiting.append(1)
        is_over.wait(60.0)
        return True

    # Forty threads serve all that is not STOP; more readers than that wait for something slow.
    monkeypatch.setattr(running.parts.statistics, "of", wait)
    threads = []
    with running.client("ada") as reader, running.client("vic") as viewer:
        try:
            for _ in range(50):
                thread = threading.Thread(target=reader.get, args=("/throws/stats",))
                thread.start()
                threads.append(thread)
            wait_for(lambda: len(waiting) >= 40)
            assert viewer.post("/machines/m001/stop", timeout=20.0).json()["is_latched"]
            assert machine.stop_latched
        finally:
            is_over.set()
            for thread in threads:
                thread.join()
    clear()


def test_stop_for_a_lost_machine_is_delivered_when_it_returns_even_after_a_restart(
    tmp_path, swing_policies
):
    settings = make_settings(tmp_path / "data", swing_policies)
    with running_server(settings) as first:
        add_people(first.parts)
        with first.machine():
            wait_for(lambda: first.parts.registry.is_connected("m001"))
        wait_for(lambda: not first.parts.registry.is_connected("m001"))
        with first.client("vic") as viewer:
            assert viewer.post("/machines/m001/stop").json()["is_pending"]

        def persisted():
            with first.parts.database.read() as database:
                return database.get(Machine, "m001").stop_requested_utc

        wait_for(persisted)
    with running_server(settings) as second, second.machine() as machine:
        wait_for(lambda: machine.stop_latched)
        wait_for(lambda: not second.parts.stops.is_pending("m001"))
        assert machine.state is ThrowState.STOPPED


def test_huge_states_of_another_machine_do_not_hold_stop_up(running, machine, clear):
    """Without a cap their parsing holds the interpreter for seconds at a time."""
    password = running.parts.registry.secret_path("m002").read_text().strip()
    payload = b"[" + b"0," * (17 * 1024 * 512) + b"0]"
    config = client_config(connect=(running.settings.link_listen,), user="m002", password=password)
    end = threading.Event()
    with zenoh.open(config) as session, running.client("vic") as viewer:
        publisher = session.declare_publisher(machine_key("yard", "m002", "state"))

        def attack():
            while not end.is_set():
                publisher.put(payload)

        attacker = threading.Thread(target=attack)
        attacker.start()
        try:
            time.sleep(1.0)
            began_s = time.monotonic()
            viewer.post("/machines/m001/stop").raise_for_status()
            assert machine.stop_latched
            assert time.monotonic() - began_s < 2.0
        finally:
            end.set()
            attacker.join()
    clear()
