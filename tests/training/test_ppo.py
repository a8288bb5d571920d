"""The learner: advantages, loss, learning rate, and that it learns where learning is easy."""

from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.cases import each
from tests.training.tiny_training import host
from training.environment.configurations import planar_task
from training.environment.episode import StepInfo
from training.environment.state import StartTable
from training.environment.task import PpoConfig
from training.environment.throw_environment import ThrowEnvironment
from training.networks import apply_layers, make_normaliser, normalise, update_normaliser
from training.ppo import Batch, Learner, Trainer, clip_gradient, log_density

COUNT = 64


class PointState(NamedTuple):
    """One number to hit; the second one only the critic sees."""

    wanted: Any
    hidden: Any


class PointEnvironment:
    """Episodes of one step, paid by the square of the miss: what a learner must master first."""

    action_count = 1

    task = planar_task()

    def reset(self, key: Any, table: StartTable, rows: Any) -> PointState:
        wanted = table.target_m[rows, 0]
        return PointState(wanted, jnp.zeros_like(wanted))

    def observe(self, state: PointState) -> tuple[Any, Any]:
        return state.wanted[:, None], state.hidden[:, None]

    def drives(self, state: PointState) -> Any:
        return jnp.ones_like(state.wanted, dtype=bool)

    def step(
        self, key: Any, state: PointState, action: Any, hurry_ratio: Any
    ) -> tuple[PointState, Any, StepInfo]:
        miss = action[:, 0] - state.wanted
        yes, no = jnp.ones_like(miss, dtype=bool), jnp.zeros_like(miss)
        info = StepInfo(yes, yes, no.astype(jnp.int32), jnp.stack([miss, no], -1), no + 0.08, no)
        return state, -jnp.square(miss), info


@pytest.fixture(scope="module")
def trainer() -> Trainer:
    config = PpoConfig(
        environment_count=COUNT,
        step_count=8,
        iteration_count=60,
        hidden_count=(16,),
        minibatch_count=2,
        learning_rate_range_ratio=(1e-5, 1e-2),
    )
    wanted = np.random.default_rng(0).uniform(-1.0, 1.0, (256, 3))
    table = StartTable(jnp.zeros((256, 6)), jnp.asarray(wanted, jnp.float32))
    return Trainer(cast(ThrowEnvironment, PointEnvironment()), table, config)


@pytest.fixture(scope="module")
def learner(trainer: Trainer) -> Learner:
    return trainer.start(jax.random.key(0))


@pytest.fixture(scope="module")
def batch(trainer: Trainer, learner: Learner) -> Batch:
    """(T, N, ...) as the update gets it."""
    _, batch, _ = jax.jit(trainer._collect)(jax.random.key(1), learner)
    return batch._replace(observation=normalise(learner.normaliser, batch.observation))


@pytest.fixture(scope="module")
def update(trainer: Trainer) -> Any:
    return jax.jit(trainer._update)


@pytest.fixture(scope="module")
def gradient(trainer: Trainer) -> Any:
    """(networks, rows) -> loss, gradient."""
    return jax.jit(jax.value_and_grad(lambda networks, rows: trainer._loss(networks, rows)[0]))


def _flat(batch: Batch) -> Batch:
    return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), batch)


def test_advantages_are_those_of_a_plain_loop(trainer: Trainer):
    rng = np.random.default_rng(2)
    steps, count = 9, 5
    reward, value = rng.normal(size=(2, steps, count))
    done = rng.random((steps, count)) < 0.3
    last = rng.normal(size=count)
    gamma, trace = trainer.config.discount_ratio, trainer.config.trace_ratio
    expected = np.zeros((steps, count))
    for n in range(count):
        for t in range(steps):
            # Schulman 2016, eq. 16: sum of (gamma lambda)^k delta_(t+k) up to the end of the episode
            factor = 1.0
            for k in range(t, steps):
                after = last[n] if k == steps - 1 else value[k + 1, n]
                expected[t, n] += factor * (
                    reward[k, n] + (0.0 if done[k, n] else gamma * after) - value[k, n]
                )
                if done[k, n]:
                    break
                factor *= gamma * trace
    empty = jnp.zeros((steps, count))
    rows = Batch(*[empty] * len(Batch._fields))._replace(
        reward=jnp.asarray(reward, jnp.float32),
        value=jnp.asarray(value, jnp.float32),
        done=jnp.asarray(done),
    )
    ours = trainer._advantages(rows, jnp.asarray(last, jnp.float32))
    np.testing.assert_allclose(ours, expected, rtol=0.0, atol=2e-5)


def test_log_density_is_the_normal_distribution():
    mean, sd, action = np.array([0.3, -1.0]), np.array([0.5, 2.0]), np.array([1.0, 0.5])
    density = np.exp(-0.5 * ((action - mean) / sd) ** 2) / (sd * np.sqrt(2.0 * np.pi))
    ours = log_density(jnp.asarray(mean), jnp.log(jnp.asarray(sd)), jnp.asarray(action))
    assert float(ours) == pytest.approx(np.log(density).sum(), abs=1e-5)


def test_a_gradient_step_lowers_the_loss(gradient: Any, learner: Learner, batch: Batch):
    part = _flat(batch)
    before, slopes = gradient(learner.networks, part)
    stepped = jax.tree.map(lambda p, g: p - 1e-3 * g, learner.networks, slopes)
    after, _ = gradient(stepped, part)
    square = sum(float(np.square(g).sum()) for g in host(jax.tree.leaves(slopes)))
    assert square > 1e-3
    # First order: the loss falls by the step times the squared gradient.
    assert float(before - after) == pytest.approx(1e-3 * square, rel=0.2)


def test_the_ratio_is_clipped_only_where_it_would_go_too_far(
    gradient: Any, learner: Learner, batch: Batch
):
    part = _flat(batch)

    def pull(log_shift: float, advantage: float) -> float:
        """Size of the actor's gradient when all ratios are exp(log_shift)."""
        shifted = part._replace(
            log_probability=part.log_probability - log_shift,
            advantage=np.full(part.advantage.shape, advantage, np.float32),
        )
        _, slopes = gradient(learner.networks, shifted)
        return max(float(np.abs(g).max()) for g in host(jax.tree.leaves(slopes.actor)))

    assert pull(0.3, 1.0) == 0.0
    assert pull(-0.3, -1.0) == 0.0
    assert pull(0.3, -1.0) > 1e-4
    assert pull(-0.3, 1.0) > 1e-4
    assert pull(0.1, 1.0) > 1e-4


def test_steps_the_policy_did_not_drive_do_not_teach_the_actor(
    gradient: Any, learner: Learner, batch: Batch
):
    part = _flat(batch)
    drives = np.arange(part.drives.size) % 2
    rows = part._replace(drives=drives.astype(np.float32))
    twisted = np.where(drives > 0, part.advantage, np.float32(1e3))
    _, ours = gradient(learner.networks, rows)
    _, theirs = gradient(learner.networks, rows._replace(advantage=twisted))
    for one, other in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_batch_without_a_driven_step_leaves_finite_networks(
    update: Any, learner: Learner, batch: Batch
):
    idle = batch._replace(drives=jnp.zeros_like(batch.drives))
    after, losses = update(jax.random.key(2), learner, idle)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(after.networks))
    assert np.isfinite(losses).all()


@each(("log_shift", "grows"), [(1.0, False), (0.05, True)])
def test_the_learning_rate_follows_the_divergence(
    update: Any, learner: Learner, batch: Batch, log_shift: float, grows: bool
):
    # Without advantages the actor stays; the divergence is exp(d) - 1 - d of the shift alone.
    shifted = batch._replace(
        log_probability=batch.log_probability - log_shift,
        advantage=jnp.zeros_like(batch.advantage),
        target=batch.value,
    )
    start = learner._replace(learning_rate=jnp.asarray(3e-4, jnp.float32))
    after, losses = update(jax.random.key(3), start, shifted)
    assert float(losses[0]) == pytest.approx(np.exp(log_shift) - 1.0 - log_shift, rel=0.2)
    low, high = 1e-5, 1e-2
    expected = min(3e-4 * 1.5**10, high) if grows else max(3e-4 / 1.5**10, low)
    assert float(after.learning_rate) == pytest.approx(expected, rel=1e-4)


def test_the_spread_of_actions_keeps_its_floor(
    update: Any, trainer: Trainer, learner: Learner, batch: Batch
):
    first, last = trainer.config.log_deviation_floor_ratio
    for iteration, floor in ((0, first), (20, 0.5 * (first + last)), (40, last), (60, last)):
        narrow = learner._replace(
            networks=learner.networks._replace(log_deviation=jnp.full(1, -9.0, jnp.float32)),
            iteration=jnp.asarray(iteration, jnp.int32),
        )
        after, _ = update(jax.random.key(4), narrow, batch)
        # The last steps of the optimiser may lie above it.
        assert floor <= float(after.networks.log_deviation[0]) + 1e-6 < floor + 0.05


def test_the_normaliser_has_the_moments_of_everything_seen():
    rng = np.random.default_rng(5)
    first, second = rng.normal(3.0, 2.0, (7, 4, 3)), rng.normal(-1.0, 0.5, (50, 3))
    normaliser = make_normaliser(3)
    for part in (first, second):
        normaliser = update_normaliser(normaliser, jnp.asarray(part, jnp.float32))
    both = np.concatenate([first.reshape(-1, 3), second])
    np.testing.assert_allclose(normaliser.mean, both.mean(0), atol=1e-4)
    np.testing.assert_allclose(normaliser.variance, both.var(0), rtol=1e-4)
    scaled = normalise(normaliser, jnp.asarray([[0.0, 1e6, -1e6]]))
    np.testing.assert_allclose(scaled[0, 1:], [10.0, -10.0])


def test_an_easy_task_is_learned(trainer: Trainer):
    learner, metrics = trainer.advance(trainer.start(jax.random.key(6)), 60)
    reward = np.asarray(metrics.reward) / (COUNT * trainer.config.step_count)
    # Noise of 0.61 and targets of variance 1/3 at first; the floor of the noise, exp(-3), at the end.
    assert reward[0] == pytest.approx(-(0.61**2 + 1.0 / 3.0), rel=0.15)
    assert reward[-1] > -0.02
    assert int(learner.iteration) == 60
    assert np.asarray(metrics.done[-1]) == COUNT * trainer.config.step_count


def test_the_bounds_of_the_divergence_shrink_in_the_last_part(trainer: Trainer, learner: Learner):
    config = trainer.config
    whole, first = config.iteration_count, config.divergence_shrinks_from_ratio

    def bounds(share: float) -> np.ndarray:
        at = learner._replace(iteration=jnp.asarray(share * whole))
        return np.asarray(trainer._divergence_bounds(at))

    np.testing.assert_allclose(bounds(0.0), config.divergence_ratio, rtol=1e-6)
    np.testing.assert_allclose(bounds(first), config.divergence_ratio, rtol=1e-5)
    middle = np.sqrt(config.divergence_last_ratio) * np.asarray(config.divergence_ratio)
    np.testing.assert_allclose(bounds(0.5 * (first + 1.0)), middle, rtol=1e-5)
    last = config.divergence_last_ratio * np.asarray(config.divergence_ratio)
    np.testing.assert_allclose(bounds(1.0), last, rtol=1e-5)


def test_a_large_gradient_of_the_critic_leaves_the_actors_alone(learner: Learner):
    ones = jax.tree.map(jnp.ones_like, learner.networks)
    critic = jax.tree.map(lambda x: 1e3 * x, ones.critic)
    clipped = clip_gradient(ones._replace(critic=critic), 100.0)
    for ours, theirs in zip(
        jax.tree.leaves(clipped.actor), jax.tree.leaves(ones.actor), strict=True
    ):
        np.testing.assert_array_equal(ours, theirs)
    assert _norm(clipped.critic) == pytest.approx(100.0, rel=1e-5)
    shared = clip_gradient(ones, 0.5)
    assert _norm((shared.actor, shared.log_deviation)) == pytest.approx(0.5, rel=1e-5)


def _norm(tree: Any) -> float:
    return float(np.linalg.norm(np.concatenate([np.ravel(x) for x in jax.tree.leaves(tree)])))


def test_hidden_layers_in_bfloat16_are_the_same_network(learner: Learner):
    x = jax.random.normal(jax.random.key(2), (COUNT, 1))
    exact = apply_layers(learner.networks.actor, x)
    kept = apply_layers(learner.networks.actor, x, "bfloat16")
    assert kept.dtype == jnp.float32
    size = float(jnp.abs(exact).max())
    # bfloat16 keeps 8 bits: 0.4 % of each of 16 summands
    assert 0.0 < float(jnp.abs(kept - exact).max()) < 0.02 * size
