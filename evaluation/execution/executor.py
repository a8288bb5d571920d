"""Executors of a campaign's tasks; the results do not depend on which one is chosen."""

import io
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from contextlib import redirect_stderr
from typing import NamedTuple, Protocol, TypeVar

from evaluation.progress import progress_line
from sim_twin.child_processes import end_pool, one_blas_thread, process_pool

Result = TypeVar("Result")


class Executor(Protocol):
    """Runs tasks that do not depend on each other."""

    @property
    def worker_count(self) -> int:
        """Tasks that run side by side."""
        ...

    def run(self, tasks: Sequence[Callable[[], Result]]) -> Iterator[tuple[int, Result]]:
        """Place and result of each task as they end; the first error ends all.

        Args:
            tasks: callables without arguments; with more than one worker they are pickled.
        """
        ...


class LocalProcesses(NamedTuple):
    """Processes of this computer; a single one is the caller's own."""

    worker_count: int = 1

    def run(self, tasks: Sequence[Callable[[], Result]]) -> Iterator[tuple[int, Result]]:
        """Place and result of each task as they end."""
        if self.worker_count == 1 or len(tasks) < 2:
            for place, task in enumerate(tasks):
                yield place, task()
            return
        pool = process_pool(min(self.worker_count, len(tasks)))
        try:
            places = {pool.submit(run_quietly, task): place for place, task in enumerate(tasks)}
            for future in as_completed(places):
                yield places[future], future.result()
        except BaseException:
            end_pool(pool)
            raise
        pool.shutdown()


def run_tasks(tasks: Sequence[Callable[[], Result]], executor: Executor, what: str) -> list[Result]:
    """Results of the tasks, in their order, with a line of progress labelled `what`."""
    show = progress_line(what, "parts") if executor.worker_count > 1 and len(tasks) > 1 else None
    found: dict[int, Result] = {}
    for place, result in executor.run(tasks):
        found[place] = result
        if show is not None:
            show(len(found), len(tasks))
    return [found[place] for place in range(len(tasks))]


def run_quietly(task: Callable[[], Result]) -> Result:
    """Run without progress lines, which would mix with other workers', and with one BLAS thread."""
    with redirect_stderr(io.StringIO()), one_blas_thread():
        return task()
