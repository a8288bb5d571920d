"""Rewards of one control step: the shipped one and the paper's (section III-D). Pure, batched."""

from typing import Any, NamedTuple

import jax.numpy as jnp

from machine.conventions import POLICY_PERIOD_S
from training.environment.task import RewardConfig

Field = Any


class RewardInputs(NamedTuple):
    """Inputs of the reward of one step; leading axis N."""

    action: Field
    """(N, A) clipped to [-1, 1]."""
    previous_action: Field
    """(N, A)."""
    opened: Field
    """(N,) 1.0 once the release was commanded."""
    progress_m: Field
    """(N,) decrease of the predicted impact's distance from the target."""
    error_m: Field
    """(N, 2) horizontal and 3D distance of the load from the target."""
    best_error_m: Field
    """(N, 2) smallest such distances before this step."""
    landed: Field
    """(N,) bool: the episode ended with a landing in this step."""
    landing_error_m: Field
    """(N,) distance of the landing from the target."""
    failed: Field
    """(N,) bool: the episode failed in this step."""
    pace_ratio: Field
    """(N,) 0 careful .. 1 fast."""
    holds: Field
    """(N,) bool: the load was held at the beginning of this step."""
    left_m_per_s: Field
    """(N,) speed of a load released in this step, else 0."""
    hurry_ratio: Field
    """() share of the loss for time that is charged."""


def step_reward(config: RewardConfig, inputs: RewardInputs, *, is_paced: bool = False) -> Field:
    """Reward (N,) of one step."""
    reward = paper_reward if config.kind == "paper" else impact_reward
    return reward(config, inputs) - (pace_loss(config, inputs) if is_paced else 0.0)


def pace_loss(config: RewardConfig, inputs: RewardInputs) -> Field:
    """Loss (N,) for time at a fast pace, and for large actions and release speed at a careful one."""
    careful = 1.0 - inputs.pace_ratio
    whole = config.hurry_per_s_ratio * POLICY_PERIOD_S * jnp.square(inputs.pace_ratio)
    hurry = inputs.hurry_ratio * whole
    care = config.care_action_ratio * careful * _squared(inputs.action[:, :-1])
    release = config.care_release_ratio * careful * jnp.square(inputs.left_m_per_s)
    return jnp.where(inputs.holds, hurry + care + release, 0.0)


def hurry_share(config: RewardConfig, training_ratio: Field) -> Field:
    """Share () of the loss for time that is charged after a share () of the training."""
    first, last = config.hurry_from_ratio
    return jnp.clip((training_ratio - first) / (last - first), 0.0, 1.0)


def impact_reward(config: RewardConfig, inputs: RewardInputs) -> Field:
    """Shipped reward (N,): progress of the predicted impact, action costs, Gaussians of the landing error."""
    error = inputs.landing_error_m
    bells = sum(
        height * jnp.exp(-jnp.square(error / width))
        for height, width in zip(config.landing_height_ratio, config.landing_width_m, strict=True)
    )
    far = jnp.minimum(error, config.landing_linear_limit_m)
    landing = bells - config.landing_linear_ratio * far
    return (
        config.progress_ratio * jnp.clip(inputs.progress_m, -5.0, 5.0)
        - config.action_difference_ratio * _squared(inputs.action - inputs.previous_action)
        - config.action_ratio * _squared(inputs.action[:, :-1])
        + jnp.where(inputs.landed, landing, 0.0)
        - jnp.where(inputs.failed, config.failure_ratio, 0.0)
    )


def paper_reward(config: RewardConfig, inputs: RewardInputs) -> Field:
    """Paper: r = c1 r_delta_err + c2 r_err_3D - c3 r_act_diff - c4 r_act, and the ends of the rollout."""
    # r_delta_err = max(0, err*_2D - err_2D) + max(0, err*_3D - err_3D)
    approach = jnp.maximum(inputs.best_error_m - inputs.error_m, 0.0).sum(-1)
    # r_err_3D = exp(-b1 |r* - r_ball|^2)
    closeness = jnp.exp(-config.closeness_per_m2_ratio * jnp.square(inputs.error_m[:, 1]))
    # r_act counts once the gripper was opened
    idle = _squared(inputs.action) * inputs.opened
    # exp(-b2 err_3D^2) when the ball reaches the ground
    landing = jnp.exp(-config.landing_per_m2_ratio * jnp.square(inputs.landing_error_m))
    return (
        config.approach_ratio * approach
        + config.closeness_ratio * closeness
        - config.action_difference_ratio * _squared(inputs.action - inputs.previous_action)
        - config.action_ratio * idle
        + jnp.where(inputs.landed, config.landing_paper_ratio * landing, 0.0)
        - jnp.where(inputs.failed, config.failure_ratio, 0.0)
    )


def _squared(values: Field) -> Field:
    return jnp.square(values).sum(-1)
