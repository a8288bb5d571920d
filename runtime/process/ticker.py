"""The periodic loop's clock: real time by absolute sleep, or as fast as the driver allows.

Periods that were missed are skipped and counted, never made up for in a bunch: a valve loop that runs
three times in a row is worse than one that misses two beats. Nothing here is a wall clock.
"""

import sys
import time
from collections import deque
from dataclasses import dataclass
from typing import Final, Protocol

LATE_TICK_NS: Final = 5_000_000
"""A tick that starts later than this counts as late (half a period)."""
LATENESS_WINDOW_COUNT: Final = 1000
"""Ticks over which lateness is judged: 10 s."""


class Clock(Protocol):
    """What the loop waits by."""

    def now_ns(self) -> int:
        """Present time; monotonic."""
        ...

    def wait_until(self, due_ns: int) -> None:
        """Return at `due_ns`, or at once when that is past."""
        ...

    def slept_ns(self) -> int:
        """Time since some moment in which the computer was suspended, and this clock stood still."""
        ...


class RealTimeClock:
    """CLOCK_MONOTONIC."""

    def now_ns(self) -> int:
        """Present time of the monotonic clock."""
        return time.monotonic_ns()

    def wait_until(self, due_ns: int) -> None:
        """Sleep to an absolute time.

        CPython 3.11 sleeps by clock_nanosleep with an absolute deadline, so a signal or a preemption
        between the subtraction and the sleep does not add up over the ticks.
        """
        while (left_ns := due_ns - time.monotonic_ns()) > 0:
            time.sleep(left_ns * 1e-9)

    def slept_ns(self) -> int:
        """What the clock that counts suspension has more; 0 where there is none."""
        if sys.platform != "linux":
            return 0
        return time.clock_gettime_ns(time.CLOCK_BOOTTIME) - time.monotonic_ns()


class UnpacedClock:
    """As fast as the driver's simulated time allows: it is always already due."""

    def __init__(self) -> None:
        self._now_ns = 0

    def now_ns(self) -> int:
        """The last time that was waited for."""
        return self._now_ns

    def wait_until(self, due_ns: int) -> None:
        """Jump there."""
        self._now_ns = max(self._now_ns, due_ns)

    def slept_ns(self) -> int:
        """Never."""
        return 0


@dataclass(frozen=True, slots=True)
class ClockTick:
    """One beat of the loop."""

    period_count: int
    """Periods since the start, skipped ones included: the loop's own time base."""
    lateness_ns: int
    skipped_count: int
    """Periods missed just before this tick; also those in which the computer was suspended."""


class Ticker:
    """Gives the beats of a periodic loop."""

    def __init__(self, clock: Clock, period_ns: int) -> None:
        self._clock = clock
        self._period_ns = period_ns
        self._start_ns = clock.now_ns()
        self._slept_ns = clock.slept_ns()
        self._period_count = 0
        self._skipped_count = 0
        self._lateness = Lateness()

    @property
    def lateness(self) -> "Lateness":
        """Statistics of the last ticks; a skipped period counts with its whole delay."""
        return self._lateness

    @property
    def skipped_count(self) -> int:
        """Periods missed since the start."""
        return self._skipped_count

    def next(self) -> ClockTick:
        """Wait for the next period's start; when it has passed, take the running period instead."""
        due = self._period_count + 1
        self._clock.wait_until(self._start_ns + due * self._period_ns)
        # Looked at after the wait: the process may have been stopped in it.
        elapsed_ns = self._clock.now_ns() - self._start_ns
        skipped = max(elapsed_ns // self._period_ns - due, 0)
        self._period_count = due + skipped
        lateness_ns = max(elapsed_ns - self._period_count * self._period_ns, 0)
        for missed in range(min(skipped, LATENESS_WINDOW_COUNT), 0, -1):
            self._lateness.add(lateness_ns + missed * self._period_ns)
        self._lateness.add(lateness_ns)
        self._skipped_count += skipped
        slept_ns, self._slept_ns = self._slept_ns, self._clock.slept_ns()
        # The monotonic clock stood still meanwhile: neither the grid nor a simulated machine goes on.
        slept = max(self._slept_ns - slept_ns, 0) // self._period_ns
        return ClockTick(self._period_count, lateness_ns, skipped + slept)


class Lateness:
    """Lateness of the last ticks."""

    def __init__(self, window_count: int = LATENESS_WINDOW_COUNT) -> None:
        self._values: deque[int] = deque(maxlen=window_count)
        self._late_count = 0

    def add(self, lateness_ns: int) -> None:
        """Note one tick."""
        if len(self._values) == self._values.maxlen:
            self._late_count -= self._values[0] > LATE_TICK_NS
        self._values.append(lateness_ns)
        self._late_count += lateness_ns > LATE_TICK_NS

    @property
    def late_tick_ratio(self) -> float:
        """Share of the window's ticks that started later than `LATE_TICK_NS`."""
        return self._late_count / len(self._values) if self._values else 0.0
