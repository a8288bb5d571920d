"""Every command in every state, every reason to refuse, and what repeats do."""

from dataclasses import replace

from machine.conventions import Mode, Motion
from machine.messages import CheckResult, RejectReason, Target, ThrowState
from machine.site.thrown_material import ThrownMaterial
from runtime.throw.protocol import REPLY_MEMORY_COUNT
from tests.cases import each
from tests.runtime.protocol_bench import Bench, card, plan

S, R = ThrowState, RejectReason
EVERY = list(ThrowState)
PRE = (S.ALIGNING, S.THROWING)


def at(state: ThrowState) -> Bench:
    bench = Bench()
    bench.go_to(state)
    return bench


def refused(bench: Bench, reason: RejectReason) -> str:
    assert bench.reply.accepted is False
    assert bench.reply.reason is reason
    assert bench.reply.detail
    assert bench.kinds[-1] == "command_refused"
    assert bench.actions.events[-1].data["reason"] == reason.value
    return bench.reply.detail


ERROR = CheckResult(
    check_id="p", passed=False, severity="error", text="Pressure 14.2 MPa.", remedy="Wait."
)

GRAB_760_KG = ThrownMaterial(
    name="gravel", volume_m3=0.5, mass_kg=760.0, grain_diameter_m=0.016, grain_spread_ratio=0.4,
    grain_density_kg_per_m3=2650.0, drag_coefficient_ratio=1.0,
)  # fmt: skip

# Addresses, epochs, leases


@each("verb", ["lease", "arm", "fire", "abort", "disarm", "stop", "clear", "load"])
def test_a_command_for_another_machine_does_nothing(verb):
    bench = at(S.ALIGNING)
    before = bench.machine
    getattr(bench, verb)(machine_id="m002")
    refused(bench, R.WRONG_MACHINE)
    assert bench.machine is before
    assert bench.reply.machine_id == "m001"


@each("state", EVERY)
@each("verb", ["lease", "arm", "fire", "abort", "disarm", "clear", "load"])
def test_a_stale_epoch_never_acts(state, verb):
    bench = at(state)
    before = bench.machine
    getattr(bench, verb)(epoch_count=2)
    detail = refused(bench, R.STALE_EPOCH)
    assert "2" in detail and "3" in detail
    assert replace(bench.machine, replies=before.replies) == before


@each("state", EVERY)
@each("verb", ["arm", "fire", "abort", "disarm", "clear", "load"])
def test_an_epoch_without_a_lease_is_refused_and_holds_what_runs(state, verb):
    bench = at(state)
    getattr(bench, verb)(epoch_count=4)
    refused(bench, R.NO_LEASE)
    assert bench.machine.epoch_count == 3
    if state is S.ARMED:
        assert bench.machine.state is S.DISARMED
        assert bench.kinds == ["disarmed", "command_refused"]
    elif state in PRE:
        assert bench.outcome == (S.SETTLING, Motion.HOLD)
        assert bench.kinds == ["aborted", "command_refused"]
    else:
        assert bench.machine.state is state


@each("verb", ["arm", "load", "clear"])
def test_a_machine_that_never_had_a_lease_accepts_nothing(verb):
    bench = Bench(epoch=0)
    getattr(bench, verb)()
    refused(bench, R.NO_LEASE)


def test_the_first_lease():
    bench = Bench(epoch=0)
    bench.lease(epoch_count=1, issuer="bert")
    assert bench.reply.accepted
    assert (bench.machine.epoch_count, bench.machine.lease_issuer) == (1, "bert")
    assert bench.reply.epoch_count == 1


@each("state", EVERY)
def test_a_higher_lease_takes_over(state):
    bench = at(state)
    bench.lease(epoch_count=7, issuer="bert")
    assert bench.reply.accepted
    assert (bench.machine.epoch_count, bench.machine.lease_issuer) == (7, "bert")
    expected = S.DISARMED if state is S.ARMED else S.SETTLING if state in PRE else state
    assert bench.machine.state is expected
    assert bench.kinds == {S.ARMED: ["disarmed"], **{pre: ["aborted"] for pre in PRE}}.get(
        state, []
    )


@each("state", EVERY)
def test_the_same_lease_again_is_harmless(state):
    bench = at(state)
    bench.lease()
    assert bench.reply.accepted
    assert bench.machine.state is state


def test_a_restarted_machine_learns_who_holds_its_epoch():
    bench = Bench()
    bench.machine = replace(bench.machine, lease_issuer="")
    bench.lease(issuer="bert")
    assert bench.reply.accepted
    assert bench.machine.lease_issuer == "bert"


@each("state", EVERY)
def test_two_holders_of_one_epoch_hold_the_machine(state):
    bench = at(state)
    bench.lease(issuer="bert")
    refused(bench, R.LEASE_HELD)
    assert bench.machine.lease_issuer == "anna"
    expected = S.DISARMED if state is S.ARMED else S.SETTLING if state in PRE else state
    assert bench.machine.state is expected


@each("verb", ["arm", "fire"])
def test_a_second_commander_of_an_armed_machine_disarms_it(verb):
    bench = at(S.ARMED)
    getattr(bench, verb)(issuer="bert")
    detail = refused(bench, R.LEASE_HELD)
    assert "anna" in detail and "bert" in detail
    assert bench.machine.state is S.DISARMED


@each("state", PRE)
def test_a_second_fire_by_somebody_else_aborts_the_throw(state):
    bench = at(state)
    bench.fire(issuer="bert", throw_id="t2")
    refused(bench, R.LEASE_HELD)
    assert bench.machine.state is S.SETTLING


# Arm


@each("state", EVERY)
def test_arm_in_every_state(state):
    bench = at(state)
    before = bench.machine.state
    bench.arm()
    if state is S.DISARMED:
        assert bench.reply.accepted
        assert bench.reply.state is S.ARMED
        return
    expected = {S.STOPPED: R.STOP_LATCHED, S.FAULT: R.FAULT}.get(state, R.NOT_DISARMED)
    refused(bench, expected)
    assert bench.machine.state is before
    assert bench.reply.nonce is None and bench.reply.nonce_valid_s is None


@each(
    "change, reason",
    [
        ({"machine_id": "m002"}, R.WRONG_MACHINE),
        ({"model_sha256": "c" * 64}, R.MODEL_MISMATCH),
        ({"mode": Mode.SPATIAL}, R.POLICY_UNUSABLE),
        ({"policy_sha256": "c" * 64}, R.POLICY_MISMATCH),
        ({"target": Target(x_m=5.4, y_m=0.0)}, R.TARGET_TOO_NEAR),
        ({"target": Target(x_m=11.0, y_m=0.0)}, R.TARGET_OUT_OF_REACH),
        ({"target": Target(x_m=8.0, y_m=0.0, z_m=0.5)}, R.TARGET_OUT_OF_REACH),
        (
            {"target": Target(x_m=10.0, y_m=0.0), "material": GRAB_760_KG},
            R.TARGET_OUT_OF_REACH,
        ),
    ],
)
def test_plans_that_do_not_fit_this_machine(change, reason):
    bench = Bench()
    bench.arm(plan(**change))
    refused(bench, reason)
    assert bench.machine.state is S.DISARMED
    assert bench.machine.plan is None and bench.machine.nonce == ""


def test_each_mode_has_its_own_policy():
    bench = Bench()
    cards = {Mode.PLANAR: card(), Mode.SPATIAL: card(Mode.SPATIAL, "d" * 64)}
    bench.facts = replace(bench.facts, cards=cards)
    bench.arm(plan(mode=Mode.SPATIAL, policy_sha256="d" * 64))
    assert bench.reply.accepted


@each("verb, state", [("arm", S.DISARMED), ("fire", S.ARMED)])
def test_arm_and_fire_need_a_load(verb, state):
    bench = at(state)
    getattr(bench, verb)(facts={"payload_held": False})
    refused(bench, R.NO_PAYLOAD)
    assert bench.machine.state is state


def test_arm_needs_every_check():
    bench = Bench()
    bench.arm(facts={"checks": (ERROR,)})
    assert refused(bench, R.CHECK_FAILED) == "Pressure 14.2 MPa. Wait."
    bench.arm(facts={"checks": (ERROR.model_copy(update={"severity": "warning"}),)})
    assert bench.reply.accepted


def test_a_check_that_passes_forbids_nothing():
    bench = Bench()
    bench.arm(facts={"checks": (ERROR.model_copy(update={"passed": True}),)})
    assert bench.reply.accepted


def test_a_check_that_fails_at_fire_has_disarmed_already():
    bench = at(S.ARMED)
    bench.fire(facts={"checks": (ERROR,)})
    refused(bench, R.NOT_ARMED)
    assert bench.machine.state is S.DISARMED


# Fire


@each("state", [s for s in EVERY if s is not S.ARMED])
def test_fire_in_every_other_state(state):
    bench = at(state)
    bench.fire(throw_id="t2")
    refused(bench, {S.STOPPED: R.STOP_LATCHED, S.FAULT: R.FAULT}.get(state, R.NOT_ARMED))
    assert bench.machine.state is state


@each("nonce", ["", "nonce-2", "nonce-1 "])
def test_fire_with_another_nonce(nonce):
    bench = at(S.ARMED)
    bench.fire(nonce=nonce)
    refused(bench, R.NONCE_UNKNOWN)
    assert bench.machine.state is S.ARMED


def test_fire_after_ten_seconds():
    bench = at(S.ARMED)
    bench.wait(10.0)
    assert at(S.ARMED).fire().reply.accepted
    bench.wait(1e-9)
    bench.fire(nonce="nonce-1")
    refused(bench, R.NONCE_EXPIRED)
    assert bench.machine.state is S.DISARMED
    bench.facts = replace(bench.facts, fresh_nonce="nonce-2")
    bench.arm()
    bench.fire(nonce="nonce-1", throw_id="t2")
    refused(bench, R.NONCE_EXPIRED)
    assert bench.machine.state is S.ARMED


def test_fire_at_exactly_ten_seconds():
    bench = at(S.ARMED)
    bench.wait(10.0)
    bench.fire()
    assert bench.reply.accepted


def test_a_nonce_works_once():
    bench = at(S.ARMED)
    bench.fire()
    bench.abort()
    bench.wait(2.0)
    bench.tick()
    assert bench.machine.state is S.DISARMED
    bench.facts = replace(bench.facts, fresh_nonce="nonce-2")
    bench.arm()
    bench.fire(nonce="nonce-1", throw_id="t2")
    refused(bench, R.NONCE_UNKNOWN)


def test_fire_with_another_plan():
    bench = at(S.ARMED)
    bench.fire(plan_hash=plan(target=Target(x_m=8.6, y_m=0.0)).plan_hash)
    refused(bench, R.PLAN_MISMATCH)
    assert bench.machine.state is S.ARMED


def test_an_accepted_fire_names_throw_and_plan():
    bench = at(S.ARMED)
    bench.fire()
    (event,) = bench.actions.events
    assert (event.kind.value, event.throw_id, event.plan_id) == ("throw_accepted", "t1", "plan-1")
    assert event.data == {"issuer": "anna", "epoch_count": 3}


# Repeats


def test_a_repeated_command_is_answered_and_not_executed():
    bench = Bench()
    first = bench.arm(command_id="same").reply
    bench.disarm()
    again = bench.arm(command_id="same").reply
    assert bench.machine.state is S.DISARMED
    assert again == first.model_copy(update={"is_repeat": True})
    assert bench.actions.events == ()


def test_a_repeated_throw_id_gets_the_first_answer_under_its_own_command_id():
    bench = at(S.ARMED)
    first = bench.fire().reply
    again = bench.fire(command_id="retry").reply
    assert again == first.model_copy(update={"command_id": "retry", "is_repeat": True})
    assert bench.machine.state is S.ALIGNING


def test_a_throw_id_never_runs_twice():
    bench = Bench()
    bench.go_to(S.SETTLING)
    bench.tick(motion=Motion.SETTLE, settled=True)
    bench.facts = replace(bench.facts, fresh_nonce="nonce-2")
    bench.arm()
    bench.fire()
    assert bench.reply.is_repeat and bench.reply.accepted
    assert bench.machine.state is S.ARMED


def test_a_refused_throw_id_stays_refused():
    bench = at(S.ARMED)
    bench.fire(nonce="wrong")
    bench.fire()
    assert bench.reply.is_repeat and not bench.reply.accepted
    assert bench.machine.state is S.ARMED


def test_a_stale_fire_does_not_use_up_the_throw_id():
    bench = at(S.ARMED)
    bench.fire(epoch_count=2)
    bench.fire()
    assert bench.reply.accepted and not bench.reply.is_repeat


def test_commands_for_other_machines_do_not_use_up_ids():
    bench = Bench()
    bench.load(machine_id="m002", command_id="same")
    bench.load(command_id="same")
    assert bench.reply.accepted and not bench.reply.is_repeat


def test_the_memory_of_answers_is_bounded_and_keeps_the_newest():
    bench = Bench()
    bench.lease(command_id="old")
    for _ in range(REPLY_MEMORY_COUNT - 1):
        bench.lease()
    assert bench.lease(command_id="old").reply.is_repeat
    bench.lease(command_id="new")
    assert len(bench.machine.replies) == REPLY_MEMORY_COUNT
    assert bench.lease(command_id="new").reply.is_repeat
    assert not bench.lease(command_id="old").reply.is_repeat


# Stop and clear


@each("state", EVERY)
def test_anybody_stops_from_every_state(state):
    bench = at(state)
    bench.stop(issuer="a viewer")
    assert bench.reply.accepted
    assert bench.outcome == (S.STOPPED, Motion.STOP)
    if state is not S.STOPPED:
        assert bench.kinds[0] == "stop_latched"
        assert bench.machine.latched_reason == "STOP by a viewer"
    if state in (*PRE, S.COMMITTED, S.SETTLING):
        assert bench.actions.events[1].data["outcome"] == "stopped"


@each("state", EVERY)
def test_clear_in_every_state(state):
    bench = at(state)
    bench.clear()
    assert bench.reply.accepted
    latched = state in (S.STOPPED, S.FAULT)
    assert bench.machine.state is (S.DISARMED if latched else state)
    assert bench.kinds == (["stop_cleared"] if latched else [])
    if latched:
        assert bench.machine.latched_reason == ""
        assert bench.actions.events[0].data["was"] == state.value


def test_clear_needs_the_cause_to_be_gone():
    bench = at(S.STOPPED)
    bench.clear(facts={"emergency_stop": True})
    refused(bench, R.CHECK_FAILED)
    assert bench.machine.state is S.STOPPED
    bench = at(S.FAULT)
    bench.clear(facts={"fault_reason": "a hose burst"})
    assert "a hose burst" in refused(bench, R.FAULT)
    assert bench.machine.state is S.FAULT


def test_after_a_clear_everything_starts_with_arm():
    bench = at(S.ARMED)
    bench.stop()
    bench.clear()
    bench.fire(nonce="nonce-1")
    refused(bench, R.NOT_ARMED)


# Abort, disarm, load


@each("state", EVERY)
def test_abort_in_every_state(state):
    bench = at(state)
    bench.abort()
    if state is S.COMMITTED:
        refused(bench, R.BUSY)
        assert bench.machine.state is S.COMMITTED
        return
    assert bench.reply.accepted
    expected = S.DISARMED if state is S.ARMED else S.SETTLING if state in PRE else state
    assert bench.machine.state is expected
    if state in PRE:
        assert bench.machine.end_reason == "aborted by anna"


@each("state", EVERY)
def test_disarm_in_every_state(state):
    bench = at(state)
    bench.disarm()
    if state in (*PRE, S.COMMITTED, S.SETTLING):
        refused(bench, R.BUSY)
        assert bench.machine.state is state
        return
    assert bench.reply.accepted
    assert bench.machine.state is (S.DISARMED if state is S.ARMED else state)
    assert bench.kinds == (["disarmed"] if state is S.ARMED else [])


@each("state", EVERY)
@each("held", [True, False])
def test_load_in_every_state(state, held):
    bench = at(state)
    running = state in (*PRE, S.ARMED)
    bench.load(facts={"payload_held": held})
    if state is S.DISARMED:
        assert bench.reply.accepted
        assert bench.actions.load is not held
        return
    assert bench.actions.load is False
    if not (running and not held and state is not S.ARMED):
        refused(bench, {S.STOPPED: R.STOP_LATCHED, S.FAULT: R.FAULT}.get(state, R.NOT_DISARMED))
