"""Latency from fire request to acceptance and from STOP request to latch: HTTP, server, Zenoh, loopback.

    python -m benchmarks.commands [--repeats 50] [--json FILE]

The machine is the tests' stand-in (tests/server/fake_machine.py), in this process like the server. The
floor is a command over Zenoh alone, without HTTP, rights, lease and audit.
"""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import tyro
from httpx import Client

from benchmarks.result_file import RESULTS, Row, describe, percentile, row, write_result
from machine.messages import LoadRequest
from server.clock import new_id
from server.plans.plan_store import PlanStore
from server.plans.policy_store import PolicyStore
from tests.server.fake_machine import FakeMachine
from tests.server.server_bench import (
    Running,
    add_people,
    clear_stop,
    make_settings,
    running_server,
    wait_for,
)


def summary(name: str, seconds: list[float]) -> Row:
    """Print and return percentiles of one command."""
    times = [1e3 * value for value in seconds]
    found = {"p50_ms": percentile(times, 50), "p99_ms": percentile(times, 99), "max_ms": max(times)}
    line = row(len(times), {"command": name}, found)
    print(f"{name:<28}" + "".join(f"{value.value:>8.1f}" for value in line.values.values()))
    return line


def timed(action: Callable[[], object]) -> float:
    began_s = time.perf_counter()
    action()
    return time.perf_counter() - began_s


def main(
    repeats: int = 50, policies: Path = Path("policies"), json: Path = RESULTS / "commands.json"
) -> None:
    """Start a server and a stand-in for a machine, and send commands."""
    with tempfile.TemporaryDirectory() as folder:
        settings = make_settings(Path(folder), policies)
        with running_server(settings) as running:
            add_people(running.parts)
            with stand_in(running) as machine, running.client("sue") as client:
                wait_for(lambda: running.parts.registry.is_connected("m001"))
                print(f"{'ms':<28}{'p50':>8}{'p99':>8}{'max':>8}")
                rows = measure(running, machine, client, repeats)
    title = "Latency of commands from HTTP request to machine"
    write_result(describe("commands", title, rows, seed=None), json)


def stand_in(running: Running) -> FakeMachine:
    policies: PolicyStore = running.parts.policies
    policies.refresh()
    machine = FakeMachine(
        running.settings.link_listen,
        "m001",
        running.parts.registry.secret_path("m001").read_text().strip(),
        {item.mode.value: item.policy_sha256 for item in policies.reach().modes},
    )
    machine.needs_hold, machine.swing_s = False, 0.0
    return machine


def measure(running: Running, machine: FakeMachine, client: Client, repeats: int) -> list[Row]:
    arms: list[float] = []
    fires: list[float] = []
    for _ in range(repeats):
        client.post("/machines/m001/lease")
        machine.payload_held = True
        time.sleep(0.15)
        plan_id = ready_plan(running.parts.plans, client)
        arms.append(timed(lambda p=plan_id: client.post(f"/plans/{p}/arm", json={})))
        fires.append(timed(lambda p=plan_id: client.post(f"/plans/{p}/fire").raise_for_status()))
        wait_for(lambda: machine.state.value == "disarmed")
    stops: list[float] = []
    for _ in range(repeats):
        began_s = time.perf_counter()
        latch, seen = machine._latch, []

        def note(seen: list[float] = seen, latch: Callable[[], None] = latch) -> None:
            seen.append(time.perf_counter())
            latch()

        machine._latch = note
        client.post("/machines/m001/stop").raise_for_status()
        stops.append(seen[0] - began_s)
        machine._latch = latch
        wait_for(lambda: clear_stop(client).is_success)
    epoch = machine.epoch_count
    floor = [
        timed(
            lambda: running.parts.link.send(
                LoadRequest(command_id=new_id(), machine_id="m001", issuer="b", epoch_count=epoch)
            )
        )
        for _ in range(repeats)
    ]
    return [
        summary("arm to answer", arms),
        summary("fire to acceptance", fires),
        summary("STOP to latch", stops),
        summary("floor: Zenoh alone", floor),
    ]


def ready_plan(plans: PlanStore, client: Client) -> str:
    body = {"mode": "2d", "target": {"x_m": 8.0, "y_m": 0.0}, "rollout_count": 50}
    plan_id = client.post("/machines/m001/plans", json=body).json()["plan_id"]
    wait_for(lambda: plans.view(plan_id).state.value != "previewing", 60.0)
    return plan_id


if __name__ == "__main__":
    tyro.cli(main)
