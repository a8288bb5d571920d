"""The machine's time at the server: never later than the truth, and near it however messages are delayed."""

from hypothesis import given
from hypothesis import strategies as st

from server.machines.machine_clock import AHEAD_MAX_NS, MachineClock

MS = 1_000_000
PERIOD_NS = 50 * MS
LEAD_NS = 7_000_000_000
"""The machine's clock ahead of the server's."""


@given(st.lists(st.integers(0, 400), min_size=1, max_size=60), st.integers(0, 2000))
def test_it_is_never_later_than_the_truth(delays_ms: list[int], later_ms: int) -> None:
    clock = None
    server_ns = 0
    for i, delay_ms in enumerate(delays_ms):
        sent_ns = i * PERIOD_NS
        server_ns = max(server_ns, sent_ns + delay_ms * MS)
        stamp_ns = LEAD_NS + sent_ns
        if clock is None:
            clock = MachineClock.first(stamp_ns, server_ns)
        clock.take(stamp_ns, server_ns)
    assert clock is not None
    asked_ns = server_ns + later_ms * MS
    found_ns = clock.now_ns(asked_ns)
    assert clock.seen_ns <= found_ns <= LEAD_NS + asked_ns
    assert found_ns <= clock.seen_ns + AHEAD_MAX_NS


def test_a_late_message_does_not_set_it_back() -> None:
    clock = MachineClock.first(LEAD_NS, 2 * MS)
    clock.take(LEAD_NS + PERIOD_NS, PERIOD_NS + 80 * MS)
    at_ns = PERIOD_NS + 90 * MS
    assert clock.now_ns(at_ns) == LEAD_NS + at_ns - 2 * MS


def test_a_silent_machine_is_not_carried_on() -> None:
    clock = MachineClock.first(LEAD_NS, 0)
    assert clock.now_ns(10 * AHEAD_MAX_NS) == LEAD_NS + AHEAD_MAX_NS
