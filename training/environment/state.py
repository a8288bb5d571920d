"""What an environment starts from and what changes in it: tables of starts, and the state of a batch."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from machine.conventions import Array, Mode
from machine.spec import MachineSpec
from machine.starts import sample_starts
from training.environment.dynamics import ResponseState
from training.environment.episode import EpisodeDraw
from training.environment.task import TaskConfig

Field = Any
DELAY_TICKS = 21
"""Length of the delay line: the longest dead time is 0.20 s."""


class StartTable(NamedTuple):
    """Start poses with their targets, frame `throw`."""

    start_rad_m: Field
    """(M, 6)."""
    target_m: Field
    """(M, 3), on the x axis."""


def start_table(
    spec: MachineSpec, mode: Mode, range_m: Array, height_m: Array, rng: np.random.Generator
) -> StartTable:
    """Draw a valid start for every target at distances `range_m` (M,) and heights `height_m` (M,)."""
    target = np.stack([range_m, np.zeros_like(range_m), height_m], axis=-1)
    start = sample_starts(spec, mode, target, rng)
    return StartTable(jnp.asarray(start, jnp.float32), jnp.asarray(target, jnp.float32))


def random_table(spec: MachineSpec, task: TaskConfig, seed: int) -> StartTable:
    """The table a training run draws its episodes from: targets a machine may be told to hit.

    That is farther than the targets it is asked for, by what a registration may add to the aim.
    """
    rng, episode = np.random.default_rng(seed), task.episode
    count, (near, far) = episode.start_count, episode.target_range_m
    height_m = rng.uniform(*episode.target_height_m, count)
    height_m[: round(episode.ground_share_ratio * count)] = 0.0
    reach_m = np.full(count, np.inf)
    if episode.reach_at_height_m:
        reach_m = np.interp(height_m, *np.transpose(episode.reach_at_height_m))
    range_m = rng.uniform(near, np.minimum(far, reach_m) + episode.aim_margin_m)
    return start_table(spec, task.mode, range_m, height_m, rng)


class EnvironmentState(NamedTuple):
    """Everything that changes, leading axis N = environments."""

    position: Field
    """(N, 6) rad, m."""
    velocity: Field
    """(N, 6)."""
    response: ResponseState
    """(N, 4) each: the driven joints' lags."""
    reference: Field
    """(N, 4) last shaped velocity reference."""
    delay_line: Field
    """(N, DELAY_TICKS, 4) references, newest first."""
    disturbance: Field
    """(N, 4)."""
    q_history: Field
    """(N, 4, 6) what the policy saw, newest first."""
    v_history: Field
    """(N, 4, 6)."""
    previous_action: Field
    """(N, A)."""
    opened: Field
    """(N,) 1.0 once the release was commanded."""
    leave_in_s: Field
    """(N,) time until the load leaves, counts down after the command."""
    time_s: Field
    """(N,) since the start."""
    impact_distance_m: Field
    """(N,) distance of the hypothetical impact to the target."""
    best_error_m: Field
    """(N, 2) smallest horizontal and 3D distance of the load to the target so far (paper)."""
    ball: Field
    """(N, 6) flying load: position, velocity; only where it has left."""
    gone_s: Field
    """(N,) time since the load has left; -1 while it is held."""
    flight_s: Field
    """(N,) time of flight of the present (or hypothetical) throw."""
    landing_m: Field
    """(N, 2) where it will land."""
    shortfall_m: Field
    """(N,) by how much it stays below the target's height at its highest."""
    draw: EpisodeDraw
    """What was drawn for this episode."""
