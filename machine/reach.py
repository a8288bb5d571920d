"""Checks of targets and pace, used by machine and server."""

import math

import numpy as np

from machine.conventions import Mode
from machine.errors import RefusedError, UsageError
from machine.messages import RejectReason, Target
from machine.policy_card import PolicyCard

MIN_RANGE_M = {Mode.PLANAR: 5.5, Mode.SPATIAL: 5.0}
"""Smallest range: nearer throws pass over the machine's legs and wheels."""


def reach_m(card: PolicyCard, height_m: float) -> float:
    """Largest target range of a policy at a height, m."""
    if not card.reach_at_height_m:
        return card.target_range_max_m
    heights, ranges = zip(*card.reach_at_height_m, strict=True)
    return min(card.target_range_max_m, float(np.interp(height_m, heights, ranges)))


def check_pace(pace_ratio: float) -> None:
    """Refuse a pace outside of 0 (careful) .. 1 (fast).

    Raises:
        UsageError: with the value.
    """
    if not 0.0 <= pace_ratio <= 1.0:
        raise UsageError(f"pace {pace_ratio:g}: it lies between 0 (careful) and 1 (fast)")


def check_target(card: PolicyCard, target: Target) -> None:
    """Refuse a target outside the policy's range and heights.

    Raises:
        RefusedError: too near, out of reach or outside the heights, with numbers and remedy.
    """
    range_m = math.hypot(target.x_m, target.y_m)
    nearest = max(card.target_range_min_m, MIN_RANGE_M[card.mode])
    label = card.mode.value.upper()
    if range_m < nearest:
        raise RefusedError(
            RejectReason.TARGET_TOO_NEAR,
            f"Refused: target {range_m:.2f} m, {label} throws from {nearest:.2f} m on. "
            "Move the target outward.",
        )
    farthest = reach_m(card, target.z_m)
    if range_m > farthest + 1e-9:
        raised = f" at height {target.z_m:+.2f} m" if target.z_m else ""
        raise RefusedError(
            RejectReason.TARGET_OUT_OF_REACH,
            f"Refused: target {range_m:.2f} m, {label} reaches {farthest:.2f} m{raised}. "
            "Move the target closer or the machine nearer.",
        )
    if not card.target_height_min_m - 1e-9 <= target.z_m <= card.target_height_max_m + 1e-9:
        low_m, high_m = card.target_height_min_m, card.target_height_max_m
        heights = f"to heights of {low_m:+.2f} to {high_m:+.2f} m"
        if low_m == high_m == 0.0:
            heights = "to the ground only (0.00 m)"
        raise RefusedError(
            RejectReason.TARGET_OUT_OF_REACH,
            f"Refused: target height {target.z_m:+.2f} m, policy {card.policy_id} throws {heights}. "
            f"Choose a target at such a height, or a policy that was trained for {target.z_m:+.2f} m.",
        )
