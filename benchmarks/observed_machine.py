"""A virtual machine whose control process writes down which policies it holds.

The file depends on neither slots nor events: what holds after a tick is appended, with the computer's time,
when it changes and once a second.
"""

import json
import time
from pathlib import Path
from typing import Any

from runtime.process.machine_control import MachineControl
from sim_twin.virtual_machine import VirtualMachine

ALIVE_PERIOD_S = 1.0


class ObservedMachine(VirtualMachine):
    """Driver `benchmarks.observed_machine:ObservedMachine`."""

    def __init__(self, *, count: int, unit_seed: int, policy_log: str) -> None:
        super().__init__(count=count, unit_seed=unit_seed)
        _observe(Path(policy_log))


def _observe(log: Path) -> None:
    tick = MachineControl.tick
    said: dict[str, Any] = {"held": None, "until_s": 0.0}

    def observed(control: MachineControl, *arguments: Any) -> Any:
        # Before the tick, which is long where a simulated machine has to catch up.
        now_s = time.time()
        report = tick(control, *arguments)
        held = {m.value: runner.card.policy_sha256 for m, runner in control.setup.policies.items()}
        if held != said["held"] or time.monotonic() >= said["until_s"]:
            said.update(held=held, until_s=time.monotonic() + ALIVE_PERIOD_S)
            line = {"t_s": now_s, "boot_id": control.setup.boot_id, "held": held}
            with log.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")
        return report

    MachineControl.tick = observed
