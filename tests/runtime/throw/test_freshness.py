"""Old commands are recognised by the machine's own clock."""

from machine.messages import (
    AbortRequest,
    ArmRequest,
    DisarmRequest,
    FireRequest,
    LeaseNotice,
    LoadRequest,
    OperatorHeartbeat,
    StopClearRequest,
    StopRequest,
    ZonesRequest,
)
from machine.site.zones import ZoneSet
from runtime.throw.freshness import COMMAND_AGE_MAX_NS, HEARTBEAT_AGE_MAX_NS, why_stale
from tests.runtime.protocol_bench import Bench, plan

NOW_NS = 7_000_000_000
FIELDS = {
    ArmRequest: {"plan": plan()},
    FireRequest: {"throw_id": "t", "nonce": "n", "plan_hash": "h"},
    LoadRequest: {},
    StopClearRequest: {},
    ZonesRequest: {"zone_set": ZoneSet(version_count=1)},
    LeaseNotice: {},
    AbortRequest: {},
    DisarmRequest: {},
}


def command(kind, seen_ns):
    head = {"command_id": "c", "machine_id": "m001", "issuer": "op"}
    if "epoch_count" in kind.model_fields:
        head["epoch_count"] = 1
    return kind(**head, seen_t_mono_ns=seen_ns, **FIELDS[kind])


def beat(seen_ns: int | None) -> OperatorHeartbeat:
    return OperatorHeartbeat(
        machine_id="m001",
        throw_id="t",
        epoch_count=1,
        sequence_count=1,
        is_holding=True,
        seen_t_mono_ns=seen_ns,
    )


def test_age_limits_are_exact_and_the_future_is_another_boot():
    messages = [
        (lambda seen, k=kind: command(k, seen), ns) for kind, ns in COMMAND_AGE_MAX_NS.items()
    ]
    for make, limit_ns in [*messages, (beat, HEARTBEAT_AGE_MAX_NS)]:
        assert why_stale(make(NOW_NS), NOW_NS) == ""
        assert why_stale(make(NOW_NS - limit_ns), NOW_NS) == ""
        assert "0.01 s longer on its way" in why_stale(make(NOW_NS - limit_ns - 1), NOW_NS)
        assert "restart" in why_stale(make(NOW_NS + 1), NOW_NS)
        assert "Update the sender" in why_stale(make(None), NOW_NS)


def test_whatever_may_start_or_permit_motion_has_a_limit_of_at_most_half_a_second():
    limited = {FireRequest, ArmRequest, LoadRequest, StopClearRequest, ZonesRequest}
    assert set(COMMAND_AGE_MAX_NS) == limited
    assert max(COMMAND_AGE_MAX_NS.values()) <= 500_000_000
    assert HEARTBEAT_AGE_MAX_NS == 300_000_000


def test_what_only_takes_permission_away_has_none():
    for kind in (LeaseNotice, AbortRequest, DisarmRequest):
        assert why_stale(command(kind, None), NOW_NS) == ""
        assert why_stale(command(kind, 1), NOW_NS) == ""
    stop = StopRequest(command_id="c", machine_id="m001", issuer="op")
    assert why_stale(stop, NOW_NS) == ""


def test_no_old_command_is_executed():
    for verb, prepare in (
        ("load", ()),
        ("arm", ()),
        ("fire", ("arm",)),
        ("clear", ("stop",)),
    ):
        bench = Bench()
        for step in prepare:
            getattr(bench, step)()
        before = bench.machine
        sent_ns = bench.now_ns
        bench.wait(0.500000001)
        getattr(bench, verb)(seen_t_mono_ns=sent_ns)
        assert (bench.reply.accepted, bench.reply.reason) == (False, "command_stale"), verb
        assert bench.machine.state is before.state, verb
        assert not bench.actions.load
        getattr(bench, verb)(seen_t_mono_ns=bench.now_ns - 500_000_000, throw_id="t9") if (
            verb == "fire"
        ) else getattr(bench, verb)(seen_t_mono_ns=bench.now_ns - 500_000_000)
        assert bench.reply.accepted, verb


def test_a_throw_holds_300_ms_after_the_last_heartbeat_was_sent_however_long_it_travelled():
    bench = Bench()
    bench.arm()
    bench.fire()
    bench.beat()
    for _ in range(40):
        bench.wait(0.05)
        bench.beat(seen_t_mono_ns=bench.now_ns - 200_000_000)
    assert bench.machine.state == "aligning"
    bench.wait(0.1)
    bench.tick()
    assert bench.machine.state == "aligning"
    bench.wait(1e-9)
    bench.tick()
    assert bench.machine.state == "settling"


def test_heartbeats_held_up_for_more_than_300_ms_count_for_nothing():
    bench = Bench()
    bench.arm()
    bench.fire()
    bench.beat()
    sent_ns = bench.now_ns
    bench.wait(0.3)
    bench.beat(seen_t_mono_ns=sent_ns - 1)
    bench.wait(1e-9)
    bench.tick()
    assert bench.machine.state == "settling"


def test_an_older_heartbeat_does_not_turn_the_clock_back():
    bench = Bench()
    bench.arm()
    bench.fire()
    bench.wait(0.2)
    bench.beat()
    newest_ns = bench.machine.heartbeat_ns
    bench.beat(seen_t_mono_ns=bench.now_ns - 100_000_000)
    assert bench.machine.heartbeat_ns == newest_ns
    bench.beat(is_holding=False, seen_t_mono_ns=None)
    assert bench.machine.end_reason == "the operator let go"
