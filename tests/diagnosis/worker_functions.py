"""Work for two processes; a module of its own, which the worker can import."""

import os
import signal


def scale(value: int, items: list[int], more: int) -> list[tuple[int, int]]:
    """Scaled items, and the process that computed them."""
    return [(value * item + more, os.getpid()) for item in items]


def fail_on_odd(value: int, items: list[int]) -> list[int]:
    """Work that fails on odd items."""
    if any(item % 2 for item in items):
        raise ValueError(f"{value}: odd items")
    return items


def kill_worker(test_pid: int, items: list[int]) -> list[int]:
    """Work that kills every process but the test's."""
    if os.getpid() != test_pid:
        os.kill(os.getpid(), signal.SIGKILL)
    return items
