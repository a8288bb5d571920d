"""A worker process that does half of a list of tasks: a diagnosis may count on two cores.

The worker holds one value that all tasks share, so that it is sent once. When the worker is gone, the calling
process does all tasks itself.
"""

from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from typing import Any

from sim_twin.child_processes import end_pool, one_blas_thread, process_pool

Work = Callable[..., Any]
"""A function at the top level of a module; it is called with the held value, the items and more arguments."""


class WorkerProcess:
    """Runs half of the tasks beside the calling process. Close it when the work is done."""

    def __init__(self) -> None:
        # One worker takes all tasks in their order, and holds the value before it gets the work.
        self._pool = process_pool(1)
        self._held: Future[None] | None = None

    def close(self) -> None:
        """End the process, whatever it does."""
        end_pool(self._pool)

    def preload(self, work: Work) -> None:
        """Let the worker import the module of a function before the first task needs it."""
        with suppress(BrokenProcessPool):
            self._pool.submit(_import, work)

    def hold(self, value: Any) -> None:
        """Send the value that all later tasks share."""
        with suppress(BrokenProcessPool):
            self._held = self._pool.submit(_hold, value)

    def split(self, work: Work, value: Any, items: list[Any], *more: Any) -> list[Any]:
        """Results of ``work(value, items, *more)``, one per item; each process computes half of them."""
        ours, theirs = items[::2], items[1::2]
        results: list[Any] = [None] * len(items)
        try:
            answer = self._pool.submit(_compute, work, theirs, more)
            results[::2] = work(value, ours, *more)
            if self._held is not None:
                self._held.result()
            results[1::2] = answer.result()
        except BrokenProcessPool:
            return list(work(value, items, *more))
        return results


_held: Any = None
"""In the worker: the value that all tasks share."""


def _import(work: Work) -> None:
    """Nothing to do: the function's module is imported by now."""


def _hold(value: Any) -> None:
    global _held
    _held = value


def _compute(work: Work, items: list[Any], more: tuple[Any, ...]) -> list[Any]:
    with one_blas_thread():
        return list(work(_held, items, *more))
