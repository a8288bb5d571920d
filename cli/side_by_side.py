"""Work that is the same whether one process does it or several."""

import io
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import redirect_stderr
from multiprocessing import get_context
from typing import TypeVar

from cli.campaigns import progress_line
from diagnosis.threads import one_blas_thread

Result = TypeVar("Result")


def side_by_side(tasks: Sequence[Callable[[], Result]], jobs: int, what: str) -> list[Result]:
    """Results of the tasks, in their order: in this process for one job, else in as many others.

    Args:
        tasks: what each has to do; with more than one job they are pickled.
        jobs: processes at work.
        what: named in the progress line.
    """
    if jobs == 1 or len(tasks) < 2:
        return [task() for task in tasks]
    show = progress_line(what, "parts")
    # Spawned, not forked: a simulator's threads do not survive a fork.
    with ProcessPoolExecutor(min(jobs, len(tasks)), mp_context=get_context("spawn")) as pool:
        waiting = [pool.submit(_quietly, task) for task in tasks]
        try:
            for done, future in enumerate(as_completed(waiting)):
                future.result()
                show(done + 1, len(tasks))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
        return [future.result() for future in waiting]


def _quietly(task: Callable[[], Result]) -> Result:
    """Without its progress lines, which would be mixed with the others', and with one thread for algebra."""
    with redirect_stderr(io.StringIO()), one_blas_thread():
        return task()
