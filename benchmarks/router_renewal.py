"""How long a machine is without link when the router is opened anew for a new account.

    python -m benchmarks.router_renewal [--repeats 20] [--json FILE]

Machines are the tests' stand-ins, publishing 20 states a second. Measured at the server: the longest pause
between two states, which must stay below the 1 s after which a machine counts as lost, and losses reported.
"""

import tempfile
import time
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path

import tyro

from benchmarks.result_file import RESULTS, describe, percentile, row, write_result
from machine.messages import MachineState
from server.accounts.audit_chain import Actor
from server.machines.machine_registry import FRESH_S
from server.settings import CHECKOUT
from tests.server.fake_machine import FakeMachine
from tests.server.server_bench import Running, make_settings, running_server, wait_for


def pause_s(running: Running, count: int) -> float:
    """Longest pause of m001's states around the renewal for one more account, s."""
    registry, link = running.parts.registry, running.parts.link
    times = [time.monotonic()]

    def note(known: object, state: MachineState) -> None:
        if state.machine_id == "m001":
            times.append(time.monotonic())

    registry.on_state.append(note)
    renewals = link.renewals_count
    registry.enrol(f"x{count:03d}", "", Actor("benchmark"))
    wait_for(lambda: link.renewals_count > renewals)
    end_s = time.monotonic() + 2.0
    wait_for(lambda: time.monotonic() > end_s)
    registry.on_state.remove(note)
    return max(after - before for before, after in pairwise(times))


def main(repeats: int = 20, json: Path = RESULTS / "router_renewal.json") -> None:
    """Measure and write the result.

    Args:
        repeats: accounts added, one after the other.
        json: where the result is written.
    """
    with tempfile.TemporaryDirectory() as folder:
        settings = make_settings(Path(folder), CHECKOUT / "policies", machine_slot_count=16)
        with running_server(settings) as running, ExitStack() as stack:
            ids = [known.machine_id for known in running.parts.registry.all()]
            for machine_id in ids:
                password = running.parts.registry.password(machine_id)
                machine = FakeMachine(settings.link_listen, machine_id, password, {})
                stack.enter_context(machine)
            wait_for(lambda: all(running.parts.registry.is_connected(name) for name in ids))
            lost: list[str] = []
            running.parts.registry.on_lost.append(lost.append)
            pauses = [pause_s(running, count) for count in range(repeats)]
            lost_count = len(lost)
    values = {
        "p50_s": percentile(pauses, 50),
        "p95_s": percentile(pauses, 95),
        "max_s": max(pauses),
        "lost_count": float(lost_count),
        "bar_s": FRESH_S,
    }
    rows = [row(repeats, {"machines": str(len(ids))}, values)]
    print(*(f"{name} {value.value:.3f}" for name, value in rows[0].values.items()))
    title = (
        "Longest pause of a machine's states while the router is opened anew for another machine"
    )
    print(write_result(describe("router_renewal", title, rows, seed=None), json))


if __name__ == "__main__":
    tyro.cli(main)
