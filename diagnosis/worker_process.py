"""A worker process that does half of a list of tasks: a diagnosis may count on two cores.

The worker holds one value that all tasks share, so that it is sent once. When the worker is gone, the calling
process does all tasks itself.

It is a plain subprocess on a socket. The server runs a diagnosis in a daemonic process, and `multiprocessing`
lets such a process have no children; a worker of loky or of `concurrent.futures` would also outlive a parent
that is killed. This one ends when its socket closes.
"""

import os
import pickle
import socket
import subprocess
import sys
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

Work = Callable[..., Any]
"""A function at the top level of a module; it is called with the held value, the items and more arguments."""
EXIT_TIMEOUT_S = 2.0
"""The worker is killed when it does not exit within this time."""
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
"""As in the calling process (threads.py)."""
CONNECTION_ERRORS = (EOFError, OSError, pickle.PickleError)


class WorkerProcess:
    """Runs half of the tasks beside the calling process. Close it when the work is done."""

    def __init__(self) -> None:
        ours, theirs = socket.socketpair()
        command = [sys.executable, "-m", "diagnosis.worker_process", str(theirs.fileno())]
        self._process = subprocess.Popen(
            command, pass_fds=[theirs.fileno()], env={**os.environ, **ONE_THREAD}
        )
        theirs.close()
        self._connection = Connection(ours.detach())
        self._is_usable = True

    @property
    def is_running(self) -> bool:
        """Whether the process runs."""
        return self._process.poll() is None

    def close(self) -> None:
        """End the process, whatever it does."""
        self._is_usable = False
        self._connection.close()
        self._process.terminate()
        try:
            self._process.wait(EXIT_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def preload(self, work: Work) -> None:
        """Let the worker import the module of a function before the first task needs it."""
        self._send(("preload", work))

    def hold(self, value: Any) -> None:
        """Send the value that all later tasks share."""
        self._send(("hold", value))

    def split(self, work: Work, value: Any, items: list[Any], *more: Any) -> list[Any]:
        """Results of ``work(value, items, *more)``, one per item; each process computes half of them."""
        ours, theirs = items[::2], items[1::2]
        self._send((work, theirs, more))
        results: list[Any] = [None] * len(items)
        try:
            results[::2] = work(value, ours, *more)
        except BaseException:
            # A late answer of the worker would be taken for that of the next call.
            self.close()
            raise
        results[1::2] = self._receive() or work(value, theirs, *more)
        return results

    def _send(self, message: Any) -> None:
        if self._is_usable:
            try:
                self._connection.send(message)
            except CONNECTION_ERRORS:
                self._is_usable = False

    def _receive(self) -> list[Any]:
        """The worker's results; empty when the worker is gone or its work raised an error."""
        if not self._is_usable:
            return []
        try:
            results: list[Any] = self._connection.recv()
        except CONNECTION_ERRORS:
            self._is_usable = False
            return []
        return results


def serve(connection: Connection) -> None:
    """Answer messages until the other end closes."""
    value: Any = None
    while True:
        try:
            first, *rest = connection.recv()
            if first == "hold":
                (value,) = rest
            elif first != "preload":
                items, more = rest
                connection.send(_compute(first, value, items, more))
        except CONNECTION_ERRORS:
            return


def _compute(work: Work, value: Any, items: list[Any], more: tuple[Any, ...]) -> list[Any]:
    try:
        return list(work(value, items, *more))
    except Exception:  # the calling process repeats the work, and its error has the right trace
        return []


if __name__ == "__main__":
    serve(Connection(int(sys.argv[1])))
