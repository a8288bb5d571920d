"""`downrange train`: learn a throwing policy and export it."""

import os
from pathlib import Path
from typing import Literal

import tyro

from machine.conventions import Mode
from machine.errors import UsageError
from machine.spec import load_spec


def run(
    *,
    mode: Literal["2d", "3d"],
    out: Path,
    iterations: int | None = None,
    environments: int | None = None,
    device: Literal["cpu", "gpu", "any"] = "any",
    reward: Literal["impact", "paper"] = "impact",
    seed: int = 0,
    policy_id: str | None = None,
    commit: str = "",
    throws: int = 1024,
    seconds: float = float("inf"),
    unroll: int = 1,
    warm_start: Path | None = None,
    checkpoint_seconds: float = 20.0,
    response: tyro.conf.UseAppendAction[tuple[tuple[Path, ...], ...]] = (),
) -> int:
    """Train a policy; run the same line again to go on after an interruption.

    Args:
        mode: within the arm plane, or with the cabin turning.
        out: folder for checkpoint, metrics.csv, learning_curve.png and the exported policy.
        iterations: learning iterations (default 4000, the paper's; 3000 in 2D with our reward).
        environments: parallel machines (default 8192, the paper's).
        device: where to compute; `any` takes a GPU if JAX finds one.
        reward: ours, or the paper's terms.
        seed: of everything random.
        policy_id: name of the exported version (default m545-MODE-local).
        commit: recorded in the card where git cannot be asked.
        throws: measured a distance after training.
        seconds: learning ends here even if iterations are left.
        unroll: physics ticks unrolled when compiling; more run a little faster, and compile for longer
            than that saves in 4000 iterations.
        warm_start: checkpoint.npz of another run whose networks this one starts from.
        checkpoint_seconds: learning between two checkpoints.
        response: results of `downrange identify response --json`, one for each machine, whose ranges of the
            drives' response are trained with instead of the built-in ones.
    """
    if device != "any":
        os.environ["JAX_PLATFORMS"] = "cpu" if device == "cpu" else "cuda,cpu"
    from dataclasses import replace

    from training.environment.configurations import learner_for, task_for
    from training.identified_response import read_response, with_identified
    from training.train import RunOptions, train

    chosen = Mode(mode)
    task = task_for(chosen, reward)
    files = [read_response(path) for paths in response for path in paths]
    if response and not files:
        raise UsageError(
            "--response needs files of `downrange identify response LOG... --json FILE`"
        )
    if files:
        identified = with_identified(task.response, files)
        for line in identified.lines:
            print_line(line)
        task = replace(task, response=identified.response)
    config = learner_for(chosen, reward)
    config = replace(
        config,
        iteration_count=config.iteration_count if iterations is None else iterations,
        environment_count=config.environment_count if environments is None else environments,
    )
    options = RunOptions(
        out=out,
        policy_id=policy_id or f"m545-{mode}-local",
        seed_count=seed,
        commit=commit,
        measured_throw_count=throws,
        time_limit_s=seconds,
        unroll_count=unroll,
        warm_start=warm_start,
        checkpoint_period_s=checkpoint_seconds,
        response_sources=tuple(file.source for file in files),
    )
    card = train(load_spec(), task, config, options, print_line)
    print_line(f"wrote {out / card.policy_id}")
    return 0


def print_line(text: str) -> None:
    """Print at once: progress must be seen while it happens."""
    print(text, flush=True)
