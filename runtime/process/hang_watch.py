"""Decides whether a control process hangs, from its counter, its state and the processor time it used.

A loop that is only starved of processor time must not be killed for it: its valves are closed by the
watchdog meanwhile. A stopped or spinning one never comes back by itself.
"""

from dataclasses import dataclass
from typing import Final

from runtime.process.alive_counter import STOPPED_STATES

STOPPED_LIMIT_S: Final = 0.12
"""Silence after which a stopped process counts as hung; 12 periods."""
SPINNING_LIMIT_S: Final = 0.15
"""Processor time in one period after which a running process counts as hung."""
STARVED_LIMIT_S: Final = 1.0
"""Silence after which it counts as hung whatever it does."""
BLIND_LIMIT_S: Final = 0.1
"""A watch that was itself not run for so long knows nothing about the time between."""


@dataclass(slots=True)
class HangWatch:
    """What was seen of one control process."""

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
        if state in STOPPED_STATES and silent_s > STOPPED_LIMIT_S:
            return f"stopped for {silent_s:.2f} s"
        if used_s - self.used_s > SPINNING_LIMIT_S:
            return f"busy in one period for {silent_s:.2f} s"
        return f"silent for {silent_s:.2f} s" if silent_s > STARVED_LIMIT_S else ""
