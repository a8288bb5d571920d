"""Run independent tasks in this process or in several; the results are the same."""

import io
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import redirect_stderr
from multiprocessing import get_context
from typing import TypeVar

from threadpoolctl import threadpool_limits

from evaluation.progress import progress_line

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
    # Spawned, not forked: a simulator's threads do not survive a fork.
    with ProcessPoolExecutor(min(jobs, len(tasks)), mp_context=get_context("spawn")) as pool:
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
    with redirect_stderr(io.StringIO()), threadpool_limits(1, user_api="blas"):
        return task()
