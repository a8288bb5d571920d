"""One server with many machines and browsers: age of what the browsers get, processor time and memory.

    python -m benchmarks.fleet_scale [--machines 100] [--browsers 10] [--duration-s 600] [--json FILE]

Machines are Zenoh sessions of their own that publish states and joints as the link process of a machine does.
Browsers are event streams over WebSockets, each of which watches another machine. The server is
`downrange server` in a process of its own. Age: from the machine's clock in a state to its arrival at a
browser; all run on one computer and so on one clock. Processor time and memory are the server process's.
"""

import asyncio
import json as json_module
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

import httpx
import tyro
import zenoh
from websockets.asyncio.client import connect

from benchmarks.result_file import RESULTS, describe, percentile, row, write_result
from machine.channels import machine_key
from machine.messages import PROTOCOL_VERSION, CheckResult, JointStream, MachineState, ThrowState
from machine.spec import load_spec
from machine.starts import safe_pose
from runtime.link.zenoh_config import client_config
from server.accounts.accounts import COOKIE, FIRST_LOGIN_FILE
from server.machines.machine_registry import SECRETS_FOLDER
from server.settings import CHECKOUT
from tests.ports import free_port
from tests.waiting import wait_for

SITE = "yard"
MACHINES_A_PROCESS = 25
WARM_UP_S = 10.0
SAMPLE_PERIOD_S = 1.0
CHECK_COUNT = 14
"""As many as a machine of `downrange machine` has."""
START_TIMEOUT_S = 180.0


@dataclass(frozen=True, slots=True)
class Load:
    """What runs against the server."""

    machines: int = 100
    browsers: int = 10
    state_hz: float = 20.0
    joints_hz: float = 25.0
    duration_s: float = 600.0


class Publisher:
    """Link of one machine; its messages are made once and get their time when they are sent."""

    def __init__(self, endpoint: str, machine_id: str, password: str) -> None:
        self._session = zenoh.open(
            client_config(connect=(endpoint,), user=machine_id, password=password)
        )
        self._texts = {"state": _state_text(machine_id), "joints": _joints_text(machine_id)}
        self._publishers = {
            name: self._session.declare_publisher(machine_key(SITE, machine_id, name))
            for name in self._texts
        }
        self._token = self._session.liveliness().declare_token(
            machine_key(SITE, machine_id, "alive")
        )

    def put(self, name: str) -> None:
        """Send one message."""
        now = f'"t_mono_ns":{time.monotonic_ns()}'
        self._publishers[name].put(self._texts[name].replace('"t_mono_ns":0', now, 1))


def _state_text(machine_id: str) -> str:
    checks = tuple(
        CheckResult(
            check_id=f"check-{index}",
            passed=True,
            severity="info",
            text=f"Check {index}: in order, 0.012 of 0.050 m",
        )
        for index in range(CHECK_COUNT)
    )
    state = MachineState(
        machine_id=machine_id,
        boot_id=f"boot-{machine_id}",
        t_mono_ns=0,
        state=ThrowState.DISARMED,
        epoch_count=0,
        joint_position_rad_m=_pose(),
        payload_held=True,
        stop_latched=False,
        checks=checks,
        model_sha256=load_spec().sha256,
        policy_sha256={"2d": "a" * 64, "3d": "b" * 64},
        calibration_sha256="c" * 64,
        zones_sha256="",
        software="benchmark",
        protocol_version=PROTOCOL_VERSION,
    )
    return state.model_dump_json()


def _joints_text(machine_id: str) -> str:
    joints = JointStream(
        machine_id=machine_id,
        t_mono_ns=0,
        joint_position_rad_m=_pose(),
        joint_velocity_rad_m_per_s=(0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        state=ThrowState.DISARMED,
        payload_held=True,
    )
    return joints.model_dump_json()


def _pose() -> tuple[float, float, float, float, float, float]:
    a, b, c, d, e, f = (float(value) for value in safe_pose())
    return a, b, c, d, e, f


def publish(endpoint: str, passwords: dict[str, str], load: Load, pipe: Connection) -> None:
    """Process of some machines: all messages evenly over time, until the pipe says so."""
    machines = [Publisher(endpoint, name, password) for name, password in passwords.items()]
    pipe.send("up")
    began_s = time.monotonic()
    # (next time, period, machine, channel); a list of some hundred is searched in no time.
    due: list[tuple[float, float, int, str]] = []
    for number in range(len(machines)):
        for name, rate_hz in (("state", load.state_hz), ("joints", load.joints_hz)):
            if rate_hz > 0.0:
                first_s = began_s + number / len(machines) / rate_hz
                due.append((first_s, 1.0 / rate_hz, number, name))
    due.sort()
    while not pipe.poll():
        at_s, period_s, number, name = due.pop(0)
        time.sleep(max(at_s - time.monotonic(), 0.0))
        machines[number].put(name)
        due.append((at_s + period_s, period_s, number, name))
        due.sort()


def listen(url: str, cookie: str, watched: list[str], duration_s: float, pipe: Connection) -> None:
    """Process of the browsers: sends the ages of what they got, s, watched and other machines apart."""
    pipe.send(asyncio.run(_listen(url, cookie, watched, duration_s)))


async def _listen(
    url: str, cookie: str, watched: list[str], duration_s: float
) -> tuple[list[float], list[float]]:
    ages: tuple[list[float], list[float]] = ([], [])
    from_s = time.monotonic() + WARM_UP_S
    end_s = from_s + duration_s

    async def browse(machine_id: str) -> None:
        address = f"{url.replace('http', 'ws')}/api/v1/events/socket?machine_id={machine_id}"
        headers = {"Origin": url, "Cookie": f"{COOKIE}={cookie}"}
        async with connect(address, additional_headers=headers, max_size=None) as socket:
            while time.monotonic() < end_s:
                text = await asyncio.wait_for(socket.recv(), 10.0)
                now_ns = time.monotonic_ns()
                for event in json_module.loads(text):
                    state = event["kind"] == "machine.state" and event["machine"]["state"]
                    if state and now_ns * 1e-9 >= from_s:
                        is_other = event["machine"]["machine_id"] != machine_id
                        ages[is_other].append((now_ns - state["t_mono_ns"]) * 1e-9)

    await asyncio.gather(*(browse(machine_id) for machine_id in watched))
    return ages


@contextmanager
def running(data: Path, machines: int) -> Generator[tuple[subprocess.Popen[bytes], str, str]]:
    """`downrange server`: process, address of the console and of the link."""
    port, link = free_port(), f"tcp/127.0.0.1:{free_port()}"
    environment = {
        **os.environ,
        "DOWNRANGE_LINK_LISTEN": link,
        "DOWNRANGE_MACHINE_SLOT_COUNT": str(machines),
        "DOWNRANGE_DATABASE_UPGRADE": "1",
    }
    log = data / "server.log"
    with log.open("wb") as output:
        process = subprocess.Popen(
            [sys.executable, "-m", "cli.main", "server", "--port", str(port), "--data", str(data)],
            cwd=CHECKOUT,
            env=environment,
            stdout=output,
            stderr=output,
        )
    try:
        wait_for(lambda: "Downrange answers" in log.read_text(), START_TIMEOUT_S)
        yield process, f"http://127.0.0.1:{port}", link
    finally:
        process.terminate()
        process.wait(60.0)


def sign_in(url: str, data: Path) -> str:
    """A session's cookie."""
    line = (data / FIRST_LOGIN_FILE).read_text(encoding="utf-8").splitlines()[0]
    username, password = line.split()
    reply = httpx.post(
        f"{url}/api/v1/auth/login",
        json={"username": username, "password": password},
        headers={"Origin": url, "X-Requested-With": "downrange"},
        timeout=60.0,
    )
    reply.raise_for_status()
    return reply.cookies[COOKIE]


def processor_s(pid: int) -> float:
    """Processor time of a process with all its threads, s."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def memory_mb(pid: int) -> float:
    """Resident memory of a process, MB."""
    for line in Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1]) / 1000.0
    return 0.0


def measure(load: Load, data: Path) -> dict[str, float]:
    """Run it once; values of the result's row."""
    context = multiprocessing.get_context("spawn")
    with running(data, load.machines) as (server, url, link):
        cookie = sign_in(url, data)
        ids = [f"m{index:03d}" for index in range(1, load.machines + 1)]
        passwords = {
            name: (data / SECRETS_FOLDER / f"{name}.password").read_text().strip() for name in ids
        }
        pipes: list[Connection] = []
        for first in range(0, load.machines, MACHINES_A_PROCESS):
            part = {name: passwords[name] for name in ids[first : first + MACHINES_A_PROCESS]}
            ours, theirs = context.Pipe()
            context.Process(target=publish, args=(link, part, load, theirs), daemon=True).start()
            pipes.append(ours)
        for pipe in pipes:
            pipe.recv()
        ours, theirs = context.Pipe()
        watched = [ids[index % len(ids)] for index in range(load.browsers)]
        arguments = (url, cookie, watched, load.duration_s, theirs)
        context.Process(target=listen, args=arguments, daemon=True).start()
        time.sleep(WARM_UP_S)
        began_s, used_s = time.monotonic(), processor_s(server.pid)
        memory: list[float] = []
        while not ours.poll(SAMPLE_PERIOD_S):
            memory.append(memory_mb(server.pid))
        share = (processor_s(server.pid) - used_s) / (time.monotonic() - began_s)
        ages_s = ours.recv()
        for pipe in pipes:
            pipe.send("end")
    tenth = max(len(memory) // 10, 1)
    values: dict[str, float] = {"core_share": share}
    values["memory_mb"] = sum(memory[-tenth:]) / tenth
    values["memory_growth_mb"] = values["memory_mb"] - sum(memory[:tenth]) / tenth
    for name, ages in zip(("watched", "other"), ages_s, strict=True):
        values[f"{name}_per_s"] = len(ages) / load.duration_s / load.browsers
        for percent in (50, 99):
            values[f"{name}_age_p{percent}_s"] = percentile(ages, percent).value or 0.0
        values[f"{name}_age_max_s"] = max(ages, default=0.0)
    return values


def main(load: tyro.conf.OmitArgPrefixes[Load], json: Path = RESULTS / "fleet_scale.json") -> None:
    """Measure and write the result.

    Args:
        load: what runs against the server.
        json: where the result is written.
    """
    with tempfile.TemporaryDirectory() as folder:
        values = measure(load, Path(folder))
    for name, value in values.items():
        print(f"{name:<24}{value:>10.4f}")
    labels = {
        "machines": load.machines,
        "browsers": load.browsers,
        "states": f"{load.state_hz:g} Hz",
        "joints": f"{load.joints_hz:g} Hz",
    }
    rows = [row(int(load.duration_s), labels, values)]
    title = "One server with a fleet: age of states at browsers, share of a core, memory"
    print(write_result(describe("fleet_scale", title, rows, seed=None), json))


if __name__ == "__main__":
    tyro.cli(main)
