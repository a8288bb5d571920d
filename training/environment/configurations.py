"""Shipped tasks and learners of both modes, and the paper's reward."""

from dataclasses import replace
from typing import Literal

from machine.conventions import Mode
from training.environment.task import (
    EpisodeConfig,
    PassiveConfig,
    PpoConfig,
    ResponseConfig,
    RewardConfig,
    TaskConfig,
    widened,
)

RESPONSE_WIDENING_RATIO = 1.25
"""Factor by which the ranges of the fitted responses are stretched for training."""
AIM_MARGIN_M = 0.4
"""How far beyond the requested ranges targets are drawn: a registration may move the aim point so far."""
GROUND_SHARE_RATIO = 0.6
"""Share of the targets at ground level."""
REACH_AT_HEIGHT_M = ((-1.0, 10.95), (0.0, 10.95), (1.0, 10.4), (2.0, 9.3), (3.0, 8.2))
"""Height of a target and its largest range, m. Up to 2 m: where the trajectory of the farthest throw at
ground level passes that height (release at 7.3 m range and 1.7 m height, 3.9 m/s outward, 3.5 m/s upward).
At 3 m: an estimate, since that trajectory does not reach it; the raised arm's grip then ends at 6.9 m."""
ANY_PACE = (0.0, 1.0)
"""Range of the pace: from careful to fast."""


def with_raised_targets(episode: EpisodeConfig) -> EpisodeConfig:
    """The same with some targets below and above ground level, and any pace."""
    return replace(
        episode,
        target_height_m=(-1.0, 3.0),
        ground_share_ratio=GROUND_SHARE_RATIO,
        reach_at_height_m=REACH_AT_HEIGHT_M,
        aim_margin_m=AIM_MARGIN_M,
        pace_ratio=ANY_PACE,
    )


def planar_task(reward: RewardConfig | None = None) -> TaskConfig:
    """2D: the arm plane contains the target; targets 6 to 10.95 m."""
    return TaskConfig(
        mode=Mode.PLANAR,
        episode=with_raised_targets(EpisodeConfig(target_range_m=(6.0, 10.95))),
        response=widened(
            ResponseConfig(disturbance_sd_rad_m_per_s=(0.0014, 0.011, 0.016, 0.0054)),
            RESPONSE_WIDENING_RATIO,
        ),
        passive=PassiveConfig(start_swing_sd_rad=(0.02, 0.03)),
        reward=reward or RewardConfig(),
    )


def spatial_task(reward: RewardConfig | None = None) -> TaskConfig:
    """3D: the cabin starts at any slew angle; targets 5 to 10.95 m."""
    return TaskConfig(
        mode=Mode.SPATIAL,
        episode=with_raised_targets(EpisodeConfig(target_range_m=(5.0, 10.95))),
        response=widened(ResponseConfig(), RESPONSE_WIDENING_RATIO),
        reward=reward or RewardConfig(),
    )


def paper_reward(task: TaskConfig) -> TaskConfig:
    """The same task with the paper's reward: targets at ground level, no pace, ends when the ball lands."""
    return replace(
        task,
        reward=RewardConfig(kind="paper", action_ratio=0.0005, action_difference_ratio=0.01),
        episode=replace(
            task.episode,
            target_height_m=(0.0, 0.0),
            reach_at_height_m=(),
            aim_margin_m=0.0,
            pace_ratio=None,
            after_release="policy",
            override_probability_ratio=0.05,
        ),
    )


def task_for(mode: Mode, reward: Literal["impact", "paper"] = "impact") -> TaskConfig:
    """The shipped task of a mode."""
    task = planar_task() if mode is Mode.PLANAR else spatial_task()
    return paper_reward(task) if reward == "paper" else task


def learner_for(mode: Mode, reward: Literal["impact", "paper"] = "impact") -> PpoConfig:
    """The shipped learner of a mode.

    2D has fewer iterations than the paper. 3D has a longer horizon and repeats starts with large misses.
    """
    if reward == "paper":
        return PpoConfig()
    if mode is Mode.PLANAR:
        return replace(PpoConfig(), iteration_count=3000)
    return replace(PpoConfig(), discount_ratio=0.998, hard_start_ratio=0.5)
