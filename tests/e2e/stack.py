"""The product as a user starts it: `downrange demo` or `downrange server` as processes of their own."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest

from tests.leftovers import end_with_run, has_ended
from tests.ports import free_port

ROOT = Path(__file__).resolve().parents[2]
CONSOLE = ROOT / "web" / "dist" / "index.html"


@dataclass
class Stack:
    """A running product and who may sign in."""

    url: str
    passwords: dict[str, str]


class Command:
    """A `downrange` verb in a process group of its own, its output in a file."""

    def __init__(self, log: Path, *arguments: str, **environment: str) -> None:
        if not CONSOLE.is_file():
            pytest.fail(f"{CONSOLE} is missing; build the console first: make web")
        self._log = log
        with log.open("ab") as output:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "cli.main", *arguments],
                cwd=ROOT,
                env={**os.environ, **environment, "PYTHONUNBUFFERED": "1"},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        end_with_run(self._process)

    def wait_for(self, pattern: str, timeout_s: float) -> re.Match[str]:
        """Wait for a line of its output."""
        end_s = time.monotonic() + timeout_s
        output = ""
        while time.monotonic() < end_s:
            output = self._log.read_text(encoding="utf-8", errors="replace")
            found = re.search(pattern, output)
            if found:
                return found
            if self._process.poll() is not None:
                break
            time.sleep(0.1)
        raise AssertionError(f"no {pattern!r} within {timeout_s} s; it said:\n{output}")

    def kill(self) -> None:
        """As a power cut would: the whole group at once."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait(30.0)
        has_ended(self._process)

    def stop(self) -> None:
        """Ask it to end."""
        if self._process.poll() is None:
            self._process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(30.0)
        self.kill()


def logins(data: Path) -> dict[str, str]:
    """Names and passwords that the first start made."""
    lines = (data / "demo-login.txt").read_text(encoding="utf-8").split("\n")
    return dict(line.split() for line in lines if line.strip())


class Demo:
    """`downrange demo`: server, router, console, virtual machines; it starts while others go on."""

    def __init__(self, data: Path, machine_count: int = 1) -> None:
        self._data = data
        self._machine_count = machine_count
        self._starts_count = 0
        self._command: Command | None = None

    @property
    def machines(self) -> Path:
        """Folder of the machines' profiles and calibrations."""
        return self._data / "machines"

    def start(self) -> None:
        """Start it unless it runs; a demo that was stopped starts with its data, at another address."""
        if self._command is not None:
            return
        self._starts_count += 1
        self._command = Command(
            self._data / f"demo-{self._starts_count}.log",
            *("demo", "--port", "0", "--data", str(self._data)),
            *("--machines", str(self._machine_count)),
            # The browser of these tests draws without graphics hardware.
            DOWNRANGE_VIEW_SHADOWS="0",
        )

    def ready(self) -> Stack:
        """Wait until it can be used."""
        assert self._command is not None, "it is not started"
        url = self._command.wait_for(r"Downrange is at (http://\S+)", 500.0).group(1)
        return Stack(url, logins(self._data))

    def stop(self) -> None:
        if self._command is not None:
            self._command.stop()
            self._command = None


@contextlib.contextmanager
def running_demo(data: Path, machine_count: int = 1) -> Iterator[Stack]:
    """A demo of one's own."""
    demo = Demo(data, machine_count)
    demo.start()
    try:
        yield demo.ready()
    finally:
        demo.stop()


class ServerAlone:
    """`downrange server` without a machine, on one address through its restarts."""

    def __init__(self, data: Path) -> None:
        self.data = data
        self._starts_count = 0
        self.port, self._link = free_port(), free_port()
        self._command: Command | None = None

    def start(self) -> Stack:
        self._starts_count += 1
        self._command = Command(
            self.data / f"server-{self._starts_count}.log",
            *("server", "--port", str(self.port), "--data", str(self.data)),
            DOWNRANGE_LINK_LISTEN=f"tcp/127.0.0.1:{self._link}",
            DOWNRANGE_DATABASE_UPGRADE="1",
        )
        self._command.wait_for("Downrange answers at", 120.0)
        return Stack(f"http://127.0.0.1:{self.port}", logins(self.data))

    def machine(self, machine_id: str = "m001") -> Command:
        """A virtual machine that calls in at this server; the caller ends it."""
        return Command(
            self.data / f"{machine_id}.log",
            *("machine", "--driver", "virtual", "--machine-id", machine_id),
            *("--connect", f"tcp/127.0.0.1:{self._link}", "--data", str(self.data / machine_id)),
            *("--password-file", str(self.data / "machines" / f"{machine_id}.password")),
            *("--server-url", f"http://127.0.0.1:{self.port}"),
        )

    def enrolled(self, command: str) -> Command:
        """A computer that is set up by the command of the page; the caller ends it."""
        words = command.split()
        folder = words[words.index("--data") + 1]
        words[-1] = str(self.data / folder)
        return Command(self.data / f"{folder}-enrol.log", *words[1:])

    def started(self, folder: str) -> Command:
        """The machine that was set up in a folder; the caller ends it."""
        data = self.data / folder
        return Command(self.data / f"{folder}.log", "machine", "--data", str(data))

    def kill(self) -> None:
        if self._command is not None:
            self._command.kill()
            self._command = None


@contextlib.contextmanager
def client(stack: Stack, username: str) -> Iterator[httpx.Client]:
    """A signed-in client of the HTTP interface, beside the browser."""
    with httpx.Client(
        base_url=f"{stack.url}/api/v1",
        headers={"Origin": stack.url, "X-Requested-With": "downrange"},
        timeout=30.0,
    ) as opened:
        body = {"username": username, "password": stack.passwords[username]}
        opened.post("/auth/login", json=body).raise_for_status()
        yield opened
