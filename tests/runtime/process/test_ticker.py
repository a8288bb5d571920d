"""Beats of the loop: absolute, never bunched, missed ones counted."""

import ast
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from runtime.process.ticker import LATE_TICK_NS, Lateness, RealTimeClock, Ticker, UnpacedClock

PERIOD_NS = 10_000_000


class StallingClock:
    """Time passes only by waiting and by the stalls a test asks for."""

    def __init__(self) -> None:
        self.time_ns = 123
        self.stall_in_wait_ns = 0
        self.suspended_ns = 0

    def now_ns(self) -> int:
        return self.time_ns

    def wait_until(self, due_ns: int) -> None:
        self.time_ns = max(self.time_ns, due_ns) + self.stall_in_wait_ns

    def slept_ns(self) -> int:
        return self.suspended_ns


STALLS = st.lists(st.tuples(st.integers(0, 80_000_000), st.integers(0, 80_000_000)), max_size=100)


@given(STALLS)
def test_beats_stay_on_the_grid_and_none_is_made_up_for(stalls_ns):
    clock = StallingClock()
    ticker = Ticker(clock, PERIOD_NS)
    last = 0
    for in_tick_ns, clock.stall_in_wait_ns in stalls_ns:
        clock.time_ns += in_tick_ns
        tick = ticker.next()
        assert tick.period_count == last + 1 + tick.skipped_count
        # The tick belongs to the running period: never early, never a whole period late.
        assert clock.time_ns - 123 - tick.period_count * PERIOD_NS == tick.lateness_ns
        assert 0 <= tick.lateness_ns < PERIOD_NS
        last = tick.period_count
    assert ticker.skipped_count == last - len(stalls_ns)


def test_a_stall_of_several_periods_is_skipped_and_counts_as_late():
    clock = StallingClock()
    ticker = Ticker(clock, PERIOD_NS)
    ticker.next()
    clock.time_ns += 5 * PERIOD_NS + 1
    tick = ticker.next()
    assert (tick.skipped_count, tick.lateness_ns) == (4, 1)
    assert ticker.lateness.late_tick_ratio == pytest.approx(4 / 6)


def test_periods_in_which_the_computer_slept_are_missed_and_the_grid_stays():
    clock = StallingClock()
    ticker = Ticker(clock, PERIOD_NS)
    ticker.next()
    clock.suspended_ns += 3600 * 10**9
    tick = ticker.next()
    assert (tick.skipped_count, tick.period_count) == (360_000, 2)
    assert ticker.next().skipped_count == 0
    assert abs(RealTimeClock().slept_ns() - RealTimeClock().slept_ns()) < 10**9


@given(st.lists(st.integers(0, 20_000_000), max_size=60), st.integers(1, 30))
def test_late_ratio_is_that_of_the_window(values, window):
    lateness = Lateness(window)
    for value in values:
        lateness.add(value)
    kept = values[-window:]
    expected = sum(v > LATE_TICK_NS for v in kept) / len(kept) if kept else 0.0
    assert lateness.late_tick_ratio == pytest.approx(expected)


def test_unpaced_clock_is_always_due():
    ticker = Ticker(UnpacedClock(), PERIOD_NS)
    ticks = [ticker.next() for _ in range(100)]
    assert [tick.period_count for tick in ticks] == list(range(1, 101))
    assert not any(tick.lateness_ns or tick.skipped_count for tick in ticks)


def test_real_clock_never_wakes_early():
    clock = RealTimeClock()
    for _ in range(3):
        due_ns = clock.now_ns() + 2_000_000
        clock.wait_until(due_ns)
        assert clock.now_ns() >= due_ns


def test_nothing_that_moves_a_machine_reads_the_wall_clock():
    # A jump of the computer's clock cannot reach control. Text for people may name a time; and whether a
    # version was asked for before or after a rollback must be known over a restart of the computer.
    found = [
        f"{path.name}:{node.attr}"
        for path in sorted((Path(__file__).parents[3] / "runtime").rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute)
        and isinstance(node.value, ast.Name)
        and (node.value.id, node.attr)
        in {("time", "time"), ("time", "time_ns"), ("datetime", "now")}
    ]
    assert sorted(found) == ["outbox.py:now", "puller.py:time", "self_test.py:now", "slots.py:time"]
