"""Child processes of long computations: they end with their parent, and use one BLAS thread each."""

import multiprocessing
import os
import threading
from collections.abc import Generator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager

from threadpoolctl import threadpool_limits

END_WAIT_S = 2.0


def process_pool(count: int) -> ProcessPoolExecutor:
    """Worker processes that end with this one, however it ends.

    Spawned, not forked: a simulator's threads do not survive a fork.
    """
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(count, mp_context=context, initializer=end_with_parent)


def end_pool(pool: ProcessPoolExecutor) -> None:
    """Kill the workers of a pool, whatever they do."""
    # Python 3.14 has `kill_workers`.
    processes = list((getattr(pool, "_processes", None) or {}).values())
    manager = getattr(pool, "_executor_manager_thread", None)
    pool.shutdown(wait=False, cancel_futures=True)
    for process in processes:
        process.kill()
    if manager is not None:
        # Otherwise it may still be closing its pipes when the interpreter exits.
        manager.join(END_WAIT_S)


def end_with_parent() -> None:
    """Watch the parent from a thread and exit when it is gone, however it ended; call in the child."""
    threading.Thread(target=_wait_for_parent, name="parent-watch", daemon=True).start()


def _wait_for_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def one_blas_thread() -> Generator[None]:
    """Limit the BLAS libraries that are loaded to one thread inside.

    The matrices are small. With several BLAS threads on busy cores the threads mostly wait for each other.
    """
    with threadpool_limits(1, user_api="blas"):
        yield
