"""An existing Dask cluster as an executor.

Workers have one thread each (`dask worker ADDRESS --nthreads 1`), this software at the same state, and see
the same files at the same paths.
"""

import hashlib
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, TypeVar

from evaluation.execution.executor import run_quietly
from machine.errors import UsageError

Result = TypeVar("Result")

CONNECT_S: Final = "20s"
PACKAGES: Final = ("machine", "runtime", "sim_twin", "evaluation")
"""Packages whose code the numbers depend on."""


class DaskCluster:
    """A connected cluster."""

    def __init__(self, client: Any) -> None:
        """Use a `distributed.Client`."""
        self._client = client

    @property
    def worker_count(self) -> int:
        """Tasks that run side by side, at least 2: the tasks are always shared out."""
        return max(2, len(self._client.nthreads()))

    def run(self, tasks: Sequence[Callable[[], Result]]) -> Iterator[tuple[int, Result]]:
        """Place and result of each task as they end."""
        from distributed import as_completed

        futures = [self._client.submit(run_quietly, task, pure=False) for task in tasks]
        places = {future.key: place for place, future in enumerate(futures)}
        try:
            for future in as_completed(futures, loop=self._client.loop):
                yield places[future.key], future.result()
        finally:
            self._client.cancel(futures)


@contextmanager
def open_cluster(address: str) -> Generator[DaskCluster]:
    """Connect to a scheduler and check its workers.

    Raises:
        UsageError: the package is missing, nobody answers, or workers that would give other numbers.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise UsageError(
            "a scheduler needs the package distributed: install downrange[cluster]"
        ) from error
    try:
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise UsageError(f"no Dask scheduler answers at {address}: {error}") from error
    try:
        _check_workers(client, address)
        yield DaskCluster(client)
    finally:
        client.close()


def _check_workers(client: Any, address: str) -> None:
    threads: dict[str, int] = dict(client.nthreads())
    if not threads:
        raise UsageError(
            f"the scheduler at {address} has no workers: start `dask worker {address}`"
        )
    wide = sorted(name for name, count in threads.items() if count != 1)
    if wide:
        raise UsageError(f"worker {wide[0]} has several threads: start it with --nthreads 1")
    own = code_digest()
    for name, digest in sorted(client.run(code_digest).items()):
        if digest != own:
            raise UsageError(
                f"worker {name} runs other code ({digest[:12]}) than this computer ({own[:12]}): "
                "install the same version there"
            )


def code_digest() -> str:
    """Hash of the code that a campaign's numbers depend on."""
    digest = hashlib.sha256()
    root = Path(__file__).parents[2]
    for package in PACKAGES:
        for source in sorted((root / package).rglob("*.py")):
            digest.update(str(source.relative_to(root)).encode())
            digest.update(source.read_bytes())
    return digest.hexdigest()
