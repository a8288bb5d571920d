"""Control steps per second of a training, updates included, on JAX's default device.

    python -m benchmarks.train_speed [--mode 3d] [--environments 8192] [--unroll 1] [--json FILE]

The shipped configuration, timed after compilation for at most a minute. The interval is that of the slowest
and the fastest chunk of iterations. The target applies to a GPU.
"""

from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Literal

import jax
import numpy as np
import tyro

from benchmarks.result_file import RESULTS, Value, describe, row, write_result
from machine.conventions import Mode
from machine.spec import load_spec
from training.environment.configurations import learner_for, task_for
from training.environment.state import random_table
from training.environment.throw_environment import ThrowEnvironment
from training.ppo import Trainer

TARGET_STEPS_PER_S = 6e6
CPU_ENVIRONMENTS = 256
START_COUNT = 4096
CHUNKS = 5
LONGEST_S = 60.0


def main(
    mode: Literal["2d", "3d"] = "3d",
    environments: int | None = None,
    iterations: int | None = None,
    unroll: int = 1,
    json: Path = RESULTS / "train_speed.json",
) -> None:
    """Time chunks of iterations.

    Args:
        mode: 2d or 3d.
        environments: parallel machines; 8192 (the paper's) on a GPU, 256 on a CPU.
        iterations: of a chunk; 20 on a GPU, 2 on a CPU.
        unroll: physics ticks unrolled when compiling.
        json: file for the result.
    """
    device = jax.devices()[0]
    on_gpu = device.platform == "gpu"
    config = learner_for(Mode(mode))
    count = environments or (config.environment_count if on_gpu else CPU_ENVIRONMENTS)
    config = replace(config, environment_count=count)
    task = task_for(Mode(mode))
    task = replace(task, episode=replace(task.episode, start_count=START_COUNT))
    spec = load_spec()
    environment = ThrowEnvironment(spec, task, unroll if on_gpu else 1)
    trainer = Trainer(environment, random_table(spec, task, 0), config)
    learner = trainer.start(jax.random.key(0))
    chunk = iterations or (20 if on_gpu else 2)
    started = perf_counter()
    learner, metrics = trainer.advance(learner, chunk)
    jax.block_until_ready(metrics)
    compile_s = perf_counter() - started
    seconds: list[float] = []
    while len(seconds) < CHUNKS and sum(seconds) < LONGEST_S:
        started = perf_counter()
        learner, metrics = trainer.advance(learner, chunk)
        jax.block_until_ready(metrics)
        seconds.append(perf_counter() - started)
    steps = chunk * count * config.step_count
    rate = [steps / s for s in (float(np.median(seconds)), max(seconds), min(seconds))]
    print(
        f"{device.device_kind}, {count} environments: {rate[0] / 1e6:.3f} million control steps a second "
        f"({rate[1] / 1e6:.3f} to {rate[2] / 1e6:.3f}); first chunk with compilation {compile_s:.0f} s"
    )
    if on_gpu:
        met = rate[0] >= TARGET_STEPS_PER_S
        print(f"target: {TARGET_STEPS_PER_S / 1e6:.0f} million: {'met' if met else 'missed'}")
    labels = {"mode": mode, "device": device.device_kind, "environments": count}
    values = {
        "steps_per_s": Value(value=rate[0], low=rate[1], high=rate[2]),
        "first_chunk_s": compile_s,
    }
    result = describe(
        "train_speed",
        "Control steps per second of a training, updates included",
        [row(len(seconds), labels, values)],
        seed=0,
        notes=f"Target on a GPU: {TARGET_STEPS_PER_S / 1e6:.0f} million steps per second.",
        accelerator=device.device_kind if on_gpu else "no GPU",
    )
    write_result(result.model_copy(update={"interval": "slowest to fastest chunk"}), json)


if __name__ == "__main__":
    tyro.cli(main)
