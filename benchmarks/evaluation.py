"""Real-time factor of evaluation campaigns, where their time goes, and the bare mujoco.batch beside it.

    python benchmarks/evaluation.py --policies policies [--mode 2d] [--throws 400] [--json FILE]

The control step of the runtime is in the loop. The factor counts each throw to its own end.
"""

import json as json_text
from collections.abc import Callable
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, Literal

import numpy as np
import tyro
from mujoco import batch

from evaluation.campaigns import MAX_BATCH_COUNT, open_policy
from machine.conventions import CONTROL_PERIOD_S, Mode
from machine.spec import load_spec
from machine.starts import safe_pose, sample_starts
from runtime.control import control_loop
from runtime.control.control_loop import ControlParams
from runtime.driver import SimulatedDriver
from sim_twin.throws.campaign import run_throws
from sim_twin.throws.plants import plant_calibration, plant_maker
from sim_twin.twin.model import twin_model

TARGET_FACTOR = {"twin": 300.0, "virtual": 100.0}


class Stopwatch:
    """Adds up the time that wrapped calls take."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    def wrap(self, name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        self.seconds[name] = 0.0

        def timed(*args: Any, **kwargs: Any) -> Any:
            started = perf_counter()
            try:
                return call(*args, **kwargs)
            finally:
                self.seconds[name] += perf_counter() - started

        return timed


def bare_factor(count: int, ticks: int) -> float:
    """Real-time factor of mujoco.batch alone on the twin's model."""
    machines = batch.Batch(twin_model()[0], count, 2)
    machines.bind("qpos")[:] = safe_pose()
    started = perf_counter()
    for _ in range(ticks):
        machines.step()
    return count * ticks * CONTROL_PERIOD_S / (perf_counter() - started)


def campaign(
    plant_name: str, mode: Mode, policies: Path, throws: int, range_m: float
) -> dict[str, Any]:
    """Throw and measure."""
    spec = load_spec()
    make = plant_maker(plant_name, unit_seed=0, profile=None, calibration=None, spec=spec)
    params = ControlParams(
        spec=spec,
        calibration=plant_calibration(plant_name, make, unit_seed=0, spec=spec, path=None),
        mode=mode,
        policy=open_policy(mode, policies, None, spec),
    )
    target_m = np.zeros((throws, 3))
    target_m[:, 0] = range_m
    starts = sample_starts(spec, mode, target_m, np.random.default_rng(0))
    plant: SimulatedDriver = make(min(throws, MAX_BATCH_COUNT))
    watch = Stopwatch()
    for name in ("advance", "read", "write"):
        setattr(plant, name, watch.wrap(f"plant {name}", getattr(plant, name)))
    step = control_loop.step
    control_loop.step = watch.wrap("control step", step)
    try:
        wall, cpu = perf_counter(), process_time()
        results = run_throws(plant, params, target_m, starts, 0)
        wall, cpu = perf_counter() - wall, process_time() - cpu
    finally:
        control_loop.step = step
    simulated_s = sum(r.simulated_s for r in results)
    watch.seconds["rest"] = wall - sum(watch.seconds.values())
    return {
        "throws": throws,
        "simulated_s": simulated_s,
        "wall_s": wall,
        "cpu_s": cpu,
        "real_time_factor": simulated_s / wall,
        "share": {name: seconds / wall for name, seconds in watch.seconds.items()},
    }


def main(
    policies: Path = Path("policies"),
    mode: Literal["2d", "3d"] = "2d",
    throws: int = 400,
    target: float = 8.5,
    json: Path | None = None,
) -> None:
    """Run `throws` throws on the twin and on the virtual machine and print what it took."""
    report: dict[str, Any] = {}
    for plant in ("twin", "virtual"):
        campaign(plant, Mode(mode), policies, 8, target)  # compiles models, measures valves
        bare_before = bare_factor(min(throws, MAX_BATCH_COUNT), 200)
        found = campaign(plant, Mode(mode), policies, throws, target)
        bare = 0.5 * (bare_before + bare_factor(min(throws, MAX_BATCH_COUNT), 200))
        report[plant] = {**found, "bare_batch_factor": bare}
        share = ", ".join(f"{name} {part:.0%}" for name, part in found["share"].items())
        print(
            f"{plant}: {found['real_time_factor']:.0f} x real time (target {TARGET_FACTOR[plant]:.0f}); "
            f"{found['simulated_s']:.0f} s simulated in {found['wall_s']:.2f} s wall, "
            f"{found['cpu_s']:.2f} s CPU; bare mujoco.batch {bare:.0f} x\n  {share}"
        )
    if json is not None:
        json.write_text(json_text.dumps(report, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    tyro.cli(main)
