"""One training run: learn, report, checkpoint, resume, measure, export."""

import hashlib
import importlib
import json
import subprocess
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from machine.errors import UsageError
from machine.policy_card import PolicyCard, TrainingRecord
from machine.spec import MachineSpec
from runtime.control.policy import POLICY_ID
from training.checkpoint import (
    CHECKPOINT_FILE,
    load_checkpoint,
    load_weights,
    save_checkpoint,
)
from training.environment.state import random_table
from training.environment.task import PpoConfig, TaskConfig
from training.environment.throw_environment import ThrowEnvironment
from training.export import export_policy
from training.identified_response import ResponseSource
from training.measure import Accuracy, Measurement
from training.networks import Layers, Normaliser
from training.ppo import Learner, Trainer
from training.progress import (
    CSV_FILE,
    CURVE_FILE,
    SUMMARY_FILE,
    append_rows,
    keep_rows,
    plot_curve,
    progress_line,
    progress_rows,
    read_rows,
    write_summary,
)

MEASURED_RANGES_M = (7.0, 7.5, 8.0, 8.5, 9.0, 9.5, 10.0, 10.5, 10.87)
"""Target ranges of the accuracy measurement (paper: 7 to 10 m); the last is 1.45 times the reach."""


@dataclass(frozen=True)
class RunOptions:
    """Options of a run besides task and learner."""

    out: Path
    """Folder for checkpoint, metrics, curve and policy."""
    policy_id: str
    """Name of the exported policy version."""
    seed_count: int = 0
    """Seed of all random numbers."""
    commit: str = ""
    """Commit of the code; empty: read from git."""
    chunk_count: int = 20
    """Iterations between progress lines."""
    measured_throw_count: int = 1024
    """Throws per target range after training; 0: none."""
    time_limit_s: float = float("inf")
    """Wall time after which training ends even if iterations are left."""
    unroll_count: int = 1
    """Physics ticks unrolled in the compiled loop: longer compilation, faster steps on a GPU."""
    warm_start: Path | None = None
    """Checkpoint of another run whose networks are the initial ones."""
    checkpoint_period_s: float = 20.0
    """Time between checkpoints."""
    response_sources: tuple[ResponseSource, ...] = ()
    """Files of the identified response, recorded in the card."""


def train(
    spec: MachineSpec,
    task: TaskConfig,
    config: PpoConfig,
    options: RunOptions,
    say: Callable[[str], None],
) -> PolicyCard:
    """Train to the end, from the checkpoint in `options.out` if there is one, and export the policy."""
    _check(config, options)
    learner, trainer, fingerprint = _prepare(spec, task, config, options, say)
    with ThreadPoolExecutor() as pool:
        # The host is idle while the GPU trains.
        shapes = jax.eval_shape(lambda: (learner.networks.actor, learner.normaliser))
        measuring = pool.submit(_measurement, spec, task, options, shapes)
        drawing = pool.submit(importlib.import_module, "matplotlib.figure")
        learner, wall_s = _learn(learner, trainer, fingerprint, options, say)
        throws = measuring.result()
        drawing.result()
    accuracy: list[Accuracy] = []
    if throws is not None:
        accuracy = throws.accuracy(learner.networks.actor, learner.normaliser)
        for entry in accuracy:
            say(accuracy_line(entry))
    host = jax.device_get((learner.networks.actor, learner.normaliser))
    rows = read_rows(options.out / CSV_FILE)
    write_summary(options.out / SUMMARY_FILE, rows, accuracy)
    if rows:
        plot_curve(options.out / CURVE_FILE, rows, f"{options.policy_id}: learning curve")
    record = TrainingRecord(
        commit=options.commit or current_commit(),
        seed_count=options.seed_count,
        environment_step_count=int(learner.iteration)
        * config.environment_count
        * config.step_count,
        iteration_count=int(learner.iteration),
        wall_s=round(wall_s, 1),
        device=jax.devices()[0].device_kind,
        config=_resolved(task, config, options),
    )
    evaluation = [{"plant": "training", "throws": [asdict(entry) for entry in accuracy]}]
    with jax.default_device(jax.devices("cpu")[0]):
        return export_policy(
            options.out / options.policy_id,
            options.policy_id,
            spec,
            task,
            host[0],
            host[1],
            record,
            evaluation if accuracy else (),
        )


def _measurement(
    spec: MachineSpec, task: TaskConfig, options: RunOptions, shapes: tuple[Layers, Normaliser]
) -> Measurement | None:
    """Compiled accuracy measurement for networks of these shapes; None without throws."""
    if not options.measured_throw_count:
        return None
    near, far = task.episode.target_range_m
    ranges = [r for r in MEASURED_RANGES_M if near <= r <= far]
    throws = Measurement(
        spec, task, ranges, options.measured_throw_count, seed=options.seed_count + 1
    )
    throws.prepare(*shapes)
    return throws


def _check(config: PpoConfig, options: RunOptions) -> None:
    """Refuse options that would fail later.

    Raises:
        UsageError: with option, value and remedy.
    """
    count, parts = config.environment_count, config.minibatch_count
    if count < 1 or count % parts:
        raise UsageError(
            f"{count} environments do not split into {parts} minibatches; choose a multiple"
        )
    for name, value, least in (
        ("iterations", config.iteration_count, 1),
        ("seed", options.seed_count, 0),
        ("throws", options.measured_throw_count, 0),
        ("unroll", options.unroll_count, 1),
    ):
        if value < least:
            raise UsageError(f"{name} must be {least} or more, is {value}")
    if not options.time_limit_s > 0.0:
        raise UsageError(f"seconds must be more than 0, is {options.time_limit_s}")
    if not POLICY_ID.fullmatch(options.policy_id):
        raise UsageError(
            f"policy id {options.policy_id!r} does not fit {POLICY_ID.pattern}: "
            "3 to 64 lower-case letters, digits, dots, dashes"
        )
    try:
        options.out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=options.out):
            pass
    except OSError as error:
        raise UsageError(
            f"cannot write to {options.out} ({error}); choose another --out"
        ) from error


def _prepare(
    spec: MachineSpec,
    task: TaskConfig,
    config: PpoConfig,
    options: RunOptions,
    say: Callable[[str], None],
) -> tuple[Learner, Trainer, str]:
    """Build the trainer, and the learner from scratch or from the checkpoint."""
    environment = ThrowEnvironment(spec, task, options.unroll_count)
    table = random_table(spec, task, options.seed_count)
    trainer = Trainer(environment, table, config)
    # Independent of the iterations: a longer run may resume from a shorter one's checkpoint.
    same = {"task": asdict(task), "ppo": asdict(replace(config, iteration_count=0))}
    text = json.dumps(_plain(same), sort_keys=True) + spec.sha256 + str(options.seed_count)
    fingerprint = hashlib.sha256(text.encode()).hexdigest()
    chunk = min(options.chunk_count, config.iteration_count)
    learner = trainer.prepared(jax.random.key(options.seed_count), chunk)
    path = options.out / CHECKPOINT_FILE
    if options.warm_start is not None and not path.is_file():
        learner = load_weights(options.warm_start, learner)
        # Explore again, but less than untrained networks do.
        spread = jnp.full_like(learner.networks.log_deviation, config.log_deviation_floor_ratio[0])
        learner = learner._replace(networks=learner.networks._replace(log_deviation=spread))
        say(f"networks taken from {options.warm_start}")
    if path.is_file():
        learner = load_checkpoint(path, learner, fingerprint)
        say(f"resumed from {path} at iteration {int(learner.iteration)}")
    return learner, trainer, fingerprint


def _learn(
    learner: Learner,
    trainer: Trainer,
    fingerprint: str,
    options: RunOptions,
    say: Callable[[str], None],
) -> tuple[Learner, float]:
    """Iterate to the end; return the learner and the run's wall time, parts before a resume included."""
    config, csv_path = trainer.config, options.out / CSV_FILE
    path = options.out / CHECKPOINT_FILE
    iteration = int(learner.iteration)
    earlier = keep_rows(csv_path, iteration)
    before = earlier[-1].wall_s if earlier else 0.0
    started = saved = time.perf_counter()
    last = started
    over = before > options.time_limit_s
    while iteration < config.iteration_count and not over:
        chunk = min(options.chunk_count, config.iteration_count - iteration)
        learner, metrics = trainer.advance(learner, chunk)
        jax.block_until_ready(metrics)
        now = time.perf_counter()
        rows = progress_rows(
            metrics,
            iteration,
            config.environment_count * config.step_count,
            (before + last - started, before + now - started),
        )
        append_rows(csv_path, rows)
        say(progress_line(rows[-1], config.iteration_count))
        iteration, last = iteration + chunk, now
        over = before + now - started > options.time_limit_s
        if now - saved > options.checkpoint_period_s or over or iteration >= config.iteration_count:
            save_checkpoint(path, learner, fingerprint)
            saved = time.perf_counter()
    return learner, before + last - started


def accuracy_line(entry: Accuracy) -> str:
    """Accuracy at one range as a line of text."""
    failures = ", ".join(f"{count} {name}" for name, count in entry.failure_count.items())
    landed = f"{entry.range_m:6.2f} m  landed {entry.landed_count}/{entry.throw_count}  "
    if not entry.landed_count:
        return f"{landed}{failures}"
    return (
        f"{landed}"
        f"down {100 * entry.downrange_mean_m:+.1f} sd {100 * entry.downrange_sd_m:.1f} cm  "
        f"cross {100 * entry.crossrange_mean_m:+.1f} sd {100 * entry.crossrange_sd_m:.1f} cm  "
        f"{entry.duration_s:.2f} s  {failures}"
    )


def current_commit() -> str:
    """Commit of the working tree, with ``+`` where it has changes; ``unknown`` outside a repository."""
    here = Path(__file__).parent
    try:
        run = subprocess.run(
            ["git", "describe", "--always", "--dirty=+", "--abbrev=40", "--match="],
            cwd=here,
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return run.stdout.strip()


def _resolved(task: TaskConfig, config: PpoConfig, options: RunOptions) -> dict[str, Any]:
    """Configuration for the card: every field, and the files of the identified response, if any."""
    resolved = {"task": _plain(asdict(task)), "ppo": _plain(asdict(config))}
    sources = [asdict(source) for source in options.response_sources]
    return {**resolved, "response_sources": sources} if sources else resolved


def _plain(value: Any) -> Any:
    """A dictionary of a dataclass with JSON values only."""
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        return value.item()
    return value
