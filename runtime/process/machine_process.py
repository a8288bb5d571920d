"""The supervisor: starts the control and the link process of one machine, and starts again what dies.

It touches neither hardware nor network. Control dead: the link says so, and a new control process begins
STOPPED. Link dead: control lets go before the commit point, completes after it, and gets a new link. One that
hangs is killed (hang_watch.py says after what time), then the same.
"""

import fcntl
import json
import logging
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Final

from machine.errors import DownrangeError, UsageError
from runtime.link.ipc import packet_pair
from runtime.process.alive_counter import AliveCounter, process_state
from runtime.process.hang_watch import CONTROL_LIMITS, LINK_LIMITS, HangWatch
from runtime.process.machine_settings import MachineSettings
from runtime.process.supervisor_connection import MESSAGE_LIMIT_BYTES, hand_port

logger = logging.getLogger(__name__)

START_LIMIT_S: Final = 60.0
"""Loading policies and a simulated plant takes a few seconds on a slow computer."""
RESTART_MIN_S: Final = 0.2
RESTART_MAX_S: Final = 10.0
STABLE_S: Final = 30.0
"""A child that has lived so long is started again without delay when it dies."""
END_LIMIT_S: Final = 75.0
"""Control ends within a minute of a throw's commit; then nobody waits any longer."""
LOCK_LIMIT_S: Final = 5.0
POLL_S: Final = 0.02


class StartError(DownrangeError):
    """A process of the machine could not start."""

    code = "start"


@dataclass(slots=True)
class _Child:
    name: str
    module: str
    alive: AliveCounter
    watch: HangWatch
    inherited: tuple[int, ...] = ()
    process: subprocess.Popen[bytes] | None = None
    connection: socket.socket | None = None
    started_s: float = 0.0
    delay_s: float = RESTART_MIN_S
    due_s: float = 0.0
    is_ready: bool = False

    def is_running(self) -> bool:
        return self.process is not None and self.process.poll() is None

    def cut(self) -> None:
        if self.connection is not None:
            self.connection.close()
            self.connection = None


class MachineProcess:
    """Both children of one machine."""

    def __init__(self, settings: MachineSettings) -> None:
        self._settings = settings
        self._is_stopping = False
        self._lock = _take_lock(settings)
        # The lock lives as long as any control process does, even one whose supervisor was killed.
        self._control = _Child(
            "control",
            "runtime.process.control_process",
            AliveCounter(),
            HangWatch(CONTROL_LIMITS),
            inherited=(self._lock,),
        )
        self._link = _Child(
            "link", "runtime.process.link_process", AliveCounter(), HangWatch(LINK_LIMITS)
        )

    def stop(self) -> None:
        """End in order; from a signal handler or another thread."""
        self._is_stopping = True

    def run(self) -> None:
        """Until `stop` is called.

        Raises:
            StartError: a process could not start for the first time.
        """
        try:
            for child in (self._control, self._link):
                self._start(child)
            for child in (self._control, self._link):
                _wait_ready(child)
            self._join()
            logger.info("machine %s is up", self._settings.machine_id)
            while not self._is_stopping:
                for child in (self._control, self._link):
                    self._look_after(child)
                    _end_hung(child)
                time.sleep(POLL_S)
        finally:
            self._end()
            for child in (self._control, self._link):
                child.alive.close()
            os.close(self._lock)

    def _start(self, child: _Child) -> None:
        mine, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        alive = child.alive.descriptor
        with theirs:
            child.process = subprocess.Popen(
                [sys.executable, "-m", child.module, str(theirs.fileno()), str(alive)],
                pass_fds=(theirs.fileno(), alive, *child.inherited),
                stdin=subprocess.DEVNULL,
            )
        mine.send(self._settings.model_dump_json().encode())
        mine.setblocking(False)
        child.connection, child.started_s, child.is_ready = mine, time.monotonic(), False

    def _join(self) -> None:
        """Give both children a new socket to each other."""
        if self._control.connection is None or self._link.connection is None:
            return
        for_control, for_link = packet_pair()
        try:
            hand_port(self._link.connection, for_link)
            hand_port(self._control.connection, for_control)
        except OSError as error:
            # One of them is dying; the next look finds it dead, starts it and joins them again.
            logger.info("the processes could not be joined: %s", error)
        finally:
            for_control.close()
            for_link.close()

    def _look_after(self, child: _Child) -> None:
        now_s = time.monotonic()
        if child.is_running():
            if not child.is_ready and (message := _hear(child)) is not None:
                if "error" in message:
                    logger.error("%s: %s", child.name, message["error"])
                else:
                    child.is_ready = True
                    self._join()
            return
        if child.due_s == 0.0:
            code = None if child.process is None else child.process.returncode
            lived_s = now_s - child.started_s
            child.delay_s = (
                RESTART_MIN_S if lived_s > STABLE_S else min(child.delay_s * 2, RESTART_MAX_S)
            )
            child.due_s = now_s + child.delay_s
            logger.error(
                "%s process ended with %s after %.1f s; started again in %.1f s",
                child.name,
                code,
                lived_s,
                child.delay_s,
            )
            child.cut()
        elif now_s >= child.due_s:
            child.due_s = 0.0
            self._start(child)

    def _end(self) -> None:
        children = (self._control, self._link)
        for child in children:
            child.cut()
        end_s = time.monotonic() + END_LIMIT_S
        for child in children:
            if child.process is None:
                continue
            try:
                child.process.wait(max(end_s - time.monotonic(), 0.1))
            except subprocess.TimeoutExpired:
                logger.error("%s process does not end; killed", child.name)
                child.process.kill()
                child.process.wait()


@contextmanager
def machine_lock(settings: MachineSettings) -> Generator[None]:
    """Hold a machine's folder, so that no process of the machine starts meanwhile.

    Raises:
        UsageError: one runs.
    """
    descriptor = _take_lock(settings)
    try:
        yield
    finally:
        os.close(descriptor)


def _take_lock(settings: MachineSettings) -> int:
    settings.data_dir.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(settings.lock_file, os.O_RDWR | os.O_CREAT, 0o600)
    end_s = time.monotonic() + LOCK_LIMIT_S
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return descriptor
        except BlockingIOError:
            if time.monotonic() >= end_s:
                os.close(descriptor)
                raise UsageError(
                    f"another process of machine {settings.machine_id} runs on {settings.data_dir}; "
                    "stop it, or wait until it has finished its throw"
                ) from None
            time.sleep(POLL_S)


def _end_hung(child: _Child) -> None:
    """Kill a process that hangs; it is started again."""
    process = child.process
    if process is None or not child.is_ready:
        return
    state, used_s = process_state(process.pid)
    reason = child.watch.look(child.alive.value, state, used_s, time.monotonic())
    if reason and process.poll() is None:
        logger.error("the %s process hangs (%s); killed", child.name, reason)
        process.kill()
        process.wait()


def _hear(child: _Child) -> dict[str, Any] | None:
    if child.connection is None:
        return None
    try:
        data = child.connection.recv(MESSAGE_LIMIT_BYTES)
    except BlockingIOError:
        return None
    except OSError:
        return None
    return json.loads(data) if data else None


def _wait_ready(child: _Child) -> None:
    end_s = time.monotonic() + START_LIMIT_S
    while time.monotonic() < end_s:
        message = _hear(child)
        if message is not None and "error" in message:
            raise StartError(str(message["error"]))
        if message is not None:
            child.is_ready = True
            return
        if not child.is_running():
            code = None if child.process is None else child.process.returncode
            raise StartError(f"the {child.name} process ended with {code}; its last lines say why")
        time.sleep(0.01)
    raise StartError(f"the {child.name} process was not ready within {START_LIMIT_S:.0f} s")


def run_machine(settings: MachineSettings) -> None:
    """Run a machine until SIGINT or SIGTERM.

    Raises:
        UsageError: the data folder is in use.
        StartError: a process could not start.
    """
    machine = MachineProcess(settings)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: machine.stop())
    machine.run()
