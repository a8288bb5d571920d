"""The machine's own time as the server knows it between two messages of the machine."""

from dataclasses import dataclass

WINDOW_NS = 500_000_000
"""Messages of this time and of the one before it count: the clocks of two computers drift apart."""
AHEAD_MAX_NS = 100_000_000
"""Two periods of the state. A server that hears nothing of the machine must not go on for it."""


@dataclass(slots=True)
class MachineClock:
    """Estimate of a machine's monotonic time, never later than the truth while the clock runs steadily.

    A message comes later than it was stamped, so the largest difference between stamp and reception is the
    one with the least delay. The time of the machine is at least the server's time plus that difference.
    """

    seen_ns: int
    """Newest stamp of the machine."""
    newer_ns: int
    """Largest difference between stamp and reception in the present window."""
    older_ns: int
    """The same in the window before."""
    window_start_ns: int

    @classmethod
    def first(cls, stamp_ns: int, received_ns: int) -> "MachineClock":
        """From one message.

        Args:
            stamp_ns: the machine's monotonic time in it.
            received_ns: the server's monotonic time when it came.
        """
        lead_ns = stamp_ns - received_ns
        return cls(stamp_ns, lead_ns, lead_ns, received_ns)

    def take(self, stamp_ns: int, received_ns: int) -> None:
        """Another message of the same boot."""
        self.seen_ns = max(self.seen_ns, stamp_ns)
        lead_ns = stamp_ns - received_ns
        if received_ns - self.window_start_ns > WINDOW_NS:
            self.older_ns, self.newer_ns = self.newer_ns, lead_ns
            self.window_start_ns = received_ns
        self.newer_ns = max(self.newer_ns, lead_ns)

    def now_ns(self, server_ns: int) -> int:
        """The machine's time at the server's monotonic time."""
        estimate_ns = server_ns + max(self.newer_ns, self.older_ns)
        return min(max(estimate_ns, self.seen_ns), self.seen_ns + AHEAD_MAX_NS)
