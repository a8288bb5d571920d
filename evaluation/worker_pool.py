"""Run independent tasks in this process or in several; the results are the same."""

import io
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from contextlib import redirect_stderr
from typing import TypeVar

from evaluation.progress import progress_line
from sim_twin.child_processes import one_blas_thread, process_pool

Result = TypeVar("Result")


def run_tasks(tasks: Sequence[Callable[[], Result]], jobs: int, what: str) -> list[Result]:
    """Results of the tasks, in their order.

    Args:
        tasks: callables without arguments; with more than one job they are pickled.
        jobs: number of worker processes; 1 runs everything in this process.
        what: label of the progress line.
    """
    if jobs == 1 or len(tasks) < 2:
        return [task() for task in tasks]
    show = progress_line(what, "parts")
    with process_pool(min(jobs, len(tasks))) as pool:
        waiting = [pool.submit(_run_quietly, task) for task in tasks]
        try:
            for done, future in enumerate(as_completed(waiting)):
                future.result()
                show(done + 1, len(tasks))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
        return [future.result() for future in waiting]


def _run_quietly(task: Callable[[], Result]) -> Result:
    """Run without progress lines, which would mix with other workers', and with one BLAS thread."""
    with redirect_stderr(io.StringIO()), one_blas_thread():
        return task()
