"""kill -9 at several moments of a throw: each throw ends exactly once, records arrive once and in order."""

import os
import signal
import time

import pytest

from machine.messages import ThrowState
from runtime.records.log_reader import read_throw_log
from tests.link.yard import Server
from tests.waiting import is_alive, wait_for

CONTROL = "runtime.process.control_process"
LINK = "runtime.process.link_process"


def long(*values: str):
    """A case for `make test-long`; `make test` has another moment of the same kill."""
    return pytest.param(*values, marks=pytest.mark.long)


@pytest.fixture(autouse=True)
def records_are_whole(yard):
    """After each test, per boot: every sequence number once, in order, from 1."""
    yield
    by_boot: dict[str, list[int]] = {}
    for event in yard.server.events:
        by_boot.setdefault(event.boot_id, []).append(event.sequence_count)
    for numbers in by_boot.values():
        assert numbers == list(range(1, len(numbers) + 1))
    for throw_id in {event.throw_id for event in yard.server.events} - {None}:
        assert len(yard.server.ends(throw_id)) <= 1


def wait_for_end(server: Server, throw_id: str) -> str:
    wait_for(lambda: server.ends(throw_id))
    return server.ends(throw_id)[0]


@pytest.mark.parametrize("moment", [long("throw_started"), "release_commanded"])
def test_control_killed(yard, moment):
    server = yard.server
    throw_id = yard.fire_until(moment)
    boot_id = server.state.boot_id
    yard.machine.kill_child(CONTROL)
    assert server.wait_state(ThrowState.FAULT).fault
    # It comes back by itself, stopped, with the epoch it knew and the throw it must not repeat.
    wait_for(lambda: server.state.boot_id != boot_id)
    state = server.wait_state(ThrowState.STOPPED)
    assert "died" in state.latched_reason and state.latch_id
    assert (state.epoch_count, state.throw_id) == (yard.epoch, None)
    assert wait_for_end(server, throw_id) == "interrupted"
    assert server.send(yard.fire_command("", throw_id)).is_repeat
    yard.wait_for_log(throw_id)
    log = read_throw_log(yard.log_path(throw_id))
    assert not log.is_complete
    assert log.metadata["result"]["outcome"] == "interrupted"
    assert len(log.control) > 10


@pytest.mark.parametrize(
    ("moment", "outcome"), [long("throw_started", "aborted"), ("release_commanded", "landed")]
)
def test_link_killed(yard, moment, outcome):
    server = yard.server
    throw_id = yard.fire_until(moment)
    boot_id = server.state.boot_id
    yard.machine.kill_child(LINK)
    assert wait_for_end(server, throw_id) == outcome
    yard.wait_for_log(throw_id)
    assert server.wait_state(ThrowState.DISARMED).boot_id == boot_id
    log = read_throw_log(yard.log_path(throw_id))
    assert log.metadata["result"]["outcome"] == outcome
    # One file with what both processes had; the rows between them are missing and it says so.
    assert not log.is_complete
    assert log.control["tick_count"][0] == 0
    assert len(log.control) > 10
    assert log.events[-1].kind == "throw_ended"


@pytest.mark.parametrize("moment", [long("throw_accepted"), "impact"])
def test_power_cut(yard, moment):
    server = yard.server
    throw_id = yard.fire_until(moment)
    yard.machine.kill()
    server.go_silent()
    wait_for(lambda: not server.is_alive)
    fire = yard.fire_command("0" * 32, throw_id)
    yard.machine.start()
    assert wait_for_end(server, throw_id) == "interrupted"
    yard.wait_for_log(throw_id)
    # The same throw id after the restart is answered, never executed.
    wait_for(lambda: server.is_alive)
    assert server.send(fire).is_repeat
    assert server.wait_state(ThrowState.STOPPED).epoch_count == yard.epoch
    assert server.kinds(throw_id).count("throw_accepted") == 1


@pytest.mark.parametrize(
    ("moment", "outcome"), [("throw_accepted", "aborted"), long("release_commanded", "landed")]
)
def test_hung_link_is_killed_and_stop_arrives_again(yard, moment, outcome):
    server = yard.server
    throw_id = yard.fire_until(moment)
    pid, boot_id = yard.machine.child(LINK), server.state.boot_id
    os.kill(pid, signal.SIGSTOP)
    wait_for(lambda: not is_alive(pid))
    assert yard.machine.child(LINK) != pid
    # Control has not died: it held still, or completed what was past the commit point.
    assert wait_for_end(server, throw_id) == outcome
    yard.wait_for_log(throw_id)
    assert server.state.boot_id == boot_id
    reply = server.send(server.stop_command())
    assert (reply.accepted, reply.state) == (True, ThrowState.STOPPED)


def test_hung_control_is_killed_and_comes_back_stopped_while_stop_is_answered(yard):
    server = yard.server
    fire = yard.fire_command(yard.arm(), throw_id := yard.new_throw_id())
    pid, boot_id = yard.machine.child(CONTROL), server.state.boot_id
    os.kill(pid, signal.SIGSTOP)
    wait_for(lambda: not is_alive(pid))
    stop = server.stop_command()
    reply = server.send(stop)
    assert (reply.accepted, reply.state) == (True, ThrowState.STOPPED)
    assert reply.latch_id.startswith("link-"), "answered before control is back"
    fault = server.wait_state(ThrowState.FAULT)
    assert fault.fault and fault.stop_latched
    wait_for(lambda: server.state.boot_id != boot_id)
    state = server.wait_state(ThrowState.STOPPED)
    assert state.latch_id == reply.latch_id and "STOP by operator" in state.latched_reason
    assert not server.send(fire).accepted
    assert server.kinds(throw_id) == []


def test_stop_outlives_the_control_process_and_a_power_cut(yard):
    server = yard.server
    reply = server.send(server.stop_command())
    assert (reply.accepted, reply.state) == (True, ThrowState.STOPPED)
    boot_id = server.state.boot_id
    yard.machine.kill_child(CONTROL)
    wait_for(lambda: server.state.boot_id != boot_id)
    state = server.wait_state(ThrowState.STOPPED)
    assert (state.latch_id, state.stop_latched) == (reply.latch_id, True)
    yard.machine.kill()
    wait_for(lambda: not server.is_alive)
    server.states.clear()
    yard.machine.start()
    wait_for(lambda: server.states)
    assert server.wait_state(ThrowState.STOPPED).latch_id == reply.latch_id
    cleared = server.clear(yard.epoch)
    assert cleared.accepted and cleared.latch_id == ""
    server.wait_state(ThrowState.DISARMED)
    assert [e.data["latch_id"] for e in server.events if e.kind == "stop_cleared"][
        -1
    ] == reply.latch_id


def test_link_cut_in_the_middle_and_lost_acknowledgements(yard):
    server, repeats = yard.server, yard.server.repeats
    throw_id = yard.fire_until("release_commanded")
    server.acks_lost = 2
    yard.relay.cut()
    server.go_silent()
    time.sleep(2.0)
    yard.relay.mend()
    assert wait_for_end(server, throw_id) == "landed"
    yard.wait_for_log(throw_id)
    wait_for(lambda: server.state.outbox_count == 0)
    assert server.repeats > repeats
    assert read_throw_log(yard.log_path(throw_id)).is_complete


def test_killed_supervisor_leaves_no_process_and_no_open_throw(yard):
    server = yard.server
    throw_id = yard.fire_until("throw_started")
    children = [yard.machine.child(CONTROL), yard.machine.child(LINK)]
    yard.machine.process.send_signal(signal.SIGKILL)
    yard.machine.process.wait()
    server.go_silent()
    wait_for(lambda: not any(is_alive(pid) for pid in children))
    assert server.ends(throw_id) == ["aborted"]
