"""Reads throw logs within limits of memory and time."""

from pathlib import Path

from machine.errors import LogError
from runtime.records.log_reader import read_throw_log
from runtime.records.throw_log import ThrowLog
from server.limits.limited_process import READ_S, LimitedProcess, LimitExceededError


class LimitedLogReader:
    """Reads logs in a process of its own."""

    def __init__(self, read_s: float = READ_S) -> None:
        self._process = LimitedProcess(read_s)

    def read(self, path: Path) -> ThrowLog:
        """The content of a log.

        Raises:
            LogError: it cannot be read, or not within the limits of memory and time.
        """
        try:
            return self._process.run(read_throw_log, path)
        except LimitExceededError as error:
            raise LogError(f"{path.name} took {error} to read") from error

    def close(self) -> None:
        """End the process."""
        self._process.close()
