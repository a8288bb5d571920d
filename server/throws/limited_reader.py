"""Reads throw logs in a process with limits: what a machine uploads is hostile until proven otherwise."""

import multiprocessing
import resource
import threading
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures import TimeoutError as FutureTimeoutError
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

from machine.errors import LogError
from runtime.records.log_reader import read_throw_log
from runtime.records.throw_log import ThrowLog
from server.child_process import limit_resources
from sim_twin.child_processes import end_pool, end_with_parent

MEMORY_BYTES = 2 * 1024**3
"""Address space of the process; a log may have 128 MB decompressed (runtime.records.log_reader)."""
READ_S = 20.0
"""Time for one log, waiting included; a usual one takes 0.3 s."""


class LimitedLogReader:
    """One process, started by the first log and again after one that broke it."""

    def __init__(self, read_s: float = READ_S) -> None:
        self._read_s = read_s
        self._lock = threading.Lock()
        self._pool: ProcessPoolExecutor | None = None

    def read(self, path: Path) -> ThrowLog:
        """The content of a log.

        Raises:
            LogError: it cannot be read, or not within the limits of memory and time.
        """
        with self._lock:
            if self._pool is None:
                self._pool = ProcessPoolExecutor(
                    1, mp_context=multiprocessing.get_context("spawn"), initializer=_start
                )
            pool = self._pool
        try:
            return pool.submit(_read, path, self._read_s).result(self._read_s)
        except (FutureTimeoutError, BrokenProcessPool, RuntimeError) as error:
            self._end(pool)
            raise LogError(
                f"{path.name} took more than {self._read_s:.0f} s or {MEMORY_BYTES >> 30} GiB to read"
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


def _read(path: Path, read_s: float) -> ThrowLog:
    used = resource.getrusage(resource.RUSAGE_SELF)
    limit_s = int(used.ru_utime + used.ru_stime + read_s) + 2
    resource.setrlimit(resource.RLIMIT_CPU, (limit_s, resource.RLIM_INFINITY))
    return read_throw_log(path)
