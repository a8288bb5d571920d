"""One throw through real processes and a real router, from lease to the stored log."""

from yard import wait_for

from machine.messages import FireRequest, ThrowState
from runtime.log_reader import read_throw_log


def test_a_throw_from_lease_to_log(server, machine, plan):
    machine.start()
    wait_for(lambda: server.is_alive and server.states)
    nonce = server.arm(plan)
    fire = server.fire_command(plan, nonce, "throw-1")
    reply = server.send(fire)
    assert (reply.accepted, reply.throw_id) == (True, "throw-1")
    server.hold_button("throw-1")
    server.wait_state(ThrowState.COMMITTED)
    server.go_silent()
    wait_for(lambda: "log_stored" in server.kinds("throw-1"), 30.0)
    assert server.kinds("throw-1") == [
        "throw_accepted",
        "throw_started",
        "release_commanded",
        "impact",
        "throw_ended",
        "log_stored",
    ]
    # The same fire once more: answered from memory, not executed.
    again = server.send(FireRequest.model_validate(fire.model_dump() | {"command_id": "other"}))
    assert (again.accepted, again.is_repeat) == (True, True)
    assert machine.stop() == 0
    sequences = [event.sequence_count for event in server.events]
    assert sequences == list(range(1, len(sequences) + 1))
    log = read_throw_log(machine.folder / "throws" / "throw-1.mcap")
    assert log.is_complete
    assert log.metadata["plan_hash"] == plan.plan_hash
    assert list(log.control["tick_count"]) == list(range(len(log.control)))
    assert len(log.policy) > 3
    assert len(log.ball) > 10
    assert log.impact.position_m == (8.1, 0.4, 0.0)
