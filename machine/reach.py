"""Checks of targets and pace, used by machine and server."""

import math

import numpy as np

from machine.conventions import Mode
from machine.errors import RefusedError, UsageError
from machine.messages import RejectReason, Target
from machine.policy_card import PolicyCard

MIN_RANGE_M = {Mode.PLANAR: 5.5, Mode.SPATIAL: 5.0}
"""Smallest range: nearer throws pass over the machine's legs and wheels."""

REACH_WITH_LOAD: dict[Mode, tuple[tuple[float, float], ...]] = {
    Mode.PLANAR: (
        (0.0, 1.0), (190.0, 1.0), (380.0, 0.925), (570.0, 0.875), (760.0, 0.775), (1140.0, 0.675),
    ),
    Mode.SPATIAL: ((0.0, 1.0), (190.0, 1.0), (380.0, 0.975), (570.0, 0.9), (760.0, 0.75)),
}  # fmt: skip
"""Mass of a load, kg, and up to which share of the card's reach it is thrown: policies learn with a ball.
Measured with gravel on the virtual machine: `python -m benchmarks.load_reach`."""


def reach_m(card: PolicyCard, height_m: float, load_kg: float = 0.0) -> float:
    """Largest target range of a policy at a height with a load of bulk material (0: its ball), m."""
    share = load_reach_ratio(card.mode, load_kg)
    if not card.reach_at_height_m:
        return share * card.target_range_max_m
    heights, ranges = zip(*card.reach_at_height_m, strict=True)
    return share * min(card.target_range_max_m, float(np.interp(height_m, heights, ranges)))


def load_reach_ratio(mode: Mode, load_kg: float) -> float:
    """Share of a card's reach that a load is thrown to; 0 beyond the masses that were thrown."""
    masses_kg, shares = zip(*REACH_WITH_LOAD[mode], strict=True)
    return float(np.interp(load_kg, masses_kg, shares, right=0.0))


def check_pace(pace_ratio: float) -> None:
    """Refuse a pace outside of 0 (careful) .. 1 (fast).

    Raises:
        UsageError: with the value.
    """
    if not 0.0 <= pace_ratio <= 1.0:
        raise UsageError(f"pace {pace_ratio:g}: it lies between 0 (careful) and 1 (fast)")


def check_target(card: PolicyCard, target: Target, load_kg: float = 0.0) -> None:
    """Refuse a target outside the policy's range and heights, with a load of bulk material (0: its ball).

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
    raised = f" at height {target.z_m:+.2f} m" if target.z_m else ""
    loaded_m = reach_m(card, target.z_m, load_kg)
    if loaded_m + 1e-9 < range_m <= farthest + 1e-9:
        loaded = f"reaches {loaded_m:.2f} m" if loaded_m >= nearest else "reaches no target"
        raise RefusedError(
            RejectReason.TARGET_OUT_OF_REACH,
            f"Refused: target {range_m:.2f} m, {label} {loaded}{raised} with {load_kg:.0f} kg. "
            "Take a smaller grab or move the target closer.",
        )
    if range_m > farthest + 1e-9:
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
