"""Which starts of the table come next: half of them evenly, the other half as badly as they went before.

A few combinations (a drawn-in telescope and a far target, an extended one and a near target) are rare and
hard: drawn evenly they teach too little. Prioritised replay of levels (Jiang et al. 2021), the miss as score.
"""

from typing import Any

import jax
import jax.numpy as jnp

from training.environment.episode import StepInfo

Field = Any

WORST_MISS_M = 0.6
"""A miss counts no more than this, a failure as much: what nobody can reach must not take all episodes.
By eye, as are the weight below and the half: 0.8 in place of it throws no nearer (docs/training.md)."""
NEWEST_RATIO = 0.3
"""Weight of a start's newest episode in its score: single throws scatter, policies learn."""


def first_scores(count: int) -> Field:
    """Scores (M,) before anything was thrown, m: all alike."""
    return jnp.full(count, WORST_MISS_M, jnp.float32)


def draw_starts(
    key: Field, scores_m: Field, shape: tuple[int, ...], hard_share_ratio: float
) -> Field:
    """Rows of the table, of this shape: with `hard_share_ratio` in proportion to their scores (M,)."""
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
    """Scores (M,) after steps (T, N) of episodes that began at these rows (T, N) of the table."""
    miss = jnp.hypot(info.miss_m[..., 0], info.miss_m[..., 1])
    worst = jnp.where(info.landed, jnp.minimum(miss, WORST_MISS_M), WORST_MISS_M)
    newest = scores_m[rows] + NEWEST_RATIO * (worst - scores_m[rows])
    # What has not ended writes past the table, where nothing is kept.
    ended = jnp.where(info.done, rows, scores_m.shape[0])
    return scores_m.at[ended].set(newest, mode="drop")
