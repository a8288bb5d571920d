"""Randomised parameters of an episode, and how an episode ends."""

from enum import IntEnum
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from machine.spec import MachineSpec
from training.environment.dynamics import DriveResponse
from training.environment.task import ResponseConfig, TaskConfig

Field = Any


class EpisodeFailure(IntEnum):
    """Why an episode failed; 0: it did not."""

    NONE = 0
    NUMERIC = 1
    """The state is not finite or out of bounds: the episode ends with the loss of a failure."""
    COLLISION = 2
    LIMIT = 3
    SWING = 4
    TIMEOUT = 5
    SHORT = 6
    """The load never rose to the target's height. The missing height counts as landing error."""


class StepInfo(NamedTuple):
    """How a step ended; leading axis N."""

    done: Field
    """Bool: the episode is over."""
    landed: Field
    """Bool: it ended with a landing."""
    failure: Field
    """Failure code."""
    miss_m: Field
    """(N, 2) landing minus target, frame `throw`: downrange, crossrange left. Predicted before the end."""
    duration_s: Field
    """Since the start."""
    closest_m: Field
    """Smallest clearance in this step."""


class EpisodeDraw(NamedTuple):
    """Randomised parameters of one episode; leading axis N."""

    target_m: Field
    """(N, 3) frame `throw`."""
    plane_m: Field
    """(N,) height of the load's centre at impact."""
    response: DriveResponse
    """Each (N, 4)."""
    friction_scale_ratio: Field
    com_error_m: Field
    inertia_scale_ratio: Field
    mass_scale_ratio: Field
    telescope_to_pin_error_m: Field
    pitch_to_roll_error_m: Field
    roll_to_grip_error_m: Field
    payload_mass_kg: Field
    drag_per_m: Field
    release_delay_s: Field
    """(N,) of this release."""
    release_mean_s: Field
    """(N,) mean delay of this machine."""
    settle_delay_s: Field
    """(N,) from release to the start of the settle motion."""
    swing_bias_rad: Field
    """(N, 2) error of the estimated passive angles."""
    latency_s: Field
    """(N,) age of the observation."""
    grasp_m: Field
    """(N, 3) load minus grip centre, frame `machine`."""
    slip_m_per_s: Field
    """(N, 3) velocity that the opening claws add to the load."""
    pace_ratio: Field
    """(N,) 0 careful .. 1 fast; 0 in tasks without a pace."""


def draw_episode(
    key: Field, spec: MachineSpec, task: TaskConfig, target_m: Field, drag_per_m: float
) -> EpisodeDraw:
    """Draw the parameters of one episode for each target (N, 3)."""
    count = target_m.shape[0]
    keys = jax.random.split(key, 4)
    scalars = jax.random.uniform(keys[1], (12, count))
    normals = jax.random.normal(keys[2], (3, count))
    toss = jax.random.normal(keys[3], (2, count, 3))
    passive, sensor = task.passive, task.sensor

    def scalar(index: int, limits: tuple[float, float]) -> Field:
        return limits[0] + (limits[1] - limits[0]) * scalars[index]

    mass = scalar(3, passive.payload_mass_kg)
    delay_mean = scalar(5, passive.release_delay_mean_s)
    delay = delay_mean + passive.release_delay_sd_s * jnp.clip(normals[0], -3.0, 3.0)
    direction = toss[0] / jnp.linalg.norm(toss[0], axis=-1, keepdims=True)
    low, high = task.episode.pace_ratio or (0.0, 0.0)
    grasp = passive.grasp_error_m * (0.5 + 0.5 * scalars[11])
    return EpisodeDraw(
        target_m=target_m,
        plane_m=target_m[:, 2] + spec.ball.radius_m,
        response=_draw_response(keys[0], task.response, count),
        friction_scale_ratio=scalar(0, passive.friction_scale_ratio),
        com_error_m=scalar(1, passive.gripper_com_error_m),
        inertia_scale_ratio=scalar(2, passive.gripper_inertia_scale_ratio),
        mass_scale_ratio=scalar(7, passive.gripper_mass_scale_ratio),
        telescope_to_pin_error_m=scalar(8, passive.telescope_to_pin_error_m),
        pitch_to_roll_error_m=scalar(9, passive.pitch_to_roll_error_m),
        roll_to_grip_error_m=scalar(10, passive.roll_to_grip_error_m),
        payload_mass_kg=mass,
        drag_per_m=drag_per_m * scalar(4, passive.drag_scale_ratio) * spec.ball.mass_kg / mass,
        release_delay_s=delay,
        release_mean_s=delay_mean,
        # Delay and latency share one random number: both stand for the delay of one control system.
        settle_delay_s=scalar(6, task.episode.settle_delay_s),
        swing_bias_rad=sensor.swing_bias_sd_rad * normals[1:3].T,
        latency_s=scalar(6, sensor.latency_s),
        grasp_m=grasp[:, None] * direction,
        slip_m_per_s=passive.slip_sd_m_per_s * toss[1],
        pace_ratio=jax.random.uniform(
            jax.random.fold_in(key, 4), (count,), minval=low, maxval=high
        ),
    )


def _draw_response(key: Field, config: ResponseConfig, count: int) -> DriveResponse:
    """Uniform between minimum and maximum, independent for every joint and parameter."""
    share = jax.random.uniform(key, (6, count, 4))
    reaction = jax.random.uniform(jax.random.fold_in(key, 1), (2, count))

    def joints(index: int, low: tuple[float, ...], high: tuple[float, ...]) -> Field:
        lower, upper = jnp.asarray(low), jnp.asarray(high)
        return lower + (upper - lower) * share[index]

    def between(limits: tuple[float, float], drawn: Field) -> Field:
        return limits[0] + (limits[1] - limits[0]) * drawn

    c = config
    return DriveResponse(
        dead_time_s=joints(0, c.dead_time_min_s, c.dead_time_max_s),
        lag_s=joints(1, c.lag_min_s, c.lag_max_s),
        natural_frequency_rad_per_s=joints(
            2, c.natural_frequency_min_rad_per_s, c.natural_frequency_max_rad_per_s
        ),
        damping_ratio=joints(3, c.damping_min_ratio, c.damping_max_ratio),
        gain_positive_ratio=joints(4, c.gain_positive_min_ratio, c.gain_positive_max_ratio),
        gain_negative_ratio=joints(5, c.gain_negative_min_ratio, c.gain_negative_max_ratio),
        boom_from_dipper_ratio=between(c.boom_from_dipper_ratio, reaction[0]),
        dipper_from_boom_ratio=between(c.dipper_from_boom_ratio, reaction[1]),
    )
