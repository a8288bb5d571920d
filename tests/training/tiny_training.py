"""Tiny configurations of the trainer, and environments whose compiled functions the tests share."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from machine.conventions import Mode
from machine.spec import load_spec
from training.environment.configurations import task_for
from training.environment.state import EnvironmentState, StartTable, random_table
from training.environment.task import TaskConfig
from training.environment.throw_environment import ThrowEnvironment

SPEC = load_spec()
COUNT = 256


def small_task(mode: Mode, reward: str = "impact") -> TaskConfig:
    """The shipped task with a small start table."""
    task = task_for(mode, "paper" if reward == "paper" else "impact")
    return replace(task, episode=replace(task.episode, start_count=4 * COUNT))


@dataclass(frozen=True)
class Throws:
    """One environment with its compiled functions and COUNT fresh episodes."""

    env: ThrowEnvironment
    table: StartTable
    fresh: EnvironmentState
    step: Callable[..., Any]
    observe: Callable[..., Any]

    def still(self, release: float = -1.0) -> jax.Array:
        """Actions (COUNT, A) that move nothing."""
        return jnp.zeros((COUNT, self.env.action_count)).at[:, -1].set(release)


@cache
def throws_of(mode: Mode, reward: str) -> Throws:
    """COUNT episodes of a configuration."""
    task = small_task(mode, reward)
    env = ThrowEnvironment(SPEC, task)
    table = random_table(SPEC, task, 3)
    if reward == "impact":
        reset = jax.jit(lambda key, rows: _strong(env.reset(key, table, rows)))
        fresh = reset(jax.random.key(5), jnp.arange(COUNT))
    else:
        # What is drawn at a reset does not depend on the reward.
        fresh = throws_of(mode, "impact").fresh
    step = jax.jit(lambda key, state, action: _strong(env.step(key, state, action)))
    return Throws(env, table, fresh, step, jax.jit(env.observe))


def _strong(tree: Any) -> Any:
    """Weakly typed leaves would make a function compile again when its result is given back to it."""
    return jax.tree.map(lambda x: jax.lax.convert_element_type(x, x.dtype), tree)


def host(tree: Any) -> Any:
    """Every leaf as a numpy array."""
    return jax.tree.map(np.asarray, tree)
