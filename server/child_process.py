"""Rules for the server's child processes: they end with the server and stay within limits."""

import multiprocessing
import os
import resource
import threading


def end_with_parent() -> None:
    """Watch the parent from a thread and exit when it is gone, however it ended; call in the child."""
    threading.Thread(target=_wait_for_parent, name="parent-watch", daemon=True).start()


def _wait_for_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def limit_resources(*, memory_bytes: int) -> None:
    """Bound the address space of this process; no core dumps and no written files.

    Beyond it an allocation fails with MemoryError.
    """
    resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
