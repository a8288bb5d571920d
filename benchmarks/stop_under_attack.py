"""Time from a press of STOP to the machine's latch while another machine or caller attacks the server.

    python -m benchmarks.stop_under_attack [--repeats 60] [--only ATTACK ...] [--json FILE]

The server runs in a process of its own, as do the attackers; the machine that is stopped is the tests'
stand-in. The attacker has the account of machine m002 or of a person, or none. Bar: p99 at most 150 ms under
every attack.
"""

import base64
import contextlib
import json as json_module
import multiprocessing
import os
import secrets
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing.synchronize import Event
from pathlib import Path

import httpx
import tyro
import zenoh
from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from benchmarks.result_file import RESULTS, Row, describe, percentile, row, write_result
from machine.channels import machine_key
from runtime.link.zenoh_config import client_config
from tests.bulk.hostile_surveys import deflated_raster
from tests.ports import free_port
from tests.server.fake_machine import FakeMachine
from tests.server.server_bench import clear_stop, wait_for

BAR_MS = 150.0
SITE = "yard"
ATTACKER = "m002"


@dataclass(frozen=True)
class Place:
    """Where the server is, and the attacking machine's password."""

    url: str
    link: str
    password: str
    cookies: dict[str, str]
    """Of a person who is signed in: some attackers are."""

    def client(self) -> httpx.Client:
        headers = {"Origin": self.url, "X-Requested-With": "downrange"}
        return httpx.Client(
            base_url=f"{self.url}/api/v1", headers=headers, cookies=self.cookies, timeout=10.0
        )


def session_of(place: Place) -> zenoh.Session:
    return zenoh.open(client_config(connect=(place.link,), user=ATTACKER, password=place.password))


def put_states(place: Place, end: Event, payload: bytes) -> None:
    """The same state again and again, as fast as the link takes it."""
    with session_of(place) as session:
        publisher = session.declare_publisher(machine_key(SITE, ATTACKER, "state"))
        while not end.is_set():
            publisher.put(payload)


def large_states(place: Place, end: Event) -> None:
    put_states(place, end, b"[" + b"0," * (17 * 1024 * 512) + b"0]")


def many_states(place: Place, end: Event) -> None:
    put_states(place, end, b'{"machine_id":"m002","fault":"' + b"x" * 30_000 + b'"}')


def deep_states(place: Place, end: Event) -> None:
    put_states(place, end, b"[" * 30_000)


def event_batches(place: Place, end: Event) -> None:
    """Batches of the largest size, many at one time."""
    event = {
        "machine_id": ATTACKER,
        "boot_id": "b",
        "t_mono_ns": 1,
        "t_utc": "2026-01-01T00:00:00Z",
        "kind": "command_refused",
        "data": {"text": "x" * 800},
    }
    number = 0
    with session_of(place) as session:
        while not end.is_set():
            events = [event | {"sequence_count": number + k} for k in range(500)]
            number += len(events)
            batch = {"machine_id": ATTACKER, "boot_id": "b", "events": events}
            payload = json_module.dumps(batch)
            waiting = [
                session.get(machine_key(SITE, ATTACKER, "events"), payload=payload, timeout=1.0)
                for _ in range(12)
            ]
            for replies in waiting:
                for _ in replies:
                    pass


def log_uploads(place: Place, end: Event) -> None:
    """Logs of throws that do not exist, 8 MB each."""
    content = bytes(8 * 1024 * 1024)
    headers = {"Authorization": f"Bearer {place.password}", "X-Content-SHA256": "0" * 64}
    while not end.is_set():
        with contextlib.suppress(httpx.HTTPError):
            httpx.put(
                f"{place.url}/api/v1/machines/{ATTACKER}/throw-logs/none",
                content=content,
                headers=headers,
                timeout=5.0,
            )


def logins(place: Place, end: Event) -> None:
    """Guesses of passwords, each from a forged address."""
    headers = {"Origin": place.url, "X-Requested-With": "downrange"}
    number = 0
    with httpx.Client(base_url=place.url, headers=headers, timeout=5.0) as client:
        while not end.is_set():
            number += 1
            with contextlib.suppress(httpx.HTTPError):
                client.post(
                    "/api/v1/auth/login",
                    json={"username": f"u{number}", "password": "guess"},
                    headers={"X-Forwarded-For": f"10.{number % 250}.0.1"},
                )


def idle_connections(place: Place, end: Event) -> None:
    """Connections that ask for nothing, opened as fast as possible."""
    address = place.url.removeprefix("http://").split(":")
    held: list[socket.socket] = []
    while not end.is_set():
        with contextlib.suppress(OSError):
            held.append(socket.create_connection((address[0], int(address[1])), timeout=1.0))
        if len(held) > 400:
            held.pop(0).close()


def slow_stops(place: Place, end: Event) -> None:
    """Presses of STOP that never end: 100 connections send a byte of their headers now and then."""
    address = place.url.removeprefix("http://").split(":")
    begin = f"POST /api/v1/machines/m001/stop HTTP/1.1\r\nHost: {':'.join(address)}\r\nX-Slow: "
    held: list[socket.socket] = []
    while not end.is_set():
        with contextlib.suppress(OSError):
            held.append(socket.create_connection((address[0], int(address[1])), timeout=1.0))
            held[-1].sendall(begin.encode())
        if len(held) > 100:
            held.pop(0).close()
        for connection in held:
            with contextlib.suppress(OSError):
                connection.sendall(b"x")


def sockets(place: Place, end: Event) -> None:
    """As many event sockets as one person may have, each sending what nobody asked for."""
    headers = {"Cookie": "; ".join(f"{name}={value}" for name, value in place.cookies.items())}
    address = place.url.replace("http://", "ws://") + "/api/v1/events/socket"
    with contextlib.ExitStack() as stack:
        opened: list[ClientConnection] = []
        while not end.is_set():
            if len(opened) < 40:
                with contextlib.suppress(OSError, WebSocketException):
                    found = connect(address, origin=Origin(place.url), additional_headers=headers)
                    opened.append(stack.enter_context(found))
            for connection in list(opened):
                try:
                    connection.send("x" * 10_000)
                except (OSError, WebSocketException):
                    opened.remove(connection)


def hold_frames(place: Place, end: Event) -> None:
    """As many hold sockets as one person may have, each sending frames of 16 MiB."""
    headers = {"Cookie": "; ".join(f"{name}={value}" for name, value in place.cookies.items())}
    address = place.url.replace("http://", "ws://") + f"/api/v1/machines/{ATTACKER}/hold"
    text = "x" * (16 * 1024 * 1024)

    def send() -> None:
        while not end.is_set():
            with (
                contextlib.suppress(OSError, WebSocketException),
                connect(address, origin=Origin(place.url), additional_headers=headers) as opened,
            ):
                while not end.is_set():
                    opened.send(text)

    run_together(send, 16)


def slow_readers(place: Place, end: Event) -> None:
    """Event sockets that never read, while leases change hands as fast as possible."""
    headers = {"Cookie": "; ".join(f"{name}={value}" for name, value in place.cookies.items())}
    address = place.url.replace("http://", "ws://") + "/api/v1/events/socket"
    with contextlib.ExitStack() as stack:
        for _ in range(16):
            with contextlib.suppress(OSError, WebSocketException):
                found = connect(
                    address, origin=Origin(place.url), additional_headers=headers, max_queue=1
                )
                stack.enter_context(found)
        lease_grabs(place, end)


def surveys(place: Place, end: Event) -> None:
    """Surveys of 2 MB that become 2 GiB."""
    survey = base64.b64encode(deflated_raster(2 * 1024**3)).decode()
    job = {
        "name": "bomb",
        "material": "gravel",
        "grab_m3": 0.3,
        "survey": "bomb.tif",
        "work": {
            "kind": "pile",
            "foot": {"x_m": 8.0, "y_m": 0.0, "length_m": 1.0, "width_m": 1.0},
            "height_m": 0.5,
        },
    }
    body = {"machine_id": ATTACKER, "file": job, "survey_base64": survey}
    with place.client() as client:
        while not end.is_set():
            with contextlib.suppress(httpx.HTTPError):
                client.post("/jobs", json=body)


def tokens(place: Place, end: Event) -> None:
    """Guesses of enrolment tokens, by nobody in particular."""

    def guess() -> None:
        with place.client() as client:
            client.cookies.clear()
            while not end.is_set():
                with contextlib.suppress(httpx.HTTPError):
                    client.post("/enrolments/claim", json={"token": secrets.token_hex(24)})

    run_together(guess, 4)


def run_together(work: Callable[[], None], count: int) -> None:
    """Run the same in threads; returns when all have ended."""
    threads = [threading.Thread(target=work) for _ in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def queries(place: Place, end: Event) -> None:
    """Statistics, exports and comparisons with every filter, by one who is signed in."""
    paths = ("/throws/stats", "/throws/export.csv", "/throws", "/fleet", "/audit", "/policies")
    filters = {
        "operator": "%" * 64,
        "min_range_m": 0.0,
        "max_range_m": 100.0,
        "until": "9999-12-31",
    }
    with place.client() as client:
        while not end.is_set():
            for path in paths:
                with contextlib.suppress(httpx.HTTPError):
                    client.get(path, params=filters)


def lease_grabs(place: Place, end: Event) -> None:
    """The lease of the machine that is stopped, taken and given back without pause."""
    with place.client() as client:
        while not end.is_set():
            with contextlib.suppress(httpx.HTTPError):
                client.post("/machines/m001/lease/take", json={"reason": "it is mine"})
                client.delete("/machines/m001/lease")


def broken_uploads(place: Place, end: Event) -> None:
    """Uploads of versions whose parts never end, of the largest size."""
    body = b"--b\r\n" + b"A: b\r\n" * 1_000_000
    headers = {"Content-Type": "multipart/form-data; boundary=b"}
    with place.client() as client:
        while not end.is_set():
            with contextlib.suppress(httpx.HTTPError):
                client.post("/policies", content=body, headers=headers)


Attack = Callable[[Place, Event], None]
ATTACKS: dict[str, Attack | None] = {
    "none": None,
    "states of 17 MiB": large_states,
    "flooded states": many_states,
    "nested states": deep_states,
    "event batches of 500": event_batches,
    "logs of unknown throws": log_uploads,
    "guessed logins": logins,
    "idle connections": idle_connections,
    "endless STOP requests": slow_stops,
    "flooded event sockets": sockets,
    "filtered queries": queries,
    "lease grabs": lease_grabs,
    "endless uploads": broken_uploads,
    "large hold frames": hold_frames,
    "stalled readers": slow_readers,
    "survey bombs": surveys,
    "guessed enrolment tokens": tokens,
}


@contextlib.contextmanager
def server(folder: Path, policies: Path) -> Iterator[tuple[str, str]]:
    """A server in a process of its own; its address and its link."""
    port, link = free_port(), f"tcp/127.0.0.1:{free_port()}"
    environment = os.environ | {
        "DOWNRANGE_LINK_LISTEN": link,
        "DOWNRANGE_POLICIES_DIR": str(policies.resolve()),
        "DOWNRANGE_PREVIEW_WORKER_COUNT": "1",
        "DOWNRANGE_MACHINE_SLOT_COUNT": "2",
    }
    command = [sys.executable, "-m", "cli.main", "server", "--port", str(port), "--data"]
    url = f"http://127.0.0.1:{port}"
    with (folder / "server.log").open("w") as log:
        process = subprocess.Popen(
            [*command, str(folder)], env=environment, stdout=log, stderr=subprocess.STDOUT
        )
    try:
        wait_for(lambda: is_up(url), 120.0)
        yield url, link
    finally:
        process.terminate()
        process.wait(60.0)


def is_up(url: str) -> bool:
    try:
        return httpx.get(f"{url}/api/v1/health", timeout=5.0).status_code == 200
    except httpx.TransportError:
        return False


def press(client: httpx.Client, machine: FakeMachine) -> float:
    """Seconds from the press to the latch; then the stop is cleared."""
    latched_s: list[float] = []
    latch = machine._latch

    def note() -> None:
        latched_s.append(time.perf_counter())
        latch()

    machine._latch = note
    began_s = time.perf_counter()
    client.post("/machines/m001/stop").raise_for_status()
    wait_for(lambda: latched_s)
    machine._latch = latch
    wait_for(lambda: clear_stop(client).is_success)
    return latched_s[0] - began_s


def main(
    repeats: int = 60,
    policies: Path = Path("policies"),
    only: tuple[str, ...] = (),
    json: Path = RESULTS / "stop_under_attack.json",
) -> None:
    """Press STOP under each attack, or only under those that are named."""
    rows: list[Row] = []
    spawn = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory() as name, server(Path(name), policies) as (url, link):
        folder = Path(name)
        passwords = {
            machine_id: (folder / "machines" / f"{machine_id}.password").read_text().strip()
            for machine_id in ("m001", ATTACKER)
        }
        logged_in = dict(
            line.split() for line in (folder / "demo-login.txt").read_text().splitlines()
        )
        headers = {"Origin": url, "X-Requested-With": "downrange"}
        with (
            FakeMachine(link, "m001", passwords["m001"], {}) as machine,
            httpx.Client(base_url=f"{url}/api/v1", headers=headers, timeout=30.0) as client,
        ):
            body = {"username": "admin", "password": logged_in["admin"]}
            client.post("/auth/login", json=body).raise_for_status()
            place = Place(url, link, passwords[ATTACKER], dict(client.cookies))
            wait_for(lambda: client.get("/machines/m001").json()["link"]["is_connected"])
            for attack, act in ATTACKS.items():
                if only and attack not in only:
                    continue
                end = spawn.Event()
                attackers = [
                    spawn.Process(target=act, args=(place, end), daemon=True)
                    for _ in range(2 if act is not None else 0)
                ]
                for process in attackers:
                    process.start()
                time.sleep(3.0 if attackers else 0.0)
                seconds = [press(client, machine) for _ in range(repeats)]
                end.set()
                for process in attackers:
                    process.join(5.0)
                    process.kill()
                times = [1e3 * value for value in seconds]
                values = {
                    "p50_ms": percentile(times, 50),
                    "p99_ms": percentile(times, 99),
                    "max_ms": max(times),
                }
                line = row(len(times), {"attack": attack}, values)
                rows.append(line)
                shown = "".join(f"{value.value:>9.1f}" for value in line.values.values())
                print(f"{attack:<36}{shown}", flush=True)
    title = "Time from STOP to latch under attack"
    load = os.getloadavg()[0]
    notes = (
        f"Bar: p99 at most {BAR_MS:.0f} ms. Load of the host: {load:.1f} on {os.cpu_count()} cores."
    )
    write_result(describe("stop_under_attack", title, rows, seed=None, notes=notes), json)


if __name__ == "__main__":
    tyro.cli(main)
