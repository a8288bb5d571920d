"""Audit of a column of sample times: rate, jitter, gaps, duplicates, backward steps.

It repairs nothing. It serves throw logs (nanoseconds) and other tables (seconds).
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from machine.conventions import Array

MIN_RATE_HZ: Final = 25.0
"""Lowest usable rate, Hz: dead times and lags of a hydraulic valve are 50 to 300 ms."""
GAP_PERIODS: Final = 1.5
"""A step longer than this many periods is a gap."""


@dataclass(frozen=True, slots=True)
class ClockAudit:
    """Statistics of one column of times."""

    samples_count: int
    span_s: float
    rate_hz: float
    """From the median step."""
    jitter_s: float
    """Standard deviation of the steps that are not gaps."""
    duplicate_count: int
    backward_count: int
    """Steps that go back in time."""
    gap_count: int
    """Steps longer than 1.5 periods."""
    missing_count: int
    """Samples that fit into the gaps."""
    longest_gap_s: float

    def as_json(self) -> Mapping[str, Any]:
        """The numbers by name."""
        return asdict(self)


def audit_clock(time_s: Array) -> ClockAudit:
    """Audit sample times.

    Args:
        time_s: (samples,) in the order in which they were recorded, s.
    """
    count = len(time_s)
    steps = np.diff(time_s)
    forward = steps[steps > 0.0]
    if forward.size == 0:
        return ClockAudit(count, 0.0, 0.0, 0.0, int(np.sum(steps == 0.0)), 0, 0, 0, 0.0)
    period = float(np.median(forward))
    gaps = forward[forward > GAP_PERIODS * period]
    regular = forward[forward <= GAP_PERIODS * period]
    return ClockAudit(
        samples_count=count,
        span_s=float(np.max(time_s) - np.min(time_s)),
        rate_hz=1.0 / period,
        jitter_s=float(np.std(regular)),
        duplicate_count=int(np.sum(steps == 0.0)),
        backward_count=int(np.sum(steps < 0.0)),
        gap_count=int(gaps.size),
        missing_count=int(np.sum(np.rint(gaps / period) - 1.0)),
        longest_gap_s=float(np.max(gaps)) if gaps.size else 0.0,
    )
