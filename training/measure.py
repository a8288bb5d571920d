"""Accuracy of a policy in the training environment, by target range."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np

from machine.conventions import DEFAULT_PACE_RATIO, POLICY_PERIOD_S
from machine.spec import MachineSpec
from training.environment.episode import EpisodeFailure, StepInfo
from training.environment.state import EnvironmentState, start_table
from training.environment.task import TaskConfig
from training.environment.throw_environment import ThrowEnvironment
from training.networks import Layers, Normaliser, apply_layers, normalise

Field = Any


@dataclass(frozen=True)
class Accuracy:
    """Accuracy of a policy at one target range."""

    range_m: float
    throw_count: int
    landed_count: int
    downrange_mean_m: float
    downrange_sd_m: float
    crossrange_mean_m: float
    crossrange_sd_m: float
    duration_s: float
    failure_count: dict[str, int]
    """Failed throws by kind of failure."""


def act(actor: Layers, normaliser: Normaliser, observation: Field) -> Field:
    """Mean action (N, A) for observations (N, D), as in the exported file."""
    width = observation.shape[-1]
    moments = Normaliser(normaliser.mean[:width], normaliser.variance[:width], normaliser.count)
    return apply_layers(actor, normalise(moments, observation))


_Compiled = tuple[Callable[..., Any], Callable[..., Any]]


class Measurement:
    """Deterministic throws at given ranges at ground level, at the default pace.

    Everything else is randomised as in training. Compilation takes longer than the throws: `prepare`
    compiles while the policy is still trained.
    """

    def __init__(
        self,
        spec: MachineSpec,
        task: TaskConfig,
        ranges_m: Sequence[float],
        throw_count: int,
        seed: int,
    ) -> None:
        """Draw the starts of `throw_count` throws at every range."""
        if task.episode.pace_ratio is not None:
            usual = replace(task.episode, pace_ratio=(DEFAULT_PACE_RATIO, DEFAULT_PACE_RATIO))
            task = replace(task, episode=usual)
        self._env = ThrowEnvironment(spec, task)
        self._ranges_m, self._throw_count = ranges_m, throw_count
        distance = np.repeat(np.asarray(ranges_m, dtype=np.float64), throw_count)
        rng = np.random.default_rng(seed)
        self._table = start_table(spec, task.mode, distance, np.zeros_like(distance), rng)
        reset_key, run_key = jax.random.split(jax.random.key(seed))
        # A load released at the last moment flies for at most 1.5 s.
        steps = int(task.episode.time_limit_s / POLICY_PERIOD_S) + 25
        self._reset_key, self._step_keys = reset_key, jax.random.split(run_key, steps)
        self._compiled: _Compiled | None = None

    def prepare(self, actor: Layers, normaliser: Normaliser) -> None:
        """Compile for networks of these shapes."""
        begin = jax.jit(self._begin).lower(self._reset_key).compile()
        state, end = jax.eval_shape(self._begin, self._reset_key)
        step = jax.jit(self._step).lower(actor, normaliser, state, end, self._reset_key).compile()
        self._compiled = (begin, step)

    def accuracy(self, actor: Layers, normaliser: Normaliser) -> list[Accuracy]:
        """Throw once from every start; one row per range."""
        if self._compiled is None:
            self.prepare(actor, normaliser)
        begin, step = cast(_Compiled, self._compiled)
        state, end = begin(self._reset_key)
        # A scan over the steps hangs on the CPU (JAX 0.10.2).
        for key in self._step_keys:
            state, end = step(actor, normaliser, state, end, key)
        thrown = jax.tree.map(np.asarray, end)
        result: list[Accuracy] = []
        for index, range_m in enumerate(self._ranges_m):
            rows = slice(index * self._throw_count, (index + 1) * self._throw_count)
            result.append(_accuracy(range_m, StepInfo(*(part[rows] for part in thrown))))
        return result

    def _begin(self, key: Field) -> tuple[EnvironmentState, StepInfo]:
        """New episodes, and empty infos for their ends."""
        count = self._table.start_rad_m.shape[0]
        state = self._env.reset(key, self._table, jnp.arange(count))
        action = jnp.zeros((count, self._env.action_count))
        _, _, info = jax.eval_shape(self._env.step, key, state, action)
        return state, jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), info)

    def _step(
        self,
        actor: Layers,
        normaliser: Normaliser,
        state: EnvironmentState,
        end: StepInfo,
        key: Field,
    ) -> tuple[EnvironmentState, StepInfo]:
        """One control step of the episodes that have not ended."""
        observation, _ = self._env.observe(state)
        after, _, info = self._env.step(key, state, act(actor, normaliser, observation))

        def keep(old: Field, new: Field) -> Field:
            return jnp.where(end.done.reshape(-1, *[1] * (new.ndim - 1)), old, new)

        return jax.tree.map(keep, state, after), jax.tree.map(keep, end, info)


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
            for code in EpisodeFailure
            if (failure == code).any()
        },
    )
