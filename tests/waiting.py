"""Waiting for states, never for times."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

Found = TypeVar("Found")


def wait_for(condition: Callable[[], Found], timeout_s: float = 60.0) -> Found:
    """Poll until a condition holds; a test fails if it never does.

    What is waited for takes fractions of a second; the limit is for computers that are busy with other work.
    """
    return until(condition, repr(condition), timeout_s)


def until(condition: Callable[[], Found], what: str, timeout_s: float = 60.0) -> Found:
    """The same with words for what is waited for.

    Raises:
        TimeoutError: it did not come.
    """
    end_s = time.monotonic() + timeout_s
    while time.monotonic() < end_s:
        if found := condition():
            return found
        time.sleep(0.01)
    raise TimeoutError(f"{what}: not within {timeout_s:g} s")


def is_alive(pid: int) -> bool:
    """Whether a process runs; one that has ended and that nobody has asked for does not."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"
