"""The link misbehaves: stale fires, silence, STOP, duplicates, a server that restarts."""

import threading
import time

import pytest
from yard import Machine, Server, make, wait_for

from machine.messages import FireRequest, LeaseNotice, OperatorHeartbeat, ThrowState

HELD_S = 5.0


def refusals(server: Server) -> list[str]:
    return [e.data["reason"] for e in server.events if e.kind == "command_refused"]


def test_fire_held_by_a_dead_link_never_runs(server, machine, relay, plan):
    machine.start()
    wait_for(lambda: server.is_alive and server.states)
    nonce = server.arm(plan)
    fire = server.fire_command(plan, nonce, "throw-1")
    relay.hold()
    assert server.send(fire, timeout_s=0.5) is None
    server.hold_button("throw-1")
    time.sleep(HELD_S)
    relay.heal()
    # Both ends have given the session up after its lease of 1 s; a new one comes, the fire does not.
    wait_for(lambda: server.is_alive and server.states and "disarmed" in server.kinds())
    server.wait_state(ThrowState.DISARMED)
    assert "throw_accepted" not in server.kinds()


@pytest.mark.parametrize("has_echo", [True, False], ids=["echo", "no-echo"])
def test_fire_held_five_seconds_and_delivered_is_refused(
    tmp_path, router_port, relay, machine, plan, has_echo
):
    # A router that gives nobody up: the held fire is really delivered, with its nonce still alive.
    server = Server(tmp_path, router_port, lease_ms=60_000)
    machine.start()
    wait_for(lambda: server.is_alive and server.states)
    nonce = server.arm(plan)
    fire = server.fire_command(plan, nonce, "throw-1")
    if not has_echo:
        fire = fire.model_copy(update={"seen_t_mono_ns": None})
    relay.hold("down")
    asker = threading.Thread(target=server.send, args=(fire, 0.5))
    asker.start()
    server.hold_button("throw-1")
    time.sleep(0.5)
    server.go_silent()
    time.sleep(HELD_S - 0.5)
    before = server.state.joint_position_rad_m
    relay.heal()
    if has_echo:
        wait_for(lambda: refusals(server) == ["nonce_expired"])
    else:
        # The heartbeats that came with it are stale too: the machine stands until it gives up.
        wait_for(lambda: "throw_ended" in server.kinds("throw-1"))
        assert "throw_started" not in server.kinds()
    server.wait_state(ThrowState.DISARMED, ThrowState.ARMED)
    assert server.state.joint_position_rad_m == pytest.approx(before, abs=1e-3)
    asker.join()
    server.close()


def test_stop_is_delivered_after_the_link_heals_and_stays_latched(server, machine, relay, plan):
    machine.start()
    wait_for(lambda: server.is_alive and server.states)
    server.arm(plan)
    relay.hold()
    stop = server.stop_command()
    is_done = threading.Event()

    def repeat() -> None:
        while not is_done.wait(0.1):
            server.put("stop", stop.model_dump_json())

    repeater = threading.Thread(target=repeat)
    repeater.start()
    time.sleep(2.0)
    relay.heal()
    server.wait_state(ThrowState.STOPPED)
    is_done.set()
    repeater.join()
    wait_for(lambda: "stop_latched" in server.kinds())
    assert server.kinds().count("stop_latched") == 1
    reply = server.order(LeaseNotice, epoch_count=2)
    assert (reply.accepted, reply.state) == (True, ThrowState.STOPPED)


def test_silence_before_the_commit_point_brings_the_machine_to_hold(server, machine, plan):
    machine.start()
    wait_for(lambda: server.is_alive and server.states)
    nonce = server.arm(plan)
    assert server.send(server.fire_command(plan, nonce, "throw-1")).accepted
    server.hold_button("throw-1")
    server.wait_state(ThrowState.THROWING, ThrowState.ALIGNING)
    server.go_silent()
    wait_for(lambda: "aborted" in server.kinds("throw-1"))
    reason = next(e.data["reason"] for e in server.events if e.kind == "aborted")
    silent_s = float(reason.split("for ")[1].split(" s")[0])
    # On the machine's own clock: 300 ms and the tick that finds out, with room for late ticks.
    assert 0.30 <= silent_s < 0.40
    wait_for(lambda: "throw_ended" in server.kinds("throw-1"))
    end = next(e for e in server.events if e.kind == "throw_ended")
    assert end.data["outcome"] == "aborted"
    assert "release_commanded" not in server.kinds()
    server.wait_state(ThrowState.DISARMED)


def test_letting_go_is_heard_at_once_even_from_a_slow_link(server, machine, relay, plan):
    machine.start()
    wait_for(lambda: server.is_alive and server.states)
    relay.delay(0.15)
    nonce = server.arm(plan)
    assert server.send(server.fire_command(plan, nonce, "throw-1")).accepted
    server.hold_button("throw-1")
    server.wait_state(ThrowState.ALIGNING, ThrowState.THROWING)
    server.go_silent()
    release = OperatorHeartbeat(
        machine_id="m001",
        throw_id="throw-1",
        epoch_count=1,
        sequence_count=10_000,
        is_holding=False,
    )
    server.put("heartbeat", release.model_dump_json())
    wait_for(lambda: "aborted" in server.kinds("throw-1"))
    assert next(e for e in server.events if e.kind == "aborted").data["reason"] in (
        "the operator let go",
        # The last heartbeats may have been sent before the release overtook none of them.
    )


def test_duplicates_are_answered_not_executed(server, machine, plan):
    machine.start()
    wait_for(lambda: server.is_alive and server.states)
    nonce = server.arm(plan)
    fire = server.fire_command(plan, nonce, "throw-1")
    replies: list = []
    copies = [fire, fire, fire.model_copy(update={"command_id": "second"}), fire]
    threads = [
        threading.Thread(target=lambda f=copy: replies.append(server.send(f))) for copy in copies
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [reply.accepted for reply in replies] == [True] * 4
    assert sorted(reply.is_repeat for reply in replies) == [False, True, True, True]
    # No heartbeat: the machine stands, gives up, and a late duplicate does not start it again.
    wait_for(lambda: "throw_ended" in server.kinds("throw-1"))
    assert server.send(fire).is_repeat
    server.wait_state(ThrowState.DISARMED)
    assert server.kinds("throw-1").count("throw_accepted") == 1


def test_wrong_epoch_nonce_and_plan_are_refused(server, machine, plan):
    machine.start()
    wait_for(lambda: server.is_alive and server.states)
    nonce = server.arm(plan, epoch=3)
    good = server.fire_command(plan, nonce, "throw-1", epoch=3)
    for change, reason in (
        ({"nonce": "0" * 32}, "nonce_unknown"),
        ({"plan_hash": "0" * 64}, "plan_mismatch"),
        ({"epoch_count": 2}, "stale_epoch"),
        ({"machine_id": "m002"}, "wrong_machine"),
    ):
        fields = good.model_dump() | {"command_id": reason, "throw_id": reason} | change
        reply = server.send(FireRequest.model_validate(fields))
        assert (reply.accepted, reply.reason) == (False, reason)
    assert server.send(make(LeaseNotice, epoch_count=4)).accepted
    server.wait_state(ThrowState.DISARMED)


def test_unreadable_command_is_refused(server, machine):
    machine.start()
    wait_for(lambda: server.is_alive and server.states)
    replies = server._session.get(
        server._key("command"), payload=b'{"kind": "fire", "command_id": "c9"}', timeout=2.0
    )
    (answer,) = [bytes(reply.ok.payload) for reply in replies]
    assert b'"command_id":"c9"' in answer
    assert b'"reason":"malformed"' in answer


def test_server_restart_disarms_and_the_link_comes_back(server, machine, plan):
    machine.start()
    wait_for(lambda: server.is_alive and server.states)
    server.arm(plan)
    server.close()
    server.is_alive = False
    server.states.clear()
    server.open()
    wait_for(lambda: server.is_alive and server.states)
    wait_for(lambda: "disarmed" in server.kinds())
    assert server.wait_state(ThrowState.DISARMED).epoch_count == 1


def test_wrong_password_keeps_a_machine_out_until_it_is_corrected(server, machine: Machine):
    machine.password_file.write_text("guess", encoding="utf-8")
    machine.start()
    machine.child("runtime.link_process")
    time.sleep(3.0)
    assert not server.is_alive
    assert not server.states
    machine.password_file.write_text("rust-and-oil\n", encoding="utf-8")
    wait_for(lambda: server.is_alive and server.states)
