"""Age of a command by the machine's own clock: the sender echoes the machine time that it last saw.

A link that stalls and heals delivers what it held, in order and without loss; neither epoch nor nonce tell
such a fire from a fresh one. No clocks are compared: the echo is a time of this machine, of this boot.
"""

from typing import Final

from machine.messages import FireRequest, OperatorHeartbeat

FIRE_AGE_MAX_NS: Final = 1_000_000_000
"""State is sent at 10 Hz, a fire answered within 0.5 s or given up by the server: older ones are dead."""
HEARTBEAT_AGE_MAX_NS: Final = 500_000_000
"""Round trip (0.2 s on a poor mobile link), one state period (0.1 s), and reserve."""


def why_stale(message: FireRequest | OperatorHeartbeat, now_ns: int) -> str:
    """Why a message is too old to act on, for people; empty = it is fresh."""
    seen_ns = message.seen_t_mono_ns
    if seen_ns is None:
        return "It does not say which time of this machine its sender had seen. Update the sender."
    limit_ns = FIRE_AGE_MAX_NS if isinstance(message, FireRequest) else HEARTBEAT_AGE_MAX_NS
    age_ns = now_ns - seen_ns
    if age_ns < 0:
        return "It was made before this machine's last restart. Arm again."
    if age_ns > limit_ns:
        return (
            f"It was up to {age_ns * 1e-9:.1f} s on its way, {limit_ns * 1e-9:.1f} s are allowed. "
            "Check the link, then arm again."
        )
    return ""
