"""Starts that went badly come again, and only as often as asked for."""

import jax
import jax.numpy as jnp
import numpy as np

from training.environment.episode import EpisodeFailure, StepInfo
from training.start_sampling import (
    NEWEST_RATIO,
    WORST_MISS_M,
    draw_starts,
    first_scores,
    rescored,
)

COUNT = 10
SHAPE = (200, 100)


def _info(done: list[bool], landed: list[bool], miss_m: list[float]) -> StepInfo:
    """One step of as many environments."""
    across = [0.0] * len(miss_m)
    return StepInfo(
        done=jnp.asarray([done]),
        landed=jnp.asarray([landed]),
        failure=jnp.full((1, len(done)), int(EpisodeFailure.NONE)),
        miss_m=jnp.stack([jnp.asarray([miss_m]), jnp.asarray([across])], axis=-1),
        duration_s=jnp.zeros((1, len(done))),
        closest_m=jnp.ones((1, len(done))),
    )


def test_half_of_the_starts_come_evenly_and_half_as_their_scores_say():
    scores = first_scores(COUNT).at[3].set(0.0).at[7].set(6.0 * WORST_MISS_M)
    rows = np.asarray(draw_starts(jax.random.key(0), scores, SHAPE, 0.5))
    share = np.bincount(rows.ravel(), minlength=COUNT) / rows.size
    # Scores sum to 8 + 6 = 14 times the first one.
    assert abs(share[3] - 0.05) < 0.01
    assert abs(share[7] - (0.05 + 0.5 * 6 / 14)) < 0.01
    assert abs(share[0] - (0.05 + 0.5 / 14)) < 0.01


def test_without_a_share_all_come_evenly_whatever_their_scores():
    scores = first_scores(COUNT).at[7].set(100.0)
    rows = np.asarray(draw_starts(jax.random.key(0), scores, SHAPE, 0.0))
    share = np.bincount(rows.ravel(), minlength=COUNT) / rows.size
    assert np.all(np.abs(share - 0.1) < 0.01)


def test_a_score_follows_the_misses_of_episodes_that_ended():
    info = _info(
        done=[True, True, True, False],
        landed=[True, True, False, False],
        miss_m=[0.1, 3.0, 0.1, 0.1],
    )
    rows = jnp.asarray([[0, 1, 2, 3]])
    after = np.asarray(rescored(0.5 * first_scores(COUNT), rows, info))
    before = 0.5 * WORST_MISS_M
    np.testing.assert_allclose(after[0], before + NEWEST_RATIO * (0.1 - before), rtol=1e-6)
    # A far miss and a failure count alike.
    np.testing.assert_allclose(after[1:3], before + NEWEST_RATIO * before, rtol=1e-6)
    np.testing.assert_allclose(after[3:], before, rtol=1e-6)
