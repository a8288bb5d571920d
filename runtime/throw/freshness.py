"""Age of a message by the machine's own clock: the sender echoes the machine time that it last saw.

A link that stalls and heals delivers what it held, in order and without loss. Neither epoch nor nonce tell
such a command from a fresh one. No clocks are compared: the echo is a time of this machine, of this boot.

STOP, abort, disarm and lease have no limit: they only take permission away. The others are refused as
COMMAND_STALE.
"""

import math
from typing import Final

from machine.messages import (
    ArmRequest,
    Command,
    FireRequest,
    LoadRequest,
    OperatorHeartbeat,
    StopClearRequest,
    ZonesRequest,
)
from runtime.throw.protocol import HEARTBEAT_SILENCE_S

COMMAND_AGE_MAX_NS: Final[dict[type[object], int]] = {
    FireRequest: 500_000_000,
    ArmRequest: 500_000_000,
    LoadRequest: 500_000_000,
    StopClearRequest: 500_000_000,
    ZonesRequest: 500_000_000,
}
"""The server waits longer for an answer: none is executed after it was reported as unknown."""
HEARTBEAT_AGE_MAX_NS: Final = round(HEARTBEAT_SILENCE_S * 1e9)
"""An older heartbeat would have run out when it came."""


def why_stale(message: Command | OperatorHeartbeat, now_ns: int, stalled_ns: int = -1) -> str:
    """Why a message is too old to act on, for people; empty = it is fresh, or has no limit.

    Args:
        message: a command or a heartbeat.
        now_ns: machine's clock. It may stand still while the computer is suspended.
        stalled_ns: machine's time when its control loop last stood still; -1 = it never did.
    """
    if isinstance(message, OperatorHeartbeat):
        return _why_old(message.seen_t_mono_ns, HEARTBEAT_AGE_MAX_NS, now_ns, stalled_ns)
    limit_ns = COMMAND_AGE_MAX_NS.get(type(message))
    if limit_ns is None:
        return ""
    return _why_old(getattr(message, "seen_t_mono_ns", None), limit_ns, now_ns, stalled_ns)


def _why_old(seen_ns: int | None, limit_ns: int, now_ns: int, stalled_ns: int) -> str:
    if seen_ns is None:
        return "It does not say which time of this machine its sender had seen. Update the sender."
    age_ns = now_ns - seen_ns
    if age_ns < 0:
        return "It was made before this machine's last restart. Look at the machine, then send it again."
    if seen_ns <= stalled_ns:
        return (
            "It was made before this machine's control loop last stood still, or its computer slept. "
            "Look at the machine, then send it again."
        )
    if age_ns > limit_ns:
        over_s = math.ceil((age_ns - limit_ns) * 1e-7) / 100.0  # Never "0.00 s".
        return (
            f"It was {over_s:.2f} s longer on its way than the {limit_ns * 1e-9:.1f} s "
            "allowed. Check the link, then send it again."
        )
    return ""
