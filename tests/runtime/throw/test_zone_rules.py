"""Exclusion zones in the throw protocol: when a set is taken, and which plans are refused for it."""

from machine.messages import RejectReason, ThrowState
from machine.site.zones import ZoneSet
from runtime.throw.protocol import RUNNING
from tests.cases import each
from tests.machine.site.test_zones import zone
from tests.runtime.protocol_bench import SECOND_NS, Bench, plan

OFFICE = ZoneSet(version_count=4, approved_by="sue", zones=(zone(),))
NONE = ZoneSet(version_count=5)


def at(state: ThrowState) -> Bench:
    bench = Bench()
    bench.go_to(state)
    return bench


@each("state", [state for state in ThrowState if state not in RUNNING])
def test_a_set_is_taken_without_a_lease_while_no_throw_runs(state):
    bench = at(state)
    actions = bench.zones(OFFICE, issuer="server")
    assert (actions.reply.accepted, actions.zones) == (True, OFFICE)
    disarmed = state is ThrowState.ARMED
    assert bench.machine.state is (ThrowState.DISARMED if disarmed else state)
    assert bench.kinds == (["disarmed"] if disarmed else [])


@each("state", sorted(RUNNING))
def test_a_throw_keeps_the_set_it_was_armed_with(state):
    bench = at(state)
    actions = bench.zones(OFFICE)
    assert (actions.reply.reason, actions.zones) == (RejectReason.BUSY, None)
    assert bench.machine.state is state


def test_the_same_set_does_not_disarm():
    bench = Bench()
    bench.go_to(ThrowState.ARMED)
    assert bench.zones(NONE).reply.accepted
    assert bench.machine.state is ThrowState.ARMED


def test_a_set_that_was_long_on_its_way_is_not_taken():
    bench = Bench()
    for seen_ns, words in ((bench.now_ns - SECOND_NS, "on its way"), (None, "does not say")):
        actions = bench.zones(OFFICE, seen_t_mono_ns=seen_ns)
        assert (actions.reply.reason, actions.zones) == (RejectReason.COMMAND_STALE, None)
        assert words in actions.reply.detail
    assert not bench.zones(OFFICE, machine_id="m002").reply.accepted


@each(
    ("planned", "aboard", "words"),
    [
        (None, OFFICE.sha256, f"zones none, this machine has {OFFICE.sha256[:12]}"),
        (OFFICE.sha256, "", f"zones {OFFICE.sha256[:12]}, this machine has none"),
        (OFFICE.sha256, "b" * 64, "this machine has bbbbbbbbbbbb"),
        (None, None, "cannot be read"),
        (OFFICE.sha256, None, "cannot be read"),
    ],
)
def test_a_plan_of_other_zones_is_refused(planned, aboard, words):
    bench = Bench()
    actions = bench.arm(plan(zones_sha256=planned), {"zones_sha256": aboard})
    assert actions.reply.reason is RejectReason.ZONES_MISMATCH
    assert words in actions.reply.detail
    assert bench.machine.state is ThrowState.DISARMED


def test_a_plan_into_a_zone_is_refused_with_the_machine_s_own_words():
    bench = Bench()
    facts = {"zones_sha256": OFFICE.sha256, "zone_conflict": lambda given: f"no: {given.plan_id}"}
    given = plan(zones_sha256=OFFICE.sha256)
    actions = bench.arm(given, facts)
    assert actions.reply.reason is RejectReason.TARGET_IN_ZONE
    assert actions.reply.detail == "no: plan-1"
    assert bench.arm(given, {**facts, "zone_conflict": lambda _: ""}).reply.accepted


def test_plans_without_zones_have_the_hash_that_they_had():
    named = plan(zones_sha256=OFFICE.sha256)
    assert plan().plan_hash != named.plan_hash
    assert "zones_sha256" not in plan().model_dump_json(exclude_none=True)
