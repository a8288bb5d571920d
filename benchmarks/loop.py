"""Lateness of the 100 Hz control loop, alone and with a busy process on every core.

    python -m benchmarks.loop [--ticks 2000] [--json FILE]

Runs the loop of the control process (driver, checks, protocol, control step, rows to a socket) on the
virtual machine in a separate process.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, cast

import numpy as np

from benchmarks.result_file import RESULTS, Row, describe, row, write_result
from machine.calibration import nominal_calibration
from machine.conventions import CONTROL_PERIOD_NS
from machine.spec import load_spec
from runtime.driver import Driver
from runtime.link.ipc import Kind, PacketSocket, pack_rows, packet_pair
from runtime.process.driver_loader import load_driver
from runtime.process.machine_control import MachineControl, MachineSetup
from runtime.process.real_time import IdleGarbageCollector, become_real_time
from runtime.process.ticker import LATE_TICK_NS, RealTimeClock, Ticker

TARGETS = (
    "Targets: lateness p99 2 ms, 1 % of the ticks later than 5 ms; control 1 ms. "
    "control: a tick without the time of the simulated machine."
)
BUSY_PROGRAM = "while True:\n    sum(range(10000))\n"


class TimedDriver:
    """A driver that notes how long the simulated machine itself took: a real one takes nothing there."""

    def __init__(self, driver: Driver) -> None:
        self._driver = driver
        self.simulated_ns = 0

    def advance(self, until_ns: int) -> None:
        """Advance the machine."""
        began_ns = time.monotonic_ns()
        self._driver.advance(until_ns)
        self.simulated_ns += time.monotonic_ns() - began_ns

    def __getattr__(self, name: str) -> Any:
        return getattr(self._driver, name)


def worker(driver_name: str, ticks: int, is_real_time: bool) -> dict[str, float]:
    """Run the loop and return its statistics."""
    if is_real_time:
        become_real_time()
    spec = load_spec()
    driver = TimedDriver(load_driver(driver_name, {}, 0))
    control = MachineControl(
        cast("Driver", driver),
        MachineSetup("m001", "benchmark", spec, nominal_calibration(spec), {}, "benchmark"),
    )
    mine, theirs = packet_pair()
    port, other = PacketSocket(mine), PacketSocket(theirs)
    IdleGarbageCollector()
    start_ns = driver.now_ns()
    for period in range(1, 101):
        control.tick(start_ns + period * CONTROL_PERIOD_NS, [])
    start_ns = driver.now_ns()
    ticker = Ticker(RealTimeClock(), CONTROL_PERIOD_NS)
    lateness_ns, cost_ns, simulated_ns = np.zeros(ticks), np.zeros(ticks), np.zeros(ticks)
    for index in range(ticks):
        tick = ticker.next()
        began_ns, driver.simulated_ns = time.monotonic_ns(), 0
        report = control.tick(start_ns + tick.period_count * CONTROL_PERIOD_NS, [], 0)
        port.send(Kind.TICK, pack_rows({1: report.rows["control"]}))
        other.receive()
        cost_ns[index] = time.monotonic_ns() - began_ns
        lateness_ns[index] = tick.lateness_ns
        simulated_ns[index] = driver.simulated_ns
    control.close()
    late = np.count_nonzero(lateness_ns > LATE_TICK_NS) + ticker.skipped_count
    return {
        **{f"late_p{p:g}_us": float(np.percentile(lateness_ns, p)) / 1e3 for p in (50, 99, 99.9)},
        "late_max_us": float(lateness_ns.max()) / 1e3,
        "late_over_5ms_percent": 100.0 * float(late) / (ticks + ticker.skipped_count),
        "control_p50_us": float(np.percentile(cost_ns - simulated_ns, 50)) / 1e3,
        "control_p99_us": float(np.percentile(cost_ns - simulated_ns, 99)) / 1e3,
        "tick_p50_us": float(np.percentile(cost_ns, 50)) / 1e3,
        "tick_p99_us": float(np.percentile(cost_ns, 99)) / 1e3,
    }


def measure(ticks: int, driver: str, is_real_time: bool, busy_count: int) -> dict[str, float]:
    """Run the loop beside a number of busy processes."""
    busy = [subprocess.Popen([sys.executable, "-c", BUSY_PROGRAM]) for _ in range(busy_count)]
    try:
        command = [sys.executable, __file__, "--worker", "--ticks", str(ticks), "--driver", driver]
        root = str(Path(__file__).parents[1])
        answer = subprocess.run(
            [*command, *([] if is_real_time else ["--ordinary"])],
            check=True, capture_output=True, text=True, env=os.environ | {"PYTHONPATH": root},
        )  # fmt: skip
    finally:
        for process in busy:
            process.kill()
            process.wait()
    return json.loads(answer.stdout.splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--ticks", type=int, default=2000)
    parser.add_argument("--driver", default="sim_twin.virtual_machine:VirtualMachine")
    parser.add_argument("--json", type=Path, default=RESULTS / "loop.json")
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--ordinary", action="store_true", help="no real-time scheduling")
    given = parser.parse_args()
    if given.worker:
        print(json.dumps(worker(given.driver, given.ticks, not given.ordinary)))
        return
    cores = os.cpu_count() or 1
    print(f"{given.ticks} ticks of 10 ms, {cores} cores, load {os.getloadavg()[0]:.1f}")
    rows: list[Row] = []
    for is_real_time in (True, False):
        for busy_count in (0, cores):
            found = measure(given.ticks, given.driver, is_real_time, busy_count)
            labels = {
                "scheduling": "real-time" if is_real_time else "ordinary",
                "busy processes": busy_count,
            }
            rows.append(row(given.ticks, labels, found))
            name = f"{labels['scheduling']}, {busy_count} busy processes"
            print(f"{name:34}", "  ".join(f"{key} {value:.0f}" for key, value in found.items()))
    print(TARGETS)
    title = "Lateness and time of the 100 Hz control loop"
    write_result(describe("loop", title, rows, seed=0, notes=TARGETS), given.json)


if __name__ == "__main__":
    main()
