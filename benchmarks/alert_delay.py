"""Time from the loss of a machine to its alert on the console's socket.

    python -m benchmarks.alert_delay [--repeats 20] [--json FILE]

The machine is the tests' stand-in in a process of its own. It is killed, as by a power cut (its link closes),
or frozen (its link stays and nothing comes). Bar: 2 s.
"""

import json as json_module
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import tyro
from websockets.sync.client import ClientConnection, connect

from benchmarks.result_file import RESULTS, describe, percentile, row, write_result
from server.accounts.accounts import COOKIE
from server.settings import CHECKOUT
from tests.server.server_bench import Running, add_people, make_settings, running_server, wait_for

MACHINE = """
import sys, time
from tests.server.fake_machine import FakeMachine
endpoint, password = sys.argv[1:]
with FakeMachine(endpoint, "m001", password, {}):
    print("up", flush=True)
    time.sleep(600)
"""
BAR_S = 2.0


def opened_s(socket: ClientConnection) -> float:
    """Monotonic time at which the alert of the loss arrives."""
    while True:
        for event in json_module.loads(socket.recv(timeout=60.0)):
            if event["kind"] == "alert.updated":
                alert = event["alert"]
                if alert["rule"] == "lost" and alert["cleared_utc"] is None:
                    return time.monotonic()


def lose(running: Running, socket: ClientConnection, how: signal.Signals) -> float:
    """Seconds from the signal to the alert."""
    password = running.parts.registry.secret_path("m001").read_text().strip()
    command = [sys.executable, "-c", MACHINE, running.settings.link_listen, password]
    alerts = running.parts.alerting.alerts
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        wait_for(lambda: running.parts.registry.is_connected("m001"))
        wait_for(lambda: not [a for a in alerts.page(is_open=True).rows if a.rule == "lost"])
        began_s = time.monotonic()
        os.kill(process.pid, how)
        delay_s = opened_s(socket) - began_s
        process.kill()
    return delay_s


def main(repeats: int = 20, json: Path = RESULTS / "alert_delay.json") -> None:
    """Measure and write the result.

    Args:
        repeats: losses of each kind.
        json: where the result is written.
    """
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        settings = make_settings(Path(folder), CHECKOUT / "policies")
        with running_server(settings) as running, running.client() as client:
            add_people(running.parts)
            body = {"username": "ada", "password": "correct horse battery"}
            client.post("/auth/login", json=body).raise_for_status()
            headers = {"Origin": running.url, "Cookie": f"{COOKIE}={client.cookies.get(COOKIE)}"}
            url = f"ws{running.url.removeprefix('http')}/api/v1/events/socket"
            for what, how in (("killed", signal.SIGKILL), ("frozen", signal.SIGSTOP)):
                delays: list[float] = []
                for _ in range(repeats):
                    with connect(url, additional_headers=headers, proxy=None) as socket:
                        delays.append(lose(running, socket, how))
                values = {
                    "p50_s": percentile(delays, 50),
                    "p95_s": percentile(delays, 95),
                    "max_s": max(delays),
                    "bar_s": BAR_S,
                }
                rows.append(row(repeats, {"machine": what}, values))
                print(
                    what, *(f"{name} {value.value:.3f}" for name, value in rows[-1].values.items())
                )
    title = "From the loss of a machine to its alert on the console's socket"
    print(write_result(describe("alert_delay", title, rows, seed=None), json))


if __name__ == "__main__":
    tyro.cli(main)
