"""Asks the system to run the control loop in time: real-time scheduling, locked memory, no garbage runs.

What is not permitted is said once and gone without; late ticks are counted and visible either way.
"""

import ctypes
import gc
import logging
import os
import resource
import time
from typing import Final

logger = logging.getLogger(__name__)

PRIORITY_COUNT: Final = 49
"""Just below the kernel's interrupt threads (50), which bring the sensors' data."""
_LOCK_CURRENT_AND_FUTURE: Final = 3
COLLECT_PERIOD_S: Final = 30.0


def become_real_time() -> list[str]:
    """Ask for all of it; returns what was refused, for people."""
    refused: list[str] = []
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY_COUNT))
    except (OSError, AttributeError) as error:
        refused.append(f"real-time scheduling ({error}); grant CAP_SYS_NICE or LimitRTPRIO=49")
    soft, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    # Under a limit, locking would succeed now and let a later allocation fail in the middle of a throw.
    if soft != resource.RLIM_INFINITY and os.geteuid() != 0:
        refused.append("locked memory (limited); grant CAP_IPC_LOCK and LimitMEMLOCK=infinity")
    elif ctypes.CDLL(None, use_errno=True).mlockall(_LOCK_CURRENT_AND_FUTURE) != 0:
        refused.append(f"locked memory ({os.strerror(ctypes.get_errno())}); grant CAP_IPC_LOCK")
    if refused:
        logger.warning("control runs without %s", "; ".join(refused))
    return refused


class IdleGarbageCollector:
    """No garbage collection by itself; `collect` runs it when the machine rests."""

    def __init__(self) -> None:
        # What was made at start lives as long as the process; later runs need not look at it.
        gc.collect()
        gc.freeze()
        gc.disable()
        self._last_s = time.monotonic()

    def collect(self) -> None:
        """Collect now and then; call it while nothing moves."""
        if time.monotonic() - self._last_s >= COLLECT_PERIOD_S:
            gc.collect()
            self._last_s = time.monotonic()
