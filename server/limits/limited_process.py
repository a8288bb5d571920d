"""Reads what people and machines upload in a process with limits: it is hostile until proven otherwise."""

import multiprocessing
import resource
import threading
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures import TimeoutError as FutureTimeoutError
from concurrent.futures.process import BrokenProcessPool
from typing import ParamSpec, TypeVar

from server.child_process import limit_resources
from sim_twin.child_processes import end_pool, end_with_parent

MEMORY_BYTES = 2 * 1024**3
"""Address space of the process; a log may have 128 MB decompressed (runtime.records.log_reader)."""
READ_S = 20.0
"""Time for one file, waiting included; a usual log takes 0.3 s."""

GivenT = ParamSpec("GivenT")
FoundT = TypeVar("FoundT")


class LimitExceededError(Exception):
    """More time or memory than allowed; the message says how much that is."""


class LimitedProcess:
    """One process, started by the first work and again after one that broke it."""

    def __init__(self, read_s: float = READ_S) -> None:
        self._read_s = read_s
        self._lock = threading.Lock()
        self._pool: ProcessPoolExecutor | None = None

    def run(
        self, work: Callable[GivenT, FoundT], *args: GivenT.args, **named: GivenT.kwargs
    ) -> FoundT:
        """What a function returns or raises; it and its arguments travel to the process.

        Raises:
            LimitExceededError: it needed more than the limits of memory and time.
        """
        with self._lock:
            if self._pool is None:
                self._pool = ProcessPoolExecutor(
                    1, mp_context=multiprocessing.get_context("spawn"), initializer=_start
                )
            pool = self._pool
        try:
            return pool.submit(_run, self._read_s, work, *args, **named).result(self._read_s)
        except (FutureTimeoutError, BrokenProcessPool, MemoryError, RuntimeError) as error:
            self._end(pool)
            raise LimitExceededError(
                f"more than {self._read_s:.0f} s or {MEMORY_BYTES >> 30} GiB"
            ) from error

    def close(self) -> None:
        """End the process."""
        with self._lock:
            pool = self._pool
        if pool is not None:
            self._end(pool)

    def _end(self, pool: ProcessPoolExecutor) -> None:
        with self._lock:
            if self._pool is pool:
                self._pool = None
        end_pool(pool)


def _start() -> None:
    end_with_parent()
    limit_resources(memory_bytes=MEMORY_BYTES)


def _run(
    read_s: float, work: Callable[GivenT, FoundT], *args: GivenT.args, **named: GivenT.kwargs
) -> FoundT:
    used = resource.getrusage(resource.RUSAGE_SELF)
    limit_s = int(used.ru_utime + used.ru_stime + read_s) + 2
    resource.setrlimit(resource.RLIMIT_CPU, (limit_s, resource.RLIM_INFINITY))
    return work(*args, **named)
