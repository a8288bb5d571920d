"""STOP and FAULT last until somebody who sees the machine clears the very latch that is set."""

from machine.messages import RejectReason, ThrowState
from runtime.throw.protocol import Latch
from runtime.throw.transitions import take_latch
from tests.runtime.protocol_bench import Bench

S = ThrowState


def test_a_delayed_clear_never_undoes_a_later_stop():
    bench = Bench(boot_id="b")
    bench.stop(command_id="s1")
    first = bench.machine.latch_id
    clear = {"latch_id": first}
    bench.clear(command_id="k1", **clear)
    assert bench.machine.state is S.DISARMED
    bench.stop(command_id="s2")
    bench.arm()
    bench.clear(command_id="k2", **clear)
    assert bench.reply.reason is RejectReason.STOP_LATCHED
    assert first in bench.reply.detail and bench.machine.latch_id in bench.reply.detail
    assert bench.machine.state is S.STOPPED


def test_a_stop_while_stopped_is_a_latch_of_its_own():
    bench = Bench(boot_id="b")
    bench.stop()
    first = bench.machine.latch_id
    bench.stop(issuer="somebody else")
    assert bench.kinds == ["stop_latched"]
    assert bench.actions.events[0].data["latch_id"] == bench.machine.latch_id != first
    bench.clear(latch_id=first)
    assert bench.machine.state is S.STOPPED


def test_the_switch_pressed_while_stopped_is_a_latch_of_its_own():
    bench = Bench(boot_id="b")
    bench.stop()
    first = bench.machine.latch_id
    bench.tick(emergency_stop=True)
    assert bench.kinds == ["stop_latched"]
    second = bench.machine.latch_id
    bench.tick(emergency_stop=True)
    assert bench.kinds == [] and bench.machine.latch_id == second != first
    bench.tick()
    bench.clear(latch_id=first)
    assert bench.machine.state is S.STOPPED
    bench.clear(latch_id=second)
    assert bench.machine.state is S.DISARMED
    bench.tick(emergency_stop=True)
    assert bench.machine.state is S.STOPPED


def test_latch_ids_are_never_used_again():
    bench = Bench(boot_id="b")
    seen = []
    for _ in range(5):
        bench.stop()
        seen.append(bench.machine.latch_id)
        bench.clear()
    assert len(set(seen)) == 5 and all(latch_id.startswith("b.") for latch_id in seen)
    assert bench.machine.latch_id == ""


def test_a_repeated_stop_is_answered_with_what_is_true_now():
    bench = Bench()
    first = bench.stop(command_id="s").reply
    assert (first.state, first.latch_id, first.is_repeat) == (
        S.STOPPED,
        bench.machine.latch_id,
        False,
    )
    again = bench.stop(command_id="s").reply
    assert (again.state, again.is_repeat, again.detail) == (S.STOPPED, True, "")
    bench.clear()
    late = bench.stop(command_id="s").reply
    assert (late.accepted, late.is_repeat) == (True, True)
    assert (late.state, late.latch_id) == (S.DISARMED, "")
    assert "cleared since" in late.detail
    assert bench.machine.state is S.DISARMED


def test_a_clear_states_who_sees_the_machine_and_why():
    for state in (S.STOPPED, S.FAULT):
        bench = Bench()
        bench.go_to(state)
        for missing in (
            {"sighted_by": None},
            {"reason": None},
            {"sighted_by": "  "},
            {"reason": ""},
        ):
            bench.clear(**missing)
            assert bench.reply.reason is RejectReason.CHECK_FAILED, missing
            assert "who sees the machine" in bench.reply.detail
        bench.clear(latch_id=None)
        assert "no latch" in bench.reply.detail
        assert bench.machine.state is state
        latch_id = bench.machine.latch_id
        bench.clear()
        assert bench.actions.events[0].data == {
            "issuer": "anna",
            "was": state.value,
            "latch_id": latch_id,
            "sighted_by": "olga",
            "reason": "all clear",
        }


def test_what_an_earlier_process_left_is_taken_over():
    bench = Bench()
    for state in (S.STOPPED, S.FAULT):
        machine = take_latch(bench.machine, Latch("old.3", state, "a hose burst"), 5)
        assert (machine.state, machine.latch_id, machine.latched_reason) == (
            state,
            "old.3",
            "a hose burst",
        )
    assert take_latch(machine, None, 6).state is S.DISARMED
    assert take_latch(machine, None, 6).latch_id == ""
