"""Decides whether a process of the machine hangs, from its counter, its state and its processor time.

A loop that is only starved of processor time must not be killed for it: control's valves are closed by the
watchdog meanwhile, and a dead link already means hold. A stopped or spinning one never comes back by itself.
"""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

from runtime.process.alive_counter import STOPPED_STATES

BLIND_LIMIT_S: Final = 0.1
"""A watch that was itself not run for so long knows nothing about the time between."""


class HangLimits(NamedTuple):
    """After how long a silent process counts as hung, in s."""

    stopped_s: float
    """Silence of a process that the kernel calls stopped."""
    spinning_s: float
    """Processor time without a count."""
    silent_s: float
    """Silence, whatever it does."""


CONTROL_LIMITS: Final = HangLimits(stopped_s=0.12, spinning_s=0.15, silent_s=1.0)
"""It counts every 10 ms."""
LINK_LIMITS: Final = HangLimits(stopped_s=0.12, spinning_s=math.inf, silent_s=10.0)
"""It counts at least every 100 ms, so that a stop is noticed within 120 ms. Its main thread may wait for a
slow disk and repairs logs after a restart, while commands go on in other threads."""


@dataclass(slots=True)
class HangWatch:
    """What was seen of one process."""

    limits: HangLimits = CONTROL_LIMITS
    value: int = -1
    changed_s: float = 0.0
    used_s: float = 0.0
    looked_s: float = 0.0

    def look(self, value: int, state: str, used_s: float, now_s: float) -> str:
        """One look; why the process hangs, empty = it does not.

        Args:
            value: of the alive counter.
            state: letter of /proc/PID/stat.
            used_s: processor time of the process so far.
            now_s: monotonic time.
        """
        is_blind = now_s - self.looked_s > BLIND_LIMIT_S
        self.looked_s = now_s
        if value != self.value or is_blind:
            self.value, self.changed_s, self.used_s = value, now_s, used_s
            return ""
        silent_s = now_s - self.changed_s
        if state in STOPPED_STATES and silent_s > self.limits.stopped_s:
            return f"stopped for {silent_s:.2f} s"
        if used_s - self.used_s > self.limits.spinning_s:
            return f"busy in one period for {silent_s:.2f} s"
        return f"silent for {silent_s:.2f} s" if silent_s > self.limits.silent_s else ""
