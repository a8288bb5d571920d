"""Limits of the server's child processes."""

import resource


def limit_resources(*, memory_bytes: int) -> None:
    """Bound the address space of this process; no core dumps and no written files.

    Beyond it an allocation fails with MemoryError.
    """
    resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
