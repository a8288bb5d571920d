"""A useful 2D policy from two CPU cores: train for a quarter of an hour at most, then throw with it.

    python benchmarks/train_cpu.py [--minutes 15] [--seed 0] [--out FOLDER] [--json FILE]

The shipped task with fewer environments: a batch of 8192 control steps fits the cache of a core. Measured
in the trainer and on the virtual machine, nominal unit, without registration.
"""

import json as json_text
import os
import tempfile
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import tyro

TARGET_SD_M = 0.3
RANGES = "7.5,9"
CORES = 2
THROWS = 100
ENVIRONMENTS = 256
ITERATIONS = 2000
MINIBATCHES = 8
"""More and smaller parts than on a GPU: 0.32 m instead of 0.40 m at 9 m after 200 s."""
START_COUNT = 16384


def main(
    minutes: float = 15.0,
    seed: int = 0,
    iterations: int = ITERATIONS,
    throws: int = THROWS,
    out: Path | None = None,
    json: Path | None = None,
) -> None:
    """Train on two cores, measure in the trainer, throw on the virtual machine.

    Args:
        minutes: learning ends here even if iterations are left.
        seed: of everything random.
        iterations: of 8192 control steps.
        throws: at each target on the virtual machine.
        out: keep the run in this folder; a run there goes on.
        json: also write the numbers here.
    """
    _pin()
    with tempfile.TemporaryDirectory() as folder:
        _run(out or Path(folder), minutes, seed, iterations, throws, json)


def _pin() -> None:
    """Two cores and no GPU, before JAX counts either."""
    os.environ["JAX_PLATFORMS"] = "cpu"
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:CORES])


def _run(
    out: Path, minutes: float, seed: int, iterations: int, throws: int, json: Path | None
) -> None:
    # Only now: importing JAX fixes its platform and threads.
    from evaluation.campaigns import open_campaign
    from evaluation.conditions import condition_rows, condition_table
    from machine.conventions import Mode
    from machine.spec import load_spec
    from training.environment.shipped import task_for
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
    if json is not None:
        report = {
            "learning_s": card.training.wall_s,
            "whole_s": whole_s,
            "training": card.evaluation[0] if card.evaluation else None,
            "virtual": [row.model_dump() for row in rows],
        }
        json.write_text(json_text.dumps(report, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    tyro.cli(main)
