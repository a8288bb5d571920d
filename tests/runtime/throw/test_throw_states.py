"""The passing of time, heartbeats and facts: everything in the protocol that is not a command."""

import pytest

from machine.conventions import Motion
from machine.messages import CheckResult, ThrowState
from runtime.throw.protocol import LinkLost
from tests.cases import each
from tests.runtime.protocol_bench import Bench

S = ThrowState
EVERY = list(ThrowState)


def at(state: ThrowState) -> Bench:
    bench = Bench()
    bench.go_to(state)
    return bench


def failed(severity: str) -> CheckResult:
    return CheckResult(check_id="x", passed=False, severity=severity, text="Bad thing.")


def test_a_throw_from_arm_to_rest():
    bench = Bench()
    bench.arm()
    assert bench.outcome == (S.ARMED, Motion.HOLD)
    assert bench.kinds == ["armed"]
    assert (bench.reply.accepted, bench.reply.nonce, bench.reply.nonce_valid_s) == (
        True,
        "nonce-1",
        10,
    )
    bench.fire()
    assert bench.outcome == (S.ALIGNING, Motion.HOLD)
    assert bench.kinds == ["throw_accepted"]
    assert (bench.reply.throw_id, bench.reply.nonce) == ("t1", None)
    bench.beat()
    assert bench.outcome == (S.ALIGNING, Motion.ALIGN)
    bench.tick(motion=Motion.ALIGN, aligned=True)
    assert bench.outcome == (S.THROWING, Motion.THROW)
    assert bench.kinds == ["throw_started"]
    bench.wait(0.25)
    bench.tick(motion=Motion.THROW, release_commanded=True)
    assert bench.outcome == (S.COMMITTED, Motion.THROW)
    assert bench.kinds == ["release_commanded"]
    bench.wait(0.26)
    bench.tick(motion=Motion.THROW, throw_done=True, load_gone=True, payload_held=False)
    assert bench.outcome == (S.SETTLING, Motion.SETTLE)
    bench.wait(6.0)
    bench.tick(motion=Motion.SETTLE, settled=True, payload_held=False)
    assert bench.outcome == (S.DISARMED, Motion.HOLD)
    (event,) = bench.actions.events
    assert (event.kind.value, event.throw_id, event.plan_id) == ("throw_ended", "t1", "plan-1")
    assert event.data["outcome"] == "landed"
    assert event.data["throw_duration_s"] == pytest.approx(0.25)
    assert (bench.machine.plan, bench.machine.nonce, bench.machine.throw_id) == (None, "", None)


@each("state", EVERY)
def test_motion_of_every_state(state):
    expected = {
        S.DISARMED: Motion.HOLD,
        S.ARMED: Motion.HOLD,
        S.ALIGNING: Motion.ALIGN,
        S.THROWING: Motion.THROW,
        S.COMMITTED: Motion.THROW,
        S.SETTLING: Motion.SETTLE,
        S.STOPPED: Motion.STOP,
        S.FAULT: Motion.STOP,
    }
    assert at(state).machine.motion is expected[state]


@each("state", EVERY)
def test_a_quiet_tick_changes_nothing(state):
    bench = at(state)
    before = bench.machine
    bench.tick()
    assert bench.machine is before
    assert bench.actions.events == () and bench.reply is None and not bench.actions.load


# Heartbeats


def test_the_machine_stands_until_the_first_heartbeat():
    bench = Bench()
    bench.arm()
    bench.fire()
    bench.wait(1.0)
    bench.tick(motion=Motion.HOLD)
    assert bench.outcome == (S.ALIGNING, Motion.HOLD)
    bench.wait(1e-9)
    bench.tick()
    assert bench.outcome == (S.SETTLING, Motion.HOLD)
    assert bench.kinds == ["aborted"]
    assert "no heartbeat" in bench.machine.end_reason


@each("state", [S.ALIGNING, S.THROWING])
def test_silence_of_more_than_300_ms_before_commit_holds(state):
    bench = at(state)
    bench.wait(0.300)
    bench.tick()
    assert bench.machine.state is state
    bench.wait(1e-9)
    bench.tick()
    assert bench.outcome == (S.SETTLING, Motion.HOLD)
    assert "0.30 s" in bench.machine.end_reason


def test_heartbeats_keep_a_throw_alive():
    bench = at(S.ALIGNING)
    for _ in range(100):
        bench.wait(0.29)
        bench.beat()
        assert bench.machine.state is S.ALIGNING


@each(
    "change",
    [
        {"machine_id": "m002"},
        {"throw_id": "t2"},
        {"epoch_count": 2},
        {"epoch_count": 4},
        {"sequence_count": 1},
        {"sequence_count": 0},
    ],
)
@each("holding", [True, False])
def test_a_heartbeat_of_something_else_or_a_repeated_one_counts_for_nothing(change, holding):
    bench = at(S.ALIGNING)
    before = bench.machine
    bench.wait(0.2)
    bench.beat(is_holding=holding, **change)
    assert bench.machine is before
    bench.wait(0.100000001)
    bench.tick()
    assert bench.machine.state is S.SETTLING


@each("state", [S.ALIGNING, S.THROWING])
def test_letting_go_holds_at_once(state):
    bench = at(state)
    bench.beat(is_holding=False)
    assert bench.outcome == (S.SETTLING, Motion.HOLD)
    assert bench.machine.end_reason == "the operator let go"


def test_letting_go_before_ever_holding_aborts_too():
    bench = Bench()
    bench.arm()
    bench.fire()
    bench.beat(is_holding=False)
    assert bench.outcome == (S.SETTLING, Motion.HOLD)


@each("state", [S.DISARMED, S.ARMED, S.COMMITTED, S.SETTLING, S.STOPPED, S.FAULT])
@each("holding", [True, False])
def test_heartbeats_mean_nothing_in_other_states(state, holding):
    bench = at(state)
    before = bench.machine
    bench.beat(is_holding=holding)
    assert bench.machine is before


def test_after_commit_silence_does_not_stop_the_throw():
    bench = at(S.COMMITTED)
    bench.wait(1.9)
    bench.tick(payload_held=False)
    assert bench.outcome == (S.COMMITTED, Motion.THROW)


def test_the_silence_is_told_in_seconds():
    bench = at(S.ALIGNING)
    bench.wait(0.41)
    bench.tick()
    assert bench.machine.end_reason.startswith("no heartbeat for 0.41 s, 0.30 s are allowed")


def test_events_of_a_throw_carry_its_plan():
    bench = Bench()
    bench.arm()
    bench.disarm()
    assert bench.actions.events[0].plan_id == "plan-1"
    bench = Bench()
    seen = []
    for state in (S.ARMED, S.ALIGNING, S.THROWING, S.COMMITTED):
        bench = at(state)
        seen += bench.actions.events
        bench.beat(is_holding=False)
        seen += bench.actions.events
        bench.stop()
        seen += bench.actions.events
    kinds = {event.kind.value for event in seen}
    assert {"armed", "throw_started", "release_commanded", "aborted", "throw_ended"} <= kinds
    assert {event.plan_id for event in seen} == {"plan-1"}


# The server cannot be reached


@each("state", EVERY)
def test_losing_the_server(state):
    bench = at(state)
    before = bench.machine
    bench.send(LinkLost())
    if state is S.ARMED:
        assert bench.machine.state is S.DISARMED
        assert bench.kinds == ["disarmed"]
    elif state in (S.ALIGNING, S.THROWING):
        assert bench.outcome == (S.SETTLING, Motion.HOLD)
        assert bench.kinds == ["aborted"]
    else:
        assert bench.machine is before
        assert bench.kinds == []


# Facts


@each(
    "facts",
    [{"local_enable": False}, {"abort_reason": "too much swing"}, {"payload_held": False}],
)
@each("state", [S.ALIGNING, S.THROWING])
def test_facts_that_abort_before_commit(state, facts):
    bench = at(state)
    bench.tick(**facts)
    assert bench.outcome == (S.SETTLING, Motion.HOLD)
    assert bench.machine.end_reason
    assert bench.kinds == ["aborted"]


@each("facts", [{"local_enable": False}, {"abort_reason": "x"}])
def test_facts_that_do_not_matter_after_commit(facts):
    bench = at(S.COMMITTED)
    bench.tick(**facts)
    assert bench.machine.state is S.COMMITTED


@each("state", EVERY)
def test_a_fault_stops_what_runs(state):
    bench = at(state)
    before = bench.machine
    bench.tick(fault_reason="a sensor died")
    if state in (S.ALIGNING, S.THROWING, S.COMMITTED, S.SETTLING):
        assert bench.outcome == (S.FAULT, Motion.STOP)
        assert bench.kinds == ["fault", "throw_ended"]
        assert bench.actions.events[1].data["outcome"] == "fault"
        assert bench.actions.events[1].throw_id == "t1"
        assert bench.machine.latched_reason == "a sensor died"
    else:
        assert bench.machine is before


@each("state", EVERY)
def test_the_emergency_stop_latches_from_every_state(state):
    bench = at(state)
    bench.tick(emergency_stop=True)
    assert bench.outcome == (S.STOPPED, Motion.STOP)
    if state is not S.STOPPED:
        assert bench.kinds[0] == "stop_latched"
        assert ("throw_ended" in bench.kinds) is (
            state in (S.ALIGNING, S.THROWING, S.COMMITTED, S.SETTLING)
        )
        assert ("disarmed" in bench.kinds) is (state is S.ARMED)
    bench.tick()
    assert bench.machine.state is S.STOPPED


def test_a_stop_after_the_release_tells_when_it_was():
    bench = at(S.THROWING)
    bench.wait(0.2)
    bench.tick(motion=Motion.THROW, release_commanded=True)
    bench.tick(emergency_stop=True)
    end = bench.actions.events[1].data
    assert (end["outcome"], end["throw_duration_s"]) == ("stopped", pytest.approx(0.2))


# Armed


def test_an_armed_machine_waits_10_s():
    bench = at(S.ARMED)
    bench.wait(10.0)
    bench.tick()
    assert bench.machine.state is S.ARMED
    bench.wait(1e-9)
    bench.tick()
    assert bench.machine.state is S.DISARMED
    assert bench.kinds == ["disarmed"]
    assert (bench.machine.nonce, bench.machine.expired_nonce) == ("", "nonce-1")
    assert bench.machine.armed_issuer == ""


@each("severity, disarms", [("info", False), ("warning", False), ("error", True)])
def test_a_failing_check_disarms_only_as_an_error(severity, disarms):
    bench = at(S.ARMED)
    bench.tick(checks=(failed(severity),))
    assert (bench.machine.state is S.DISARMED) is disarms
    if disarms:
        assert bench.actions.events[0].data == {"reason": "Bad thing."}
        bench.tick()
        assert bench.machine.state is S.DISARMED


def test_a_passing_error_check_keeps_it_armed():
    bench = at(S.ARMED)
    bench.tick(checks=(failed("error").model_copy(update={"passed": True}),))
    assert bench.machine.state is S.ARMED


# Phases


@each("motion", list(Motion))
def test_facts_count_only_from_the_motion_they_belong_to(motion):
    bench = at(S.ALIGNING)
    bench.tick(motion=motion, aligned=True)
    assert (bench.machine.state is S.THROWING) is (motion is Motion.ALIGN)
    bench = at(S.THROWING)
    bench.tick(motion=motion, release_commanded=True)
    assert (bench.machine.state is S.COMMITTED) is (motion is Motion.THROW)
    bench = at(S.COMMITTED)
    bench.tick(motion=motion, throw_done=True, load_gone=True)
    assert (bench.machine.state is S.SETTLING) is (motion is Motion.THROW)
    bench = at(S.SETTLING)
    bench.tick(motion=motion, settled=True)
    assert (bench.machine.state is S.DISARMED) is (motion is Motion.SETTLE)


def test_a_release_flag_left_over_from_the_last_throw_commits_nothing_while_aligning():
    bench = at(S.ALIGNING)
    bench.tick(motion=Motion.THROW, release_commanded=True)
    assert bench.machine.state is S.ALIGNING


def test_aligned_without_a_heartbeat_starts_nothing():
    bench = Bench()
    bench.arm()
    bench.fire()
    bench.wait(1.1)
    bench.tick(motion=Motion.ALIGN, aligned=True)
    assert bench.machine.state is S.SETTLING


def test_the_release_wins_over_silence_in_the_same_tick():
    bench = at(S.THROWING)
    bench.wait(0.5)
    bench.tick(motion=Motion.THROW, release_commanded=True)
    assert bench.machine.state is S.COMMITTED


def test_aligning_takes_no_longer_than_40_s():
    bench = at(S.ALIGNING)
    for _ in range(160):
        bench.wait(0.25)
        bench.beat()
    assert bench.machine.state is S.ALIGNING
    bench.wait(1e-9)
    bench.beat()
    assert bench.machine.state is S.SETTLING
    assert "40 s" in bench.machine.end_reason


def test_a_policy_has_8_s_to_release():
    bench = at(S.THROWING)
    for _ in range(32):
        bench.wait(0.25)
        bench.beat()
    assert bench.machine.state is S.THROWING
    bench.wait(1e-9)
    bench.beat()
    assert bench.machine.state is S.SETTLING
    assert "8 s" in bench.machine.end_reason


def test_throwing_may_begin_late_in_aligning():
    bench = at(S.ALIGNING)
    for _ in range(40):
        bench.wait(0.25)
        bench.beat()
    bench.tick(motion=Motion.ALIGN, aligned=True)
    bench.tick()
    assert bench.machine.state is S.THROWING


def test_an_abort_holds_for_1_5_s_and_ends_the_throw():
    bench = at(S.THROWING)
    bench.beat(is_holding=False)
    assert bench.actions.events[0].data == {"reason": "the operator let go"}
    bench.wait(1.5)
    bench.tick(motion=Motion.SETTLE, settled=True)
    assert bench.outcome == (S.SETTLING, Motion.HOLD)
    bench.wait(1e-9)
    bench.tick()
    assert bench.machine.state is S.DISARMED
    (event,) = bench.actions.events
    assert event.data["outcome"] == "aborted"
    assert event.data["detail"] == "the operator let go"
    assert event.data["throw_duration_s"] is None


@each(
    ("facts", "wait_s", "is_own"),
    [
        ({"abort_reason": "swung", "abort_is_policys_own": True}, 0.0, True),
        ({"abort_reason": "no IMU"}, 0.0, False),
        ({"payload_held": False}, 0.0, False),
        ({}, 0.5, False),
    ],
)
def test_an_abort_says_whether_the_policy_is_its_reason(facts, wait_s, is_own):
    bench = at(S.THROWING)
    bench.wait(wait_s)
    bench.tick(**facts)
    bench.wait(1.6)
    bench.tick()
    (event,) = bench.actions.events
    assert event.data["outcome"] == "aborted"
    assert event.data["is_policys_own"] is is_own
    assert not bench.machine.end_is_policys_own, "of that throw alone"


def test_a_gripper_that_does_not_let_go_is_a_fault_once_the_machine_stands():
    bench = at(S.COMMITTED)
    bench.tick(motion=Motion.THROW, throw_done=True, load_gone=False)
    assert bench.outcome == (S.SETTLING, Motion.SETTLE)
    bench.tick(motion=Motion.SETTLE, settled=True)
    assert bench.outcome == (S.FAULT, Motion.STOP)
    assert bench.kinds == ["fault", "throw_ended"]
    assert "gripper" in bench.machine.latched_reason


def test_a_control_step_that_never_ends_the_throw_is_a_fault():
    bench = at(S.COMMITTED)
    bench.wait(2.0)
    bench.tick()
    assert bench.machine.state is S.COMMITTED
    bench.wait(1e-9)
    bench.tick()
    assert bench.machine.state is S.SETTLING
    bench.tick(motion=Motion.SETTLE, settled=True)
    assert bench.machine.state is S.FAULT


def test_settling_ends_where_nothing_can_be_damped():
    bench = at(S.COMMITTED)
    bench.tick(motion=Motion.THROW, throw_done=True, load_gone=True, abort_reason="no IMU")
    # Said of the throw that has ended.
    bench.tick(motion=Motion.THROW, abort_reason="no IMU")
    assert bench.outcome == (S.SETTLING, Motion.SETTLE)
    bench.tick(motion=Motion.SETTLE, abort_reason="no IMU")
    assert bench.outcome == (S.DISARMED, Motion.HOLD)
    (event,) = bench.actions.events
    assert event.data["outcome"] == "landed"


def test_settling_ends_by_itself_after_45_s_or_with_the_switch():
    bench = at(S.SETTLING)
    bench.wait(45.0)
    bench.tick(motion=Motion.SETTLE)
    assert bench.machine.state is S.SETTLING
    bench.wait(1e-9)
    bench.tick(motion=Motion.SETTLE)
    assert bench.machine.state is S.DISARMED
    assert bench.actions.events[0].data["outcome"] == "landed"
    bench = at(S.SETTLING)
    bench.tick(motion=Motion.SETTLE, local_enable=False)
    assert bench.machine.state is S.DISARMED
