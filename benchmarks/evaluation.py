"""Real-time factor of evaluation campaigns, shares of their time, and the floor: mujoco.batch alone.

    python -m benchmarks.evaluation --policies policies [--mode 2d] [--throws 400] [--json FILE]

The control step of the runtime is in the loop. The factor counts each throw to its own end.
"""

from collections.abc import Callable
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, Literal

import numpy as np
import tyro
from mujoco import batch

from benchmarks.result_file import RESULTS, Row, describe, row, write_result
from evaluation.campaigns import MAX_BATCH_COUNT, open_policy
from machine.conventions import CONTROL_PERIOD_S, Mode
from machine.spec import load_spec
from machine.starts import safe_pose, sample_starts
from runtime.control import control_loop
from runtime.control.control_loop import ControlParams
from runtime.driver import SimulatedDriver
from sim_twin.commissioning.plant_data import plant_calibration
from sim_twin.rigid_body.model import twin_model
from sim_twin.throws.campaign import run_throws
from sim_twin.throws.plants import plant_maker

TARGET_FACTOR = {"twin": 300.0, "virtual": 100.0}


class Stopwatch:
    """Total time of wrapped calls."""

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


def floor_factor(count: int, ticks: int) -> float:
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
    """Run and time one campaign."""
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
    json: Path = RESULTS / "evaluation_speed.json",
) -> None:
    """Time `throws` throws on the twin and on the virtual machine."""
    rows: list[Row] = []
    for plant in ("twin", "virtual"):
        campaign(plant, Mode(mode), policies, 8, target)  # compiles models, measures valves
        before = floor_factor(min(throws, MAX_BATCH_COUNT), 200)
        found = campaign(plant, Mode(mode), policies, throws, target)
        floor = 0.5 * (before + floor_factor(min(throws, MAX_BATCH_COUNT), 200))
        values = {
            "real_time_factor": found["real_time_factor"],
            "floor_factor": floor,
            "simulated_s": found["simulated_s"],
            "wall_s": found["wall_s"],
            "cpu_s": found["cpu_s"],
            **{f"{name.replace(' ', '_')}_ratio": part for name, part in found["share"].items()},
        }
        rows.append(row(throws, {"plant": plant}, values))
        share = ", ".join(f"{name} {part:.0%}" for name, part in found["share"].items())
        print(
            f"{plant}: {found['real_time_factor']:.0f} x real time (target {TARGET_FACTOR[plant]:.0f}); "
            f"{found['simulated_s']:.0f} s simulated in {found['wall_s']:.2f} s wall, "
            f"{found['cpu_s']:.2f} s CPU; mujoco.batch alone {floor:.0f} x\n  {share}"
        )
    title = f"Real-time factor of evaluation campaigns, {mode}, {target:g} m"
    notes = (
        "Targets: "
        + ", ".join(f"{name} {factor:.0f}" for name, factor in TARGET_FACTOR.items())
        + "."
    )
    write_result(describe("evaluation_speed", title, rows, seed=0, notes=notes), json)


if __name__ == "__main__":
    tyro.cli(main)
