"""kill -9 at several moments of a throw: each throw ends exactly once, records arrive once and in order."""

import signal
import time

import pytest
from yard import Machine, Server, wait_for

from machine.messages import ThrowState
from runtime.log_reader import read_throw_log

CONTROL = "runtime.control_process"
LINK = "runtime.link_process"


def assert_records_are_whole(server: Server) -> None:
    """Per boot: every sequence number once, in order, from 1."""
    by_boot: dict[str, list[int]] = {}
    for event in server.events:
        by_boot.setdefault(event.boot_id, []).append(event.sequence_count)
    for numbers in by_boot.values():
        assert numbers == list(range(1, len(numbers) + 1))


def ends(server: Server, throw_id: str) -> list[str]:
    return [
        e.data["outcome"]
        for e in server.events
        if e.kind == "throw_ended" and e.throw_id == throw_id
    ]


def begin_throw(server: Server, plan, throw_id: str, epoch: int = 1) -> None:
    nonce = server.arm(plan, epoch)
    assert server.send(server.fire_command(plan, nonce, throw_id, epoch)).accepted
    server.hold_button(throw_id, epoch)


def reach(server: Server, state: ThrowState) -> None:
    wait_for(lambda: server.state.state is state)


def wait_for_log(server: Server, throw_id: str) -> None:
    wait_for(lambda: "log_stored" in server.kinds(throw_id), 30.0)


@pytest.mark.parametrize("moment", [ThrowState.THROWING, ThrowState.COMMITTED])
def test_control_killed(server, machine: Machine, plan, moment):
    machine.start()
    wait_for(lambda: server.is_alive and server.states)
    begin_throw(server, plan, "throw-1")
    reach(server, moment)
    boot_id = server.state.boot_id
    machine.kill_child(CONTROL)
    assert server.wait_state(ThrowState.FAULT).fault
    # It comes back by itself, disarmed, with the epoch it knew and the throw it must not repeat.
    wait_for(lambda: server.state.boot_id != boot_id)
    state = server.wait_state(ThrowState.DISARMED)
    assert (state.epoch_count, state.throw_id) == (1, None)
    wait_for(lambda: ends(server, "throw-1"))
    wait_for_log(server, "throw-1")
    assert ends(server, "throw-1") == ["interrupted"]
    server.go_silent()
    machine.stop()
    assert_records_are_whole(server)
    log = read_throw_log(machine.folder / "throws" / "throw-1.mcap")
    assert not log.is_complete
    assert log.metadata["result"]["outcome"] == "interrupted"
    assert len(log.control) > 50


@pytest.mark.parametrize(
    ("moment", "outcome"), [(ThrowState.THROWING, "aborted"), (ThrowState.COMMITTED, "landed")]
)
def test_link_killed(server, machine: Machine, plan, moment, outcome):
    machine.start()
    wait_for(lambda: server.is_alive and server.states)
    begin_throw(server, plan, "throw-1")
    reach(server, moment)
    boot_id = server.state.boot_id
    machine.kill_child(LINK)
    wait_for(lambda: ends(server, "throw-1"), 30.0)
    wait_for_log(server, "throw-1")
    assert ends(server, "throw-1") == [outcome]
    assert server.wait_state(ThrowState.DISARMED).boot_id == boot_id
    server.go_silent()
    machine.stop()
    assert_records_are_whole(server)
    log = read_throw_log(machine.folder / "throws" / "throw-1.mcap")
    assert log.metadata["result"]["outcome"] == outcome
    # One file with both processes' parts; what lies between them is missing and said to be.
    assert not log.is_complete
    assert log.control["tick_count"][0] == 0


@pytest.mark.parametrize("moment", [ThrowState.ALIGNING, ThrowState.SETTLING])
def test_power_cut(server, machine: Machine, plan, moment):
    machine.start()
    wait_for(lambda: server.is_alive and server.states)
    begin_throw(server, plan, "throw-1")
    reach(server, moment)
    machine.kill()
    server.go_silent()
    wait_for(lambda: not server.is_alive)
    fire = server.fire_command(plan, "0" * 32, "throw-1")
    machine.start()
    wait_for(lambda: ends(server, "throw-1"), 30.0)
    wait_for_log(server, "throw-1")
    assert ends(server, "throw-1") == ["interrupted"]
    # The same throw id after the restart is answered, never executed.
    wait_for(lambda: server.is_alive)
    reply = server.send(fire)
    assert reply.is_repeat
    assert server.wait_state(ThrowState.DISARMED).epoch_count == 1
    machine.stop()
    assert_records_are_whole(server)
    assert server.kinds("throw-1").count("throw_accepted") == 1


def test_frozen_link_lets_go_before_the_commit_point(server, machine: Machine, plan):
    machine.start()
    wait_for(lambda: server.is_alive and server.states)
    begin_throw(server, plan, "throw-1")
    reach(server, ThrowState.ALIGNING)
    machine.kill_child(LINK, signal.SIGSTOP)
    wait_for(lambda: not server.is_alive)
    server.go_silent()
    machine.kill_child(LINK, signal.SIGCONT)
    wait_for(lambda: ends(server, "throw-1"))
    wait_for_log(server, "throw-1")
    assert ends(server, "throw-1") == ["aborted"]
    machine.stop()
    assert_records_are_whole(server)


def test_link_cut_in_the_middle_and_lost_acknowledgements(server, machine: Machine, relay, plan):
    machine.start()
    wait_for(lambda: server.is_alive and server.states)
    begin_throw(server, plan, "throw-1")
    reach(server, ThrowState.COMMITTED)
    server.acks_lost = 2
    relay.cut()
    server.go_silent()
    time.sleep(3.0)
    relay.mend()
    wait_for(lambda: ends(server, "throw-1"), 30.0)
    wait_for_log(server, "throw-1")
    wait_for(lambda: server.state.outbox_count == 0)
    assert ends(server, "throw-1") == ["landed"]
    assert server.repeats > 0
    machine.stop()
    assert_records_are_whole(server)
    assert read_throw_log(machine.folder / "throws" / "throw-1.mcap").is_complete


def test_killed_supervisor_leaves_no_process_and_no_open_throw(server, machine: Machine, plan):
    machine.start()
    wait_for(lambda: server.is_alive and server.states)
    begin_throw(server, plan, "throw-1")
    reach(server, ThrowState.THROWING)
    children = [machine.child(CONTROL), machine.child(LINK)]
    machine.process.send_signal(signal.SIGKILL)
    machine.process.wait()
    server.go_silent()

    def are_gone() -> bool:
        return not any(_is_alive(pid) for pid in children)

    wait_for(are_gone)
    assert ends(server, "throw-1") == ["aborted"]
    assert_records_are_whole(server)


def _is_alive(pid: int) -> bool:
    try:
        with open(f"/proc/{pid}/stat", encoding="ascii") as stat:
            return stat.read().split(")")[1].split()[0] != "Z"
    except FileNotFoundError:
        return False
