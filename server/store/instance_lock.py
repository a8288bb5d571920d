"""A lock that admits one server per data folder; two would disagree about leases and nonces."""

import fcntl
import os
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from machine.errors import UsageError

LOCK_FILE = "server.lock"


@contextmanager
def instance_lock(data_dir: Path) -> Generator[None]:
    """Hold the folder's lock; the system gives it back when the process ends, however it ends.

    Raises:
        UsageError: another process holds it, or the folder cannot be written.
    """
    path = data_dir / LOCK_FILE
    try:
        data_dir.mkdir(parents=True, exist_ok=True)
        file = path.open("a+", encoding="utf-8")
    except OSError as error:
        raise UsageError(
            f"data folder {data_dir} cannot be written ({error.strerror}); set DOWNRANGE_DATA_DIR"
        ) from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            file.seek(0)
            owner = file.read().strip() or "unknown"
            raise UsageError(
                f"another server (process {owner}) uses data folder {data_dir}; stop it, or give "
                "this one a folder of its own with DOWNRANGE_DATA_DIR"
            ) from error
        file.truncate(0)
        file.write(str(os.getpid()))
        file.flush()
        yield
