"""Child processes of the server: work at low priority that can be killed, and limits of memory."""

import multiprocessing
import os
import resource
import signal
import sys
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any, Final

from sim_twin.child_processes import end_with_parent

NICENESS: Final = 15
"""Below previews (5): what runs here takes a minute or more and may wait."""
POLL_S: Final = 0.2
END_WAIT_S: Final = 2.0

Send = Callable[[tuple[str, Any]], None]
"""Sends a kind of message and its content to the server: "done" with the answer, "failed" with the reason, or
others."""


class ChildFailedError(Exception):
    """The process ended without an answer."""


class ChildKilledError(Exception):
    """The work was cancelled."""


def run_child(
    work: Callable[..., None],
    args: tuple[Any, ...],
    name: str,
    on_message: Callable[[str, Any], None],
    is_cancelled: Callable[[], bool],
) -> Any:
    """Run work in a process of its own; blocks until it ended, and returns its answer.

    The process is spawned, not forked, because the server holds Zenoh's threads; it exits when the server is
    gone.

    Args:
        work: called there with `args` and `Send`.
        args: as they travel to the process.
        name: of the work, for messages to people.
        on_message: called here with every message before the answer.
        is_cancelled: polled several times a second; True kills the process.

    Raises:
        ChildKilledError: `is_cancelled` returned True.
        ChildFailedError: the work failed, with the reason.
    """
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    # Not a daemon: those may have no processes of their own.
    given = (work, args, theirs, NICENESS)
    process = context.Process(target=_work, args=given, name=name)
    process.start()
    theirs.close()
    try:
        while True:
            if is_cancelled():
                raise ChildKilledError
            if not ours.poll(POLL_S):
                continue
            try:
                kind, content = ours.recv()
            except EOFError:
                process.join(END_WAIT_S)
                raise ChildFailedError(
                    f"the {name} ended without an answer (exit code {process.exitcode}); "
                    "killed for memory? The server's log may say more"
                ) from None
            if kind == "failed":
                raise ChildFailedError(content)
            if kind == "done":
                return content
            on_message(kind, content)
    finally:
        ours.close()
        _end(process)


def _end(process: Any) -> None:
    process.join(0.5)
    if process.is_alive():
        process.terminate()
        process.join(END_WAIT_S)
    if process.is_alive():
        process.kill()
        process.join()
    process.close()


def _work(
    work: Callable[..., None], args: tuple[Any, ...], answers: Connection, niceness: int
) -> None:
    """Entry point of the process."""
    os.nice(niceness)
    end_with_parent()
    # Work that is cancelled ends its own worker processes.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    work(*args, answers.send)


def limit_resources(*, memory_bytes: int) -> None:
    """Bound the address space of this process; no core dumps and no written files.

    Beyond it an allocation fails with MemoryError.
    """
    resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
