"""The executor that a person has chosen: processes of this computer, or a cluster."""

from collections.abc import Generator
from contextlib import contextmanager

from evaluation.execution.dask_cluster import open_cluster
from evaluation.execution.executor import Executor, LocalProcesses
from machine.errors import UsageError


@contextmanager
def open_executor(jobs: int, scheduler: str | None = None) -> Generator[Executor]:
    """The executor that a person has chosen.

    Args:
        jobs: processes of this computer.
        scheduler: address of a Dask scheduler, such as tcp://10.0.0.5:8786; its workers are used instead.

    Raises:
        UsageError: no processes, or a cluster that cannot be used.
    """
    if jobs < 1:
        raise UsageError(f"--jobs {jobs}: at least 1")
    if scheduler is None:
        yield LocalProcesses(jobs)
        return
    with open_cluster(scheduler) as cluster:
        yield cluster
