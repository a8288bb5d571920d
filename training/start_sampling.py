"""Sampling of the starts of episodes: uniformly, or in proportion to the miss of earlier episodes.

Prioritised level replay (Jiang et al. 2021) with the miss as score. Some combinations, such as a retracted
telescope and a far target, are rare and hard, so that uniform sampling covers them too little.
"""

from typing import Any

import jax
import jax.numpy as jnp

from training.environment.episode import StepInfo

Field = Any

WORST_MISS_M = 0.6
"""Largest score, also that of a failure, m: targets out of reach must not take all episodes."""
NEWEST_RATIO = 0.3
"""Weight of a start's newest episode in its score, an exponential moving average."""


def first_scores(count: int) -> Field:
    """Equal scores (M,) for the start of a training, m."""
    return jnp.full(count, WORST_MISS_M, jnp.float32)


def draw_starts(
    key: Field, scores_m: Field, shape: tuple[int, ...], hard_share_ratio: float
) -> Field:
    """Rows of the table, of the given shape: a share in proportion to the scores (M,), the others uniform."""
    keys = jax.random.split(key, 3)
    rows = scores_m.shape[0]
    even = jax.random.randint(keys[0], shape, 0, rows)
    if hard_share_ratio <= 0.0:
        return even
    edges = jnp.cumsum(scores_m)
    at = jax.random.uniform(keys[1], shape) * edges[-1]
    hard = jnp.clip(jnp.searchsorted(edges, at.reshape(-1)).reshape(shape), 0, rows - 1)
    return jnp.where(jax.random.uniform(keys[2], shape) < hard_share_ratio, hard, even)


def rescored(scores_m: Field, rows: Field, info: StepInfo) -> Field:
    """Scores (M,) after steps (T, N) of episodes that began at rows (T, N) of the table."""
    miss = jnp.hypot(info.miss_m[..., 0], info.miss_m[..., 1])
    worst = jnp.where(info.landed, jnp.minimum(miss, WORST_MISS_M), WORST_MISS_M)
    newest = scores_m[rows] + NEWEST_RATIO * (worst - scores_m[rows])
    # Episodes that go on write past the end of the table, which JAX drops.
    ended = jnp.where(info.done, rows, scores_m.shape[0])
    return scores_m.at[ended].set(newest, mode="drop")
