"""Accuracy of a policy in the training environment: one deterministic throw an environment, by distance."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from machine.conventions import DEFAULT_PACE_RATIO
from machine.spec import MachineSpec
from training.environment.environment import ThrowEnvironment
from training.environment.episode import Failure, StepInfo
from training.environment.state import StartTable, start_table
from training.environment.task import TaskConfig
from training.networks import Layers, Normaliser, apply_layers, normalise

Field = Any


@dataclass(frozen=True)
class Accuracy:
    """What a policy does at one target distance."""

    range_m: float
    throw_count: int
    landed_count: int
    downrange_mean_m: float
    downrange_sd_m: float
    crossrange_mean_m: float
    crossrange_sd_m: float
    duration_s: float
    failure_count: dict[str, int]
    """Throws by the way they failed."""


def act(actor: Layers, normaliser: Normaliser, observation: Field) -> Field:
    """Deterministic action (N, A) for observations (N, D): the mean, as in the exported file."""
    width = observation.shape[-1]
    moments = Normaliser(normaliser.mean[:width], normaliser.variance[:width], normaliser.count)
    return apply_layers(actor, normalise(moments, observation))


def throw_once(
    env: ThrowEnvironment, actor: Layers, normaliser: Normaliser, table: StartTable, key: Field
) -> StepInfo:
    """Throw once from every row of the table; the info of the step in which each episode ended."""
    count = table.start_rad_m.shape[0]
    reset_key, run_key = jax.random.split(key)
    state = jax.jit(env.reset)(reset_key, table, jnp.arange(count))
    # The load flies at most a second and a half after the last chance to release.
    steps = int(env.task.episode.time_limit_s / 0.08) + 25
    _, _, first = jax.eval_shape(env.step, key, state, jnp.zeros((count, env.action_count)))
    blank = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), first)

    # Not a scan over the steps: on the CPU that compiled, but never came back (JAX 0.10.2).
    @jax.jit
    def step(state: Any, end: StepInfo, step_key: Field) -> tuple[Any, StepInfo]:
        observation, _ = env.observe(state)
        action = act(actor, normaliser, observation)
        after, _, info = env.step(step_key, state, action)
        over = end.done

        def keep(old: Field, new: Field) -> Field:
            return jnp.where(over.reshape(-1, *[1] * (new.ndim - 1)), old, new)

        state = jax.tree.map(keep, state, after)
        return state, jax.tree.map(keep, end, info)

    end = blank
    for step_key in jax.random.split(run_key, steps):
        state, end = step(state, end, step_key)
    return end


def measure(
    spec: MachineSpec,
    task: TaskConfig,
    actor: Layers,
    normaliser: Normaliser,
    ranges_m: Sequence[float],
    throw_count: int,
    seed: int,
) -> list[Accuracy]:
    """Throw `throw_count` times at every distance on the ground, at the usual pace.

    Everything else is randomised as in training.
    """
    if task.episode.pace_ratio is not None:
        usual = replace(task.episode, pace_ratio=(DEFAULT_PACE_RATIO, DEFAULT_PACE_RATIO))
        task = replace(task, episode=usual)
    env = ThrowEnvironment(spec, task)
    rng = np.random.default_rng(seed)
    distance = np.repeat(np.asarray(ranges_m, dtype=np.float64), throw_count)
    table = start_table(spec, task.mode, distance, np.zeros_like(distance), rng)
    thrown = throw_once(env, actor, normaliser, table, jax.random.key(seed))
    end = jax.tree.map(np.asarray, thrown)
    result: list[Accuracy] = []
    for index, range_m in enumerate(ranges_m):
        rows = slice(index * throw_count, (index + 1) * throw_count)
        result.append(_accuracy(range_m, StepInfo(*(part[rows] for part in end))))
    return result


def _accuracy(range_m: float, end: StepInfo) -> Accuracy:
    landed = np.asarray(end.landed)
    miss = np.asarray(end.miss_m)[landed]
    failure = np.asarray(end.failure)[~landed]
    if not landed.any():
        miss = np.full((1, 2), np.nan)
    return Accuracy(
        range_m=float(range_m),
        throw_count=int(landed.size),
        landed_count=int(landed.sum()),
        downrange_mean_m=float(miss[:, 0].mean()),
        downrange_sd_m=float(miss[:, 0].std()),
        crossrange_mean_m=float(miss[:, 1].mean()),
        crossrange_sd_m=float(miss[:, 1].std()),
        duration_s=float(np.asarray(end.duration_s).mean()),
        failure_count={
            code.name.lower(): int((failure == code).sum())
            for code in Failure
            if (failure == code).any()
        },
    )
