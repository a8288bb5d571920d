"""`downrange demo`: server, router, console and virtual machines on this computer, ready to throw."""

import os
import random
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import httpx

from cli.calibrate import run as calibrate_machine
from machine.errors import UsageError
from machine.site.files import SITE
from machine.site.objects import SiteKind, SiteObject
from server.accounts.accounts import FIRST_LOGIN_FILE
from server.serve import open_socket

DEMO_SITE = (
    SiteObject(
        name="truck bed",
        kind=SiteKind.BOX,
        x_m=7.4,
        y_m=5.6,
        turn_rad=-0.92,
        length_m=4.4,
        width_m=2.4,
        height_m=1.2,
    ),
    SiteObject(
        name="pit",
        kind=SiteKind.PIT,
        x_m=8.3,
        y_m=-3.2,
        turn_rad=-0.37,
        length_m=2.4,
        width_m=2.4,
        height_m=0.8,
    ),
)
"""What a newcomer can throw at beside the ground; a truck's bed across the throw, 9.3 m away."""
READY_TIMEOUT_S = 300.0
"""Of a server or machine at its start, on a busy computer."""
STOP_TIMEOUT_S = 8.0
RESTART_PAUSE_S = 1.0
GIVEN_PORTS = range(20_000, 32_000)
"""Free ports are taken from here: Linux gives ports from 32768 on to connections."""
MACHINE_DISTANCE_M = 30.0
"""Between machines on the map: none reaches another's ground."""
MOST_MACHINES = 9
"""Each takes about a third of a core."""


@dataclass
class Child:
    """One process of the demo, with its log file."""

    name: str
    command: list[str]
    environment: dict[str, str]
    log: IO[bytes]
    process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start it, or start it again; a Ctrl-C of the terminal reaches only us."""
        self.process = subprocess.Popen(
            self.command,
            env=self.environment,
            stdin=subprocess.DEVNULL,
            stdout=self.log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )

    def has_ended(self) -> bool:
        """Whether it has been started and is no longer there."""
        return self.process is not None and self.process.poll() is not None

    def stop(self) -> None:
        """Ask it to end, and end it if it does not."""
        if self.process is None or self.process.poll() is not None:
            return
        self.process.terminate()
        try:
            self.process.wait(STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()


def _held_port() -> socket.socket:
    """A free port below those that the system gives away, held for a server that takes it a minute later.

    Nobody else can bind it meanwhile but who asks to share the address, as servers do that restart.
    """
    for port in random.sample(GIVEN_PORTS, 100):
        held = socket.socket()
        try:
            held.bind(("127.0.0.1", port))
        except OSError:
            held.close()
            continue
        held.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        return held
    raise UsageError("100 ports between 20000 and 32000 are taken; name one with --port")


def _child(name: str, data: Path, arguments: list[str], environment: dict[str, str]) -> Child:
    folder = data / "logs"
    folder.mkdir(parents=True, exist_ok=True)
    return Child(
        name,
        [sys.executable, "-m", "cli.main", *arguments],
        {**os.environ, **environment, "PYTHONUNBUFFERED": "1"},
        (folder / f"{name}.log").open("ab"),
    )


def _log_tail(data: Path, name: str) -> str:
    text = (data / "logs" / f"{name}.log").read_text(encoding="utf-8", errors="replace")
    return "\n".join(text.splitlines()[-12:])


def _wait_for(server: Child, data: Path, what: str, is_there: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + READY_TIMEOUT_S
    while not is_there():
        if server.has_ended():
            raise UsageError(
                f"the server ended at its start; its log says:\n{_log_tail(data, 'server')}"
            )
        if time.monotonic() > deadline_s:
            raise UsageError(
                f"{what} did not come up within {READY_TIMEOUT_S:.0f} s; see {data / 'logs'}"
            )
        time.sleep(0.1)


def _connected_count(health_url: str) -> int:
    """Machines that the server sees; -1 while it does not answer."""
    try:
        answer = httpx.get(health_url, timeout=1.0)
        return int(answer.json()["connected_count"]) if answer.status_code == 200 else -1
    except (httpx.HTTPError, ValueError, KeyError):
        return -1


@dataclass(frozen=True)
class DemoSetup:
    """Folders and ports of the demo."""

    data: Path
    policies: Path
    port: int
    link_port: int

    @property
    def machines(self) -> Path:
        """Folder of passwords, profiles, calibrations and sites."""
        return self.data / "machines"


def _server(setup: DemoSetup) -> Child:
    return _child(
        "server",
        setup.data,
        [
            *("server", "--host", "127.0.0.1", "--port", str(setup.port)),
            *("--data", str(setup.data), "--policies", str(setup.policies)),
        ],
        {
            "DOWNRANGE_LINK_LISTEN": f"tcp/127.0.0.1:{setup.link_port}",
            "DOWNRANGE_DATABASE_UPGRADE": "1",
        },
    )


def _machine(setup: DemoSetup, machine_id: str, unit_seed: int) -> Child:
    own = setup.machines / machine_id
    arguments = [
        *("machine", "--driver", "virtual"),
        *("--machine-id", machine_id, "--unit-seed", str(unit_seed)),
        *("--connect", f"tcp/127.0.0.1:{setup.link_port}", "--data", str(setup.data / machine_id)),
        *("--password-file", f"{own}.password", "--calibration", f"{own}.calibration.json"),
        *("--policies", str(setup.policies), "--server-url", f"http://127.0.0.1:{setup.port}"),
    ]
    return _child(machine_id, setup.data, arguments, {})


def _measure(setup: DemoSetup, machine_id: str, unit_seed: int) -> bool:
    """Commission a virtual machine that is new here, and put the demo's objects around it.

    Returns:
        Whether it is new.
    """
    if (setup.machines / f"{machine_id}.profile.json").is_file():
        return False
    print(f"== first start: measuring the virtual machine {machine_id}", flush=True)
    calibrate_machine(
        out=setup.machines, unit_seed=unit_seed, machine_id=machine_id, policies=setup.policies
    )
    site = SITE.dump_json(DEMO_SITE, indent=2)
    (setup.machines / f"{machine_id}.site.json").write_bytes(site)
    return True


def place_on_map(setup: DemoSetup, machine_ids: list[str]) -> None:
    """Put machines that are new here on the map of the yard, side by side."""
    logins = (setup.data / FIRST_LOGIN_FILE).read_text(encoding="utf-8").split()
    passwords = dict(zip(logins[::2], logins[1::2], strict=True))
    url = f"http://127.0.0.1:{setup.port}"
    headers = {"Origin": url, "X-Requested-With": "downrange"}
    with httpx.Client(base_url=f"{url}/api/v1", headers=headers, timeout=10.0) as client:
        body = {"username": "admin", "password": passwords["admin"]}
        if client.post("/auth/login", json=body).status_code != 200:
            return  # somebody has changed the password: they place machines themselves
        for machine_id in machine_ids:
            place = {"x_m": MACHINE_DISTANCE_M * (int(machine_id[1:]) - 1), "y_m": 0.0}
            client.put(f"/machines/{machine_id}/place", json=place).raise_for_status()
        client.post("/auth/logout")


def _watch(server: Child, machines: list[Child], data: Path) -> int:
    """Run until the server ends; a machine that ends is started again, as its supervisor would."""
    while True:
        time.sleep(0.3)
        if server.has_ended():
            print(f"the server ended; its log says:\n{_log_tail(data, 'server')}", file=sys.stderr)
            return 1
        for machine in machines:
            if machine.has_ended():
                print(f"{machine.name} ended; starting it again", file=sys.stderr, flush=True)
                time.sleep(RESTART_PAUSE_S)
                machine.start()


def run(
    *,
    port: int = 8000,
    data: Path = Path("data"),
    policies: Path = Path("policies"),
    unit_seed: int = 0,
    machines: int = 1,
) -> int:
    """Run everything on this computer and print the address and the login; Ctrl-C ends it.

    The first start measures the virtual machines' valves and response, as one would on new machines.

    Args:
        port: of the console; 0 takes a free one.
        data: folder of database, throw logs, secrets and logs; kept between runs.
        policies: folder of policy versions.
        unit_seed: which machine of its kind the first virtual machine is; 0 is the nominal one.
        machines: how many virtual machines, 1 to 9: m001, m002 ...; each is another of its kind.

    Raises:
        UsageError: a count outside its range, a taken port, or a part that does not come up.
    """
    if not 1 <= machines <= MOST_MACHINES:
        raise UsageError(
            f"--machines is {machines}; it runs 1 to {MOST_MACHINES}, each on about a third of a core."
        )
    own, link = open_socket("127.0.0.1", port) if port else _held_port(), _held_port()
    port, link_port = (int(held.getsockname()[1]) for held in (own, link))
    setup = DemoSetup(data.resolve(), policies.resolve(), port, link_port)
    units = {f"m{number + 1:03d}": unit_seed + number for number in range(machines)}
    signal.signal(signal.SIGTERM, lambda *_: (_ for _ in ()).throw(KeyboardInterrupt()))
    children: list[Child] = []
    try:
        new = [name for name, unit in units.items() if _measure(setup, name, unit)]
        server = _server(setup)
        children = [_machine(setup, machine_id, unit) for machine_id, unit in units.items()]
        print("== starting the server", flush=True)
        server.start()
        children.append(server)
        passwords = [setup.machines / f"{machine_id}.password" for machine_id in units]
        _wait_for(
            server,
            setup.data,
            "the machines' accounts",
            lambda: all(p.is_file() for p in passwords),
        )
        names = " ".join(units)
        print(f"== starting the virtual machine{'s' if machines > 1 else ''} {names}", flush=True)
        for child in children[:-1]:
            child.start()
        health_url = f"http://127.0.0.1:{port}/api/v1/health"
        _wait_for(server, setup.data, names, lambda: _connected_count(health_url) >= machines)
        if new:
            place_on_map(setup, new)
        print(f"\nDownrange is at http://127.0.0.1:{port}\n")
        print((setup.data / FIRST_LOGIN_FILE).read_text(encoding="utf-8").strip())
        print(f"\nlogs: {setup.data / 'logs'}   Ctrl-C ends it", flush=True)
        return _watch(server, children[:-1], setup.data)
    except KeyboardInterrupt:
        print("\nThe demo has ended. `make demo` starts it again with the same data.", flush=True)
        return 0
    finally:
        for child in children:
            child.stop()
        own.close()
        link.close()
