"""Process groups that a test run starts end with it, also where the run itself is killed.

A second process holds the other end of a pipe. When the pipe closes, however the run ended, it kills the
groups that were named and not taken back.
"""

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterable
from functools import cache


def end_with_run(process: "subprocess.Popen[bytes]") -> None:
    """Name a process that leads a group of its own."""
    _say(f"{process.pid}\n")


def has_ended(process: "subprocess.Popen[bytes]") -> None:
    """Take it back: its number may soon be somebody else's."""
    _say(f"-{process.pid}\n")


def _say(line: str) -> None:
    pipe = _watcher().stdin
    assert pipe is not None
    pipe.write(line.encode())
    pipe.flush()


@cache
def _watcher() -> "subprocess.Popen[bytes]":
    return subprocess.Popen(
        [sys.executable, __file__], stdin=subprocess.PIPE, start_new_session=True
    )


def kill_what_is_left(lines: Iterable[str]) -> None:
    """Read until the end, then kill."""
    groups: set[int] = set()
    for line in lines:
        number = int(line)
        if number > 0:
            groups.add(number)
        else:
            groups.discard(-number)
    for group in groups:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(group, signal.SIGKILL)


if __name__ == "__main__":
    kill_what_is_left(sys.stdin)
