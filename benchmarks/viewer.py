"""3D view: latency from click to marker on the wire, and CPU time of the fan-out to many browsers.

    python -m benchmarks.viewer [--json FILE]

Clients speak the view's protocol through the real proxy on loopback; no browser renders. Watching clients
run in a separate process, so that the CPU time is the server's.
"""

import argparse
import resource
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np

from benchmarks.result_file import RESULTS, Row, describe, percentile, row, write_result
from machine.starts import safe_pose
from tests.server.viewer_app import CAMERA, Port, ViewClient, ViewerApp, click, wait_for

CLICKS = 200
CLIENTS = 10
RATE_HZ = 25.0
FAN_OUT_S = 8.0
TARGETS = "Targets: click to marker p95 80 ms; 25 % of a core for 10 browsers."


def connect(app: ViewerApp, session_id: str) -> ViewClient:
    app.scene.show_machine(session_id, "m001")
    client = ViewClient(app, session_id)
    client.send(CAMERA)
    client.until(lambda: "/live/chassis/skin" in client.nodes, "the machine")
    return client


def drive(app: ViewerApp, stop: threading.Event) -> None:
    """Move all joints of a machine, at the rate of the joint stream."""
    pose, began_s = safe_pose(), time.monotonic()
    while not stop.wait(1.0 / RATE_HZ):
        swing = 0.2 * np.sin(3.0 * (time.monotonic() - began_s))
        app.scene.update_machine("m001", pose + swing * np.array([1, 1, 1, 0.5, 1, 1]))


def watch(port: int) -> None:
    """Child process: clients that only watch."""
    clients = [ViewClient(Port(port), f"watch{i}") for i in range(CLIENTS)]
    for client in clients:
        client.send(CAMERA)

    def read_on(client: ViewClient) -> None:
        while True:
            client.socket.recv()

    for client in clients:
        threading.Thread(target=read_on, args=(client,), daemon=True).start()
    sys.stdin.read()


def read_for(client: ViewClient, duration_s: float) -> None:
    end_s = time.monotonic() + duration_s
    while time.monotonic() < end_s:
        client.socket.recv()


def cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def measure_clicks(app: ViewerApp, client: ViewClient, rng: np.random.Generator) -> list[float]:
    """Milliseconds from a click sent to the frame with its marker received."""
    taken: list[float] = []
    for _ in range(CLICKS):
        x, y = rng.uniform(5.0, 11.0), rng.uniform(-6.0, 6.0)
        began_s = time.perf_counter()
        client.send(click((-8.0, -8.0, 8.0), (x + 8.0, y + 8.0, -8.0)))

        def is_drawn(x: float = x, y: float = y) -> bool:
            at = client.nodes.get("/target", {}).get("position")
            return at is not None and abs(at[0] - x) < 1e-4 and abs(at[1] - y) < 1e-4

        client.until(is_drawn, "the marker")
        taken.append(1000.0 * (time.perf_counter() - began_s))
        time.sleep(rng.uniform(0.0, 0.03))
    return taken


def summary(name: str, taken: list[float], core_ratio: float | None = None) -> Row:
    """Print and return percentiles of one measurement."""
    values = {
        "p50_ms": percentile(taken, 50),
        "p95_ms": percentile(taken, 95),
        "max_ms": max(taken),
        "core_ratio": core_ratio,
    }
    line = row(len(taken), {"measurement": name}, values)
    shown = (f"{key} {v.value:.2f}" for key, v in line.values.items() if v.value is not None)
    print(f"{name}: " + ", ".join(shown))
    return line


def main(json: Path) -> None:
    """Measure with one client and with many."""
    app, rng = ViewerApp(), np.random.default_rng(1)
    app.scene.update_machine("m001", safe_pose())
    began_s = time.perf_counter()
    client = connect(app, "clicks")
    connect_ms = 1000.0 * (time.perf_counter() - began_s)
    rows = [
        summary("connect to machine on the wire", [connect_ms]),
        summary("click to marker, 1 client, machine at rest", measure_clicks(app, client, rng)),
    ]
    stop = threading.Event()
    threading.Thread(target=drive, args=(app, stop), daemon=True).start()
    taken = measure_clicks(app, client, rng)
    rows.append(summary("click to marker, 1 client, machine moving", taken))
    for index in range(CLIENTS):
        app.scene.show_machine(f"watch{index}", "m001")
    arguments = [sys.executable, __file__, "--watch", str(app.port)]
    with subprocess.Popen(arguments, stdin=subprocess.PIPE) as others:
        wait_for(lambda: app.scene.client_count(f"watch{CLIENTS - 1}"), "the others", 60.0)
        read_for(client, 2.0)
        used_s, began_s = cpu_s(), time.perf_counter()
        read_for(client, FAN_OUT_S)
        share = (cpu_s() - used_s) / (time.perf_counter() - began_s)
        name = f"click to marker, {CLIENTS + 1} clients, {RATE_HZ:.0f} Hz"
        rows.append(summary(name, measure_clicks(app, client, rng), share))
        others.terminate()
    stop.set()
    client.close()
    wait_for(lambda: app.scene.client_count("clicks") == 0, "the views to go")
    app.close()
    title = "3D view: click to marker, and share of a core of the server"
    write_result(describe("viewer", title, rows, seed=1, notes=TARGETS), json)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, default=RESULTS / "viewer.json")
    parser.add_argument("--watch", type=int, metavar="PORT", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.watch is None:
        main(given.json)
    else:
        watch(given.watch)
