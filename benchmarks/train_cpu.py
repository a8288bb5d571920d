"""Accuracy of a 2D policy trained on two CPU cores for at most a quarter of an hour.

    python -m benchmarks.train_cpu [--minutes 15] [--seed 0] [--out FOLDER] [--json FILE]

The shipped task with fewer environments, so that a batch of 8192 control steps fits the cache of a core.
Measured on the nominal virtual machine, without registration.
"""

import os
import tempfile
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import tyro

from benchmarks.result_file import RESULTS, describe, row, write_result

TARGET_SD_M = 0.3
RANGES = "7.5,9"
CORES = 2
THROWS = 100
ENVIRONMENTS = 256
ITERATIONS = 2000
MINIBATCHES = 8
"""More and smaller minibatches than on a GPU: more gradient steps per second of training."""
START_COUNT = 16384
"""Start poses in the table."""


def main(
    minutes: float = 15.0,
    seed: int = 0,
    iterations: int = ITERATIONS,
    throws: int = THROWS,
    out: Path | None = None,
    json: Path = RESULTS / "train_cpu.json",
) -> None:
    """Train on two cores, then throw on the virtual machine.

    Args:
        minutes: training time after which training ends even if iterations are left.
        seed: of all random numbers.
        iterations: of 8192 control steps.
        throws: at each target on the virtual machine.
        out: folder of the run, kept; a run in it is resumed.
        json: file for the result.
    """
    _pin()
    with tempfile.TemporaryDirectory() as folder:
        _run(out or Path(folder), minutes, seed, iterations, throws, json)


def _pin() -> None:
    """Restrict the process to two cores and no GPU; must run before JAX is imported."""
    os.environ["JAX_PLATFORMS"] = "cpu"
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:CORES])


def _run(out: Path, minutes: float, seed: int, iterations: int, throws: int, json: Path) -> None:
    # Imported here, because importing JAX fixes its platform and threads.
    from evaluation.campaigns import open_campaign
    from evaluation.conditions import condition_rows, condition_table
    from machine.conventions import Mode
    from machine.spec import load_spec
    from training.environment.configurations import task_for
    from training.environment.task import PpoConfig
    from training.train import RunOptions, train

    task = task_for(Mode.PLANAR)
    task = replace(task, episode=replace(task.episode, start_count=START_COUNT))
    config = replace(
        PpoConfig(),
        environment_count=ENVIRONMENTS,
        iteration_count=iterations,
        minibatch_count=MINIBATCHES,
        hidden_type="float32",
    )
    options = RunOptions(
        out=out,
        policy_id="m545-2d-cpu",
        seed_count=seed,
        measured_throw_count=256,
        time_limit_s=60.0 * minutes,
        chunk_count=20,
    )
    started = perf_counter()
    card = train(load_spec(), task, config, options, lambda text: print(text, flush=True))
    whole_s = perf_counter() - started
    campaign = open_campaign(
        mode=Mode.PLANAR, plant="virtual", targets=RANGES, throws=throws, seed=seed, unit_seed=0,
        policies=out, policy=out / card.policy_id, calibration=None, profile=None,
    )  # fmt: skip
    rows = condition_rows(campaign, throws, seed)
    print(condition_table(rows))
    spread = rows[-1].sd_downrange_m
    met = spread is not None and spread <= TARGET_SD_M
    print(
        f"{card.training.wall_s:.0f} s of learning on {CORES} cores ({whole_s:.0f} s with measuring and "
        f"export); target: sd {TARGET_SD_M} m at 9 m on the virtual machine: {'met' if met else 'missed'}"
    )
    lines = [
        row(
            found.throw_count,
            {"target_m": f"{found.range_m:g}"},
            {
                "mean_downrange_error_m": found.mean_downrange_error_m,
                "sd_downrange_m": found.sd_downrange_m,
                "mean_crossrange_error_m": found.mean_crossrange_error_m,
                "sd_crossrange_m": found.sd_crossrange_m,
                "training_s": card.training.wall_s,
            },
        )
        for found in rows
    ]
    title = f"2D policy trained on {CORES} CPU cores, on the virtual machine"
    notes = f"Target: sd {TARGET_SD_M} m at 9 m."
    write_result(describe("train_cpu", title, lines, seed=seed, notes=notes), json)


if __name__ == "__main__":
    tyro.cli(main)
