"""Table of start poses, state of a batch of environments, and the critic's additional inputs."""

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
"""Length of the delay line: dead times up to 0.20 s."""


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
    """Table of starts and targets that a training run draws its episodes from.

    Ranges extend beyond the requested ones by `aim_margin_m`, because a registration may move the aim
    point that far.
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
    """State of N environments."""

    position: Field
    """(N, 6) rad, m."""
    velocity: Field
    """(N, 6)."""
    response: ResponseState
    """(N, 4) each: states of the driven joints' response."""
    reference: Field
    """(N, 4) last velocity reference after rate and flow limits, rad/s and m/s."""
    delay_line: Field
    """(N, DELAY_TICKS, 4) references, newest first."""
    disturbance: Field
    """(N, 4) velocity disturbance, rad/s and m/s."""
    q_history: Field
    """(N, 4, 6) observed positions, newest first."""
    v_history: Field
    """(N, 4, 6) observed velocities, newest first."""
    previous_action: Field
    """(N, A)."""
    opened: Field
    """(N,) 1.0 once the release was commanded."""
    leave_in_s: Field
    """(N,) time until the load is released; counts down after the command."""
    time_s: Field
    """(N,) since the start."""
    impact_distance_m: Field
    """(N,) distance of the predicted impact from the target."""
    best_error_m: Field
    """(N, 2) smallest horizontal and 3D distance of the load to the target so far (paper)."""
    ball: Field
    """(N, 6) position and velocity of the load in flight; meaningless before the release."""
    gone_s: Field
    """(N,) time since the release; -1 while the load is held."""
    flight_s: Field
    """(N,) time of flight, predicted before the release."""
    landing_m: Field
    """(N, 2) landing point, predicted before the release."""
    shortfall_m: Field
    """(N,) by how much the apex of the flight stays below the target."""
    draw: EpisodeDraw
    """Randomised parameters of this episode."""


def privileged_values(state: EnvironmentState) -> Field:
    """True state and randomised parameters (N, P), scaled to order one: inputs of the critic only."""
    draw = state.draw
    response = draw.response
    slots = [
        10.0 * response.dead_time_s,
        0.1 * response.natural_frequency_rad_per_s,
        response.damping_ratio,
        10.0 * (response.gain_positive_ratio - 1.0),
        10.0 * (response.gain_negative_ratio - 1.0),
        response.lag_s,
        state.response.acceleration,
        state.response.lagged,
        10.0 * state.disturbance,
        state.reference,
        state.position,
        state.velocity,
        state.landing_m - draw.target_m[:, :2],
        state.shortfall_m[:, None],
        10.0 * draw.swing_bias_rad,
        10.0 * draw.grasp_m,
        10.0 * draw.slip_m_per_s,
    ]
    columns = [
        draw.friction_scale_ratio,
        10.0 * draw.com_error_m,
        10.0 * (draw.inertia_scale_ratio - 1.0),
        10.0 * (draw.mass_scale_ratio - 1.0),
        10.0 * draw.telescope_to_pin_error_m,
        10.0 * draw.pitch_to_roll_error_m,
        10.0 * draw.roll_to_grip_error_m,
        draw.payload_mass_kg,
        30.0 * draw.drag_per_m,
        10.0 * (draw.release_mean_s - 0.258),
        response.boom_from_dipper_ratio,
        response.dipper_from_boom_ratio,
        10.0 * state.leave_in_s * state.opened,
        state.opened,
        state.time_s,
        state.gone_s,
        jnp.minimum(state.impact_distance_m, 15.0),
    ]
    return jnp.concatenate([*slots, jnp.stack(columns, axis=-1)], axis=-1).astype(jnp.float32)
