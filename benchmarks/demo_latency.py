"""What an operator waits for on `downrange demo`, with one and with more virtual machines on its computer.

    python -m benchmarks.demo_latency [--machines 1 3] [--repeats 100] [--json FILE]

For random targets: from the request for a preview to its first numbers and to its whole ellipse, both as
read every 10 ms, and from the press of *Throw* to the machine's acceptance. A throw is not held, so that the
machine holds still before its commit point. Server, router and machines are the demo's own processes; no
browser.
"""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import httpx
import numpy as np
import tyro

from benchmarks.result_file import RESULTS, Row, describe, percentile, row, write_result
from tests.e2e.stack import Stack, client, running_demo

MACHINE = "m001"
POLL_S = 0.01
TIMEOUT_S = 30.0
RANGE_M = (8.0, 10.0)
"""Inside the reach of 2D throws of every unit."""


def wait_for(is_true: Callable[[], bool], began_s: float) -> float:
    """Milliseconds from `began_s` until a condition holds.

    Raises:
        TimeoutError: it does not within 30 s.
    """
    while not is_true():
        if time.perf_counter() - began_s > TIMEOUT_S:
            raise TimeoutError("the demo did not get there within 30 s")
        time.sleep(POLL_S)
    return 1e3 * (time.perf_counter() - began_s)


def machine_state(caller: httpx.Client) -> dict[str, object]:
    """The machine's last state; empty while it is lost."""
    return caller.get(f"/machines/{MACHINE}").json()["state"] or {}


def measure_one(caller: httpx.Client, range_m: float) -> tuple[float, float, float]:
    """Milliseconds to the first numbers, to the whole ellipse, and from fire to acceptance."""
    caller.post(f"/machines/{MACHINE}/lease").raise_for_status()
    if not machine_state(caller).get("payload_held"):
        caller.post(f"/machines/{MACHINE}/load").raise_for_status()
        wait_for(lambda: bool(machine_state(caller).get("payload_held")), time.perf_counter())
    body = {"mode": "2d", "target": {"x_m": range_m, "y_m": 0.0}}
    began_s = time.perf_counter()
    plan = caller.post(f"/machines/{MACHINE}/plans", json=body).raise_for_status().json()
    path = f"/plans/{plan['plan_id']}"
    shown_ms = wait_for(lambda: caller.get(path).json()["prediction"] is not None, began_s)
    whole_ms = wait_for(lambda: caller.get(path).json()["is_complete"], began_s)
    armed = caller.post(f"{path}/arm", json={})
    assert armed.is_success, armed.text
    began_s = time.perf_counter()
    fired = caller.post(f"{path}/fire").raise_for_status().json()
    fire_ms = 1e3 * (time.perf_counter() - began_s)
    throw = f"/throws/{fired['throw_id']}"
    wait_for(lambda: caller.get(throw).json()["row"]["phase"] == "ended", time.perf_counter())
    wait_for(lambda: machine_state(caller).get("state") == "disarmed", time.perf_counter())
    return shown_ms, whole_ms, fire_ms


def measure(stack: Stack, machine_count: int, repeats: int) -> list[Row]:
    """Rows of one demo."""
    rng = np.random.default_rng(0)
    with client(stack, "operator") as caller:
        times = [measure_one(caller, float(rng.uniform(*RANGE_M))) for _ in range(repeats)]
    names = ("preview: first numbers", "preview: whole ellipse", "fire to acceptance")
    return [
        row(
            repeats,
            {"machines": machine_count, "step": name},
            {"p50_ms": percentile(values, 50), "p99_ms": percentile(values, 99)},
        )
        for name, values in zip(names, map(list, zip(*times, strict=True)), strict=True)
    ]


def main(
    machines: tuple[int, ...] = (1, 3),
    repeats: int = 100,
    json: Path = RESULTS / "demo_latency.json",
) -> None:
    """Measure the demo once for each count of machines."""
    rows: list[Row] = []
    for count in machines:
        with tempfile.TemporaryDirectory() as name, running_demo(Path(name), count) as stack:
            rows += measure(stack, count, repeats)
        for line in rows[-3:]:
            print(line.labels, line.values, flush=True)
    title = "Waiting times on the demo, by virtual machines"
    write_result(describe("demo_latency", title, rows, seed=0), json)


if __name__ == "__main__":
    tyro.cli(main)
