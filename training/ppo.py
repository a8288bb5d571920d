"""Proximal policy optimisation with generalised advantage estimation; iterations are one compiled scan.

Loss and bookkeeping follow Schulman et al. 2017 (PPO) and 2016 (GAE); the learning rate follows the
Kullback-Leibler divergence of each update, as in the paper's implementation.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax

from training.environment.episode import EpisodeFailure, StepInfo
from training.environment.reward import hurry_share
from training.environment.state import EnvironmentState, StartTable
from training.environment.task import PpoConfig
from training.environment.throw_environment import ThrowEnvironment
from training.networks import (
    Networks,
    Normaliser,
    apply_layers,
    make_networks,
    make_normaliser,
    normalise,
    update_normaliser,
)
from training.start_sampling import draw_starts, first_scores, rescored

Field = Any


class Learner(NamedTuple):
    """State that a run carries from iteration to iteration: the content of a checkpoint."""

    networks: Networks
    optimiser: Any
    normaliser: Normaliser
    learning_rate: Field
    environment: EnvironmentState
    start_row: Field
    """(N,) row of the start table at which each environment's episode began."""
    start_score_m: Field
    """(M,) scores of the starts of the table (training.start_sampling)."""
    key: Field
    iteration: Field
    """() completed iterations."""


class Batch(NamedTuple):
    """Data of one iteration: (T, N, ...) as collected, (M, ...) in a minibatch."""

    observation: Field
    """Observation and privileged values, not normalised."""
    action: Field
    log_probability: Field
    value: Field
    reward: Field
    done: Field
    drives: Field
    """1.0 where the action drives the joints; 0.0 during the settle motion after the release."""
    advantage: Field
    target: Field


class IterationMetrics(NamedTuple):
    """Sums over one iteration's steps; `training.progress` turns them into rates and moments."""

    reward: Field
    done: Field
    landed: Field
    failure: Field
    """(F,) episodes by failure code."""
    miss: Field
    miss_squared: Field
    within_quarter: Field
    """Landings within 0.25 m of the target."""
    duration: Field
    learning_rate: Field
    divergence: Field
    entropy: Field
    value_loss: Field
    deviation: Field


class Trainer:
    """Binds an environment, a start table and a configuration to pure functions of the learner."""

    def __init__(self, environment: ThrowEnvironment, table: StartTable, config: PpoConfig) -> None:
        self.environment = environment
        self.table = table
        self.config = config
        self._optimiser = optax.scale_by_adam(eps=1e-5)
        self._compiled: dict[int, Callable[[Learner], tuple[Learner, IterationMetrics]]] = {}
        """Compiled `advance`, by its number of iterations."""

    def prepared(self, key: Field, iterations: int) -> Learner:
        """Result of `start`; compiles `advance` for this number of iterations at the same time."""
        learner = jax.eval_shape(self.start, key)
        chunk = Trainer._advance.lower(self, learner, iterations)
        with ThreadPoolExecutor() as pool:
            # First, because it takes longest.
            advance = pool.submit(chunk.compile)
            start = Trainer.start.lower(self, key).compile()
            self._compiled[iterations] = advance.result()
        return start(key)

    @partial(jax.jit, static_argnums=0)
    def start(self, key: Field) -> Learner:
        """Initial networks and environments."""
        keys = jax.random.split(key, 4)
        count, env = self.config.environment_count, self.environment
        rows = jax.random.randint(keys[0], (count,), 0, self.table.start_rad_m.shape[0])
        state = env.reset(keys[1], self.table, rows)
        observation, hidden = env.observe(state)
        networks = make_networks(
            keys[2],
            observation.shape[1],
            hidden.shape[1],
            env.action_count,
            self.config.hidden_count,
            self.config.log_deviation_start_ratio,
        )
        learner = Learner(
            networks=networks,
            optimiser=self._optimiser.init(networks),
            normaliser=make_normaliser(observation.shape[1] + hidden.shape[1]),
            learning_rate=jnp.asarray(self.config.learning_rate_ratio, jnp.float32),
            environment=state,
            start_row=rows,
            start_score_m=first_scores(self.table.start_rad_m.shape[0]),
            key=keys[3],
            iteration=jnp.asarray(0, jnp.int32),
        )
        # Weakly typed leaves would make the second call of `advance` compile again.
        return jax.tree.map(lambda x: jax.lax.convert_element_type(x, x.dtype), learner)

    def advance(self, learner: Learner, iterations: int) -> tuple[Learner, IterationMetrics]:
        """Run iterations; the metrics have a leading axis of that length."""
        ready = self._compiled.get(iterations)
        return ready(learner) if ready is not None else self._advance(learner, iterations)

    @partial(jax.jit, static_argnums=(0, 2), donate_argnums=1)
    def _advance(self, learner: Learner, iterations: int) -> tuple[Learner, IterationMetrics]:
        return jax.lax.scan(lambda carry, _: self._iterate(carry), learner, length=iterations)

    def _iterate(self, learner: Learner) -> tuple[Learner, IterationMetrics]:
        key, roll_key, update_key = jax.random.split(learner.key, 3)
        learner, batch, collected = self._collect(roll_key, learner)
        normaliser = update_normaliser(learner.normaliser, batch.observation)
        # The update must see the observations as the actor saw them: with the moments of the collection.
        observation = normalise(learner.normaliser, batch.observation)
        batch = batch._replace(observation=observation)
        learner, losses = self._update(update_key, learner, batch)
        learner = learner._replace(normaliser=normaliser, key=key, iteration=learner.iteration + 1)
        deviation = jnp.exp(learner.networks.log_deviation).mean()
        metrics = collected._replace(
            learning_rate=learner.learning_rate,
            divergence=losses[0],
            value_loss=losses[1],
            entropy=losses[2],
            deviation=deviation,
        )
        return learner, metrics

    def _collect(self, key: Field, learner: Learner) -> tuple[Learner, Batch, IterationMetrics]:
        """Run the policy for `step_count` steps in every environment, then estimate advantages."""
        env, config = self.environment, self.config
        networks, normaliser = learner.networks, learner.normaliser
        deviation = jnp.exp(networks.log_deviation)
        kept_as = config.hidden_type
        hurry = hurry_share(env.task.reward, learner.iteration / config.iteration_count)

        def step(carry: tuple[EnvironmentState, Field], drawn: tuple[Field, Field]) -> Any:
            state, row = carry
            step_key, next_row = drawn
            keys = jax.random.split(step_key, 3)
            seen, hidden = env.observe(state)
            drives = env.drives(state).astype(jnp.float32)
            full = jnp.concatenate([seen, hidden], axis=-1)
            scaled = normalise(normaliser, full)
            mean = apply_layers(networks.actor, scaled[:, : seen.shape[1]], kept_as)
            value = apply_layers(networks.critic, scaled, kept_as)[:, 0]
            action = mean + deviation * jax.random.normal(keys[0], mean.shape)
            after, reward, info = env.step(keys[1], state, action, hurry)
            fresh = env.reset(keys[2], self.table, next_row)
            after = _select(info.done, fresh, after)
            log_probability = log_density(mean, networks.log_deviation, action)
            seen_row = Batch(
                full, action, log_probability, value, reward, info.done, drives, value, value
            )
            return (after, jnp.where(info.done, next_row, row)), (seen_row, info, row)

        keys = jax.random.split(key, config.step_count)
        shape = (config.step_count, config.environment_count)
        nexts = draw_starts(
            jax.random.fold_in(key, 1), learner.start_score_m, shape, config.hard_start_ratio
        )
        first = (learner.environment, learner.start_row)
        (state, row), (batch, info, rows) = jax.lax.scan(step, first, (keys, nexts))
        learner = learner._replace(
            environment=state,
            start_row=row,
            start_score_m=rescored(learner.start_score_m, rows, info),
        )
        seen, hidden = env.observe(state)
        scaled = normalise(normaliser, jnp.concatenate([seen, hidden], axis=-1))
        last_value = apply_layers(networks.critic, scaled, kept_as)[:, 0]
        advantage = self._advantages(batch, last_value)
        batch = batch._replace(advantage=advantage, target=advantage + batch.value)
        # One sum over all steps: a sum in every step is slow on a GPU.
        return learner, batch, _count(batch.reward, info)

    def _advantages(self, batch: Batch, last_value: Field) -> Field:
        gamma, trace = self.config.discount_ratio, self.config.trace_ratio

        def back(carry: tuple[Field, Field], row: tuple[Field, Field, Field]) -> tuple[Any, Field]:
            advantage, next_value = carry
            reward, done, value = row
            alive = 1.0 - done.astype(jnp.float32)
            # TD error: r_t + gamma V(s_{t+1}) - V(s_t); the value after an end is zero.
            delta = reward + gamma * alive * next_value - value
            advantage = delta + gamma * trace * alive * advantage
            return (advantage, value), advantage

        first = (jnp.zeros_like(last_value), last_value)
        rows = (batch.reward, batch.done, batch.value)
        return jax.lax.scan(back, first, rows, reverse=True)[1]

    def _update(self, key: Field, learner: Learner, batch: Batch) -> tuple[Learner, Field]:
        """Epochs of minibatches, split along the environments.

        Returns:
            Learner; means of divergence, value loss and entropy (3,).
        """
        config = self.config
        parts = config.minibatch_count
        share = batch.drives / jnp.maximum(batch.drives.sum(), 1.0)
        mean = (share * batch.advantage).sum()
        spread = jnp.sqrt((share * jnp.square(batch.advantage - mean)).sum())
        batch = batch._replace(advantage=(batch.advantage - mean) / (spread + 1e-8))
        done = jnp.minimum(1.0, 1.5 * learner.iteration / config.iteration_count)
        first, last = config.log_deviation_floor_ratio
        floor = first + (last - first) * done
        low, high = self._divergence_bounds(learner)

        def minibatch(carry: Any, rows: Field) -> tuple[Any, Field]:
            networks, optimiser, rate = carry
            part = jax.tree.map(lambda x: x[:, rows].reshape(-1, *x.shape[2:]), batch)
            gradient, losses = jax.grad(self._loss, has_aux=True)(networks, part)
            divergence = losses[0]
            rate = jnp.where(divergence > high, rate / 1.5, rate)
            rate = jnp.where((divergence < low) & (divergence > 0.0), rate * 1.5, rate)
            rate = jnp.clip(rate, *config.learning_rate_range_ratio)
            gradient = clip_gradient(gradient, config.gradient_norm_ratio)
            direction, optimiser = self._optimiser.update(gradient, optimiser)
            networks = jax.tree.map(lambda p, d: p - rate * d, networks, direction)
            deviation = jnp.maximum(networks.log_deviation, floor)
            return (networks._replace(log_deviation=deviation), optimiser, rate), losses

        def epoch(carry: Any, epoch_key: Field) -> tuple[Any, Field]:
            rows = jax.random.permutation(epoch_key, config.environment_count)
            return jax.lax.scan(minibatch, carry, rows.reshape(parts, -1))

        carry = (learner.networks, learner.optimiser, learner.learning_rate)
        keys = jax.random.split(key, config.epoch_count)
        (networks, optimiser, rate), losses = jax.lax.scan(epoch, carry, keys)
        learner = learner._replace(networks=networks, optimiser=optimiser, learning_rate=rate)
        return learner, losses.mean((0, 1))

    def _divergence_bounds(self, learner: Learner) -> tuple[Field, Field]:
        """Bounds () of the divergence, which shrink in the last part of the training."""
        config = self.config
        first, share = config.divergence_shrinks_from_ratio, config.divergence_last_ratio
        done = (learner.iteration / config.iteration_count - first) / (1.0 - first)
        scale = share ** jnp.clip(done, 0.0, 1.0)
        low, high = config.divergence_ratio
        return low * scale, high * scale

    def _loss(self, networks: Networks, part: Batch) -> tuple[Field, Field]:
        config = self.config
        width = networks.actor[0][0].shape[0]
        mean = apply_layers(networks.actor, part.observation[:, :width], config.hidden_type)
        value = apply_layers(networks.critic, part.observation, config.hidden_type)[:, 0]
        log_deviation = networks.log_deviation
        difference = log_density(mean, log_deviation, part.action) - part.log_probability
        ratio = jnp.exp(jnp.clip(difference, -20.0, 20.0))
        clipped = jnp.clip(ratio, 1.0 - config.clip_ratio, 1.0 + config.clip_ratio)
        # L_clip = -E[min(r A, clip(r, 1 - eps, 1 + eps) A)]
        share = part.drives / jnp.maximum(part.drives.sum(), 1.0)
        surrogate = -(share * jnp.minimum(ratio * part.advantage, clipped * part.advantage)).sum()
        value_loss = jnp.square(value - part.target).mean()
        entropy = (log_deviation + 0.5 * jnp.log(2.0 * jnp.pi * jnp.e)).sum()
        # Estimator of KL(old || new) that is never negative: r - 1 - log r.
        divergence = jax.lax.stop_gradient((share * (ratio - 1.0 - difference)).sum())
        total = surrogate + config.value_ratio * value_loss - config.entropy_ratio * entropy
        return total, jnp.stack([divergence, value_loss, entropy])


def clip_gradient(gradient: Networks, limit_ratio: float) -> Networks:
    """Limit the norms of the actor's and of the critic's gradient separately.

    A common norm would be that of the critic's gradient, which is much larger.
    """

    def clipped(tree: Any) -> Any:
        norm = jnp.sqrt(sum(jnp.square(x).sum() for x in jax.tree.leaves(tree)))
        scale = jnp.minimum(1.0, limit_ratio / jnp.maximum(norm, 1e-12))
        return jax.tree.map(lambda x: scale * x, tree)

    actor, log_deviation = clipped((gradient.actor, gradient.log_deviation))
    return Networks(actor, clipped(gradient.critic), log_deviation)


def log_density(mean: Field, log_deviation: Field, action: Field) -> Field:
    """Log probability (...) of actions (..., A) under independent normals."""
    scaled = (action - mean) * jnp.exp(-log_deviation)
    return (-0.5 * jnp.square(scaled) - log_deviation - 0.5 * jnp.log(2.0 * jnp.pi)).sum(-1)


def _select(done: Field, fresh: EnvironmentState, after: EnvironmentState) -> EnvironmentState:
    """The fresh state where an episode has ended, else the state after the step."""

    def pick(new: Field, old: Field) -> Field:
        return jnp.where(done.reshape(-1, *[1] * (new.ndim - 1)), new, old)

    return jax.tree.map(pick, fresh, after)


def _count(reward: Field, info: StepInfo) -> IterationMetrics:
    """Sums over the steps (T, N) of one iteration."""
    miss = jnp.where(info.landed, jnp.hypot(info.miss_m[..., 0], info.miss_m[..., 1]), 0.0)
    landed = info.landed.astype(jnp.float32)
    ended = info.done.astype(jnp.float32)
    codes = jnp.arange(len(EpisodeFailure))[:, None, None]
    zero = jnp.asarray(0.0)
    return IterationMetrics(
        reward=reward.sum(),
        done=ended.sum(),
        landed=landed.sum(),
        failure=((info.failure == codes) & info.done & ~info.landed)
        .astype(jnp.float32)
        .sum((1, 2)),
        miss=miss.sum(),
        miss_squared=jnp.square(miss).sum(),
        within_quarter=(info.landed & (miss < 0.25)).astype(jnp.float32).sum(),
        duration=jnp.where(info.done, info.duration_s, 0.0).sum(),
        learning_rate=zero,
        divergence=zero,
        entropy=zero,
        value_loss=zero,
        deviation=zero,
    )
