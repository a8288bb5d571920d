"""One throw through real processes and a real router, from lease to the stored log."""

from machine.messages import FireRequest
from runtime.records.log_reader import read_throw_log


def test_a_throw_from_lease_to_log(yard):
    server = yard.server
    throw_id = yard.fire_until("release_commanded")
    server.go_silent()
    yard.wait_for_log(throw_id)
    assert server.kinds(throw_id) == [
        "throw_accepted",
        "throw_started",
        "release_commanded",
        "impact",
        "throw_ended",
        "log_stored",
    ]
    # The same fire once more: answered from memory, not executed.
    fire = yard.fire_command("", throw_id)
    again = server.send(FireRequest.model_validate(fire.model_dump() | {"command_id": "other"}))
    assert (again.accepted, again.is_repeat) == (True, True)
    assert yard.machine.stop() == 0
    sequences = [event.sequence_count for event in server.events]
    assert sequences == list(range(1, len(sequences) + 1))
    log = read_throw_log(yard.log_path(throw_id))
    assert log.is_complete
    assert log.metadata["plan_hash"] == yard.plan.plan_hash
    assert log.metadata["result"]["outcome"] == "landed"
    assert list(log.control["tick_count"]) == list(range(len(log.control)))
    assert [event.kind for event in log.events] == server.kinds(throw_id)[:-1]
    assert len(log.control) > 200
    assert len(log.policy) > 3
    assert len(log.ball) > 10
    assert log.impact.position_m == (8.1, 0.4, 0.0)
