"""A second process for half of the work: two cores are what a diagnosis may count on.

It holds one value, the same for all that it is asked. Whatever happens to it, the first process can do its
part as well: nothing is lost but time.
"""

import os
import pickle
import socket
import subprocess
import sys
from collections.abc import Callable
from importlib import import_module
from multiprocessing.connection import Connection
from typing import Any

Work = Callable[..., Any]
"""A function of a module, called with the value and what it is asked with."""
END_WAIT_S = 2.0
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
"""As in the first process (threads.py)."""
GONE = (EOFError, OSError, pickle.PickleError)


class SecondProcess:
    """Does half of the work, side by side with this process; to be closed when the work is done."""

    def __init__(self) -> None:
        ours, theirs = socket.socketpair()
        command = [sys.executable, "-m", "diagnosis.second_process", str(theirs.fileno())]
        # Not of multiprocessing: the server's own process for a diagnosis may have no children of that kind.
        self._process = subprocess.Popen(
            command, pass_fds=[theirs.fileno()], env={**os.environ, **ONE_THREAD}
        )
        theirs.close()
        self._pipe = Connection(ours.detach())
        self._answers = True

    @property
    def is_there(self) -> bool:
        """Whether the process runs."""
        return self._process.poll() is None

    def close(self) -> None:
        """End it, whatever it does."""
        self._answers = False
        self._pipe.close()
        self._process.terminate()
        try:
            self._process.wait(END_WAIT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def keep(self, value: Any) -> None:
        """Give it the value that all work is about."""
        self._send(("keep", value))

    def halved(self, work: Work, value: Any, items: list[Any], *more: Any) -> list[Any]:
        """Results of ``work(value, items, *more)``, one an item, half of the items done by each process."""
        mine, theirs = items[::2], items[1::2]
        self._send((work, theirs, more))
        found: list[Any] = [None] * len(items)
        try:
            found[::2] = work(value, mine, *more)
        except BaseException:
            # Its answer would be taken for that to the next question.
            self.close()
            raise
        found[1::2] = self._answer() or work(value, theirs, *more)
        return found

    def _send(self, message: Any) -> None:
        if self._answers:
            try:
                self._pipe.send(message)
            except GONE:
                self._answers = False

    def _answer(self) -> list[Any]:
        """Its results; none if it is gone, or failed where the first process will tell why."""
        if not self._answers:
            return []
        try:
            found: list[Any] = self._pipe.recv()
        except GONE:
            self._answers = False
            return []
        return found


def serve(pipe: Connection) -> None:
    """Work until the first process is done, or gone."""
    value: Any = None
    while True:
        try:
            first, *rest = pipe.recv()
            if first == "keep":
                (value,) = rest
                continue
            items, more = rest
            pipe.send(_results(first, value, items, more))
        except GONE:
            return


def _results(work: Work, value: Any, items: list[Any], more: tuple[Any, ...]) -> list[Any]:
    try:
        return list(work(value, items, *more))
    except Exception:  # the first process does it again, and its error has the right trace
        return []


if __name__ == "__main__":
    # While the first process reads logs.
    import_module("diagnosis.causes.trials")
    serve(Connection(int(sys.argv[1])))
