"""Old commands are recognised by the machine's own clock."""

from machine.messages import FireRequest, OperatorHeartbeat
from runtime.throw.freshness import FIRE_AGE_MAX_NS, HEARTBEAT_AGE_MAX_NS, why_stale
from tests.cases import each

NOW_NS = 7_000_000_000


def fire(seen_ns: int | None) -> FireRequest:
    return FireRequest(
        command_id="c",
        machine_id="m001",
        issuer="op",
        throw_id="t",
        epoch_count=1,
        nonce="n",
        plan_hash="h",
        seen_t_mono_ns=seen_ns,
    )


def beat(seen_ns: int | None) -> OperatorHeartbeat:
    return OperatorHeartbeat(
        machine_id="m001",
        throw_id="t",
        epoch_count=1,
        sequence_count=1,
        is_holding=True,
        seen_t_mono_ns=seen_ns,
    )


@each(("make", "limit_ns"), [(fire, FIRE_AGE_MAX_NS), (beat, HEARTBEAT_AGE_MAX_NS)])
def test_age_limit_is_exact_and_the_future_is_another_boot(make, limit_ns):
    assert why_stale(make(NOW_NS), NOW_NS) == ""
    assert why_stale(make(NOW_NS - limit_ns), NOW_NS) == ""
    assert "on its way" in why_stale(make(NOW_NS - limit_ns - 1), NOW_NS)
    assert "restart" in why_stale(make(NOW_NS + 1), NOW_NS)


def test_a_message_without_an_echo_counts_as_stale():
    assert "Update the sender" in why_stale(fire(None), NOW_NS)
    assert "Update the sender" in why_stale(beat(None), NOW_NS)
