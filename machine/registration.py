"""Registration: mean miss of one machine with one policy, and aim points that correct it.

The term is from gunnery: the misses of some throws are surveyed, and the aim point is moved by the mean
miss. The scatter of throws is not affected.
"""

from collections.abc import Sequence
from enum import StrEnum

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from machine.conventions import Array, wrap_angle_rad

MAX_CORRECTION_M = 0.6
"""Largest correction of an aim point; a larger mean miss is a fault of the machine."""
NEAR_RAD = 0.25
"""Width of the term for 3D throws that start with the cabin near the target, whose mean miss differs from
that of throws that turn first (docs/decisions/0005-registration.md)."""
HEIGHT_SCALE_M = 3.0
"""Height at which the terms of height have weight 1."""


class TermKind(StrEnum):
    """Dependence of the mean miss besides the range."""

    NEAR = "near"
    """Cabin near the target at the start: exp(-(turn / `NEAR_RAD`)^2 / 2)."""
    TURN = "turn"
    """Turn to the target divided by pi, positive to the left."""
    HEIGHT = "height"
    """Height of the target divided by `HEIGHT_SCALE_M`."""
    HEIGHT_SQUARED = "height_squared"


class Term(BaseModel):
    """Mean miss per unit of its kind, at every range of the registration; frame `throw`."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    kind: TermKind
    downrange_m: tuple[float, ...]
    crossrange_m: tuple[float, ...]


class Registration(BaseModel):
    """Mean miss of one machine with one policy, frame `throw`: table over the range, and further terms."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    policy_sha256: str
    throw_count: int = Field(ge=1)
    range_m: tuple[float, ...] = Field(min_length=1)
    downrange_m: tuple[float, ...]
    crossrange_m: tuple[float, ...]
    range_per_height_ratio: float = 0.0
    """Range added per metre of height for reading the tables: a raised target is on the trajectory to ground
    level behind it."""
    terms: tuple[Term, ...] = ()
    """Empty in files without terms."""

    @model_validator(mode="after")
    def _fits(self) -> "Registration":
        sides = [(self.downrange_m, self.crossrange_m)]
        sides += [(term.downrange_m, term.crossrange_m) for term in self.terms]
        if any(len(side) != len(self.range_m) for pair in sides for side in pair):
            raise ValueError("a registration needs as many misses as ranges")
        if np.any(np.diff(self.range_m) <= 0.0):
            raise ValueError("the ranges of a registration must increase")
        if len({term.kind for term in self.terms}) != len(self.terms):
            raise ValueError("a registration has each of its terms once")
        worst = max(abs(miss) for pair in sides for side in pair for miss in side)
        if worst > MAX_CORRECTION_M:
            raise ValueError(too_much(worst))
        return self

    def miss(self, range_m: Array, height_m: Array, turn_rad: Array) -> tuple[Array, Array]:
        """Mean miss (N,) downrange and crossrange of throws aimed at a range (N,) and a height (N,), m.

        Args:
            range_m: horizontal distance aimed at.
            height_m: height of the aim point above ground.
            turn_rad: (N,) turn of the cabin to the target, positive to the left.
        """
        at = range_m + self.range_per_height_ratio * height_m
        down = np.interp(at, self.range_m, self.downrange_m)
        cross = np.interp(at, self.range_m, self.crossrange_m)
        weights = features([term.kind for term in self.terms], height_m, turn_rad)
        for term, weight in zip(self.terms, weights, strict=True):
            down = down + weight * np.interp(at, self.range_m, term.downrange_m)
            cross = cross + weight * np.interp(at, self.range_m, term.crossrange_m)
        most = MAX_CORRECTION_M
        return np.clip(down, -most, most), np.clip(cross, -most, most)

    def aim(self, target_m: Array, slew_rad: Array) -> Array:
        """Aim points (N, 3) with which loads hit `target_m` (N, 3) on average; frame `machine`.

        Args:
            target_m: targets.
            slew_rad: (N,) slew angle at the start of the throw.
        """
        range_m = np.hypot(target_m[:, 0], target_m[:, 1])
        safe_m = np.maximum(range_m, 1e-9)
        forward = target_m[:, :2] / safe_m[:, None]
        left = np.stack([-forward[:, 1], forward[:, 0]], axis=-1)
        bearing = np.arctan2(target_m[:, 1], target_m[:, 0])
        turn = np.asarray(wrap_angle_rad(bearing - slew_rad))
        # The miss depends on the range of the aim point, not of the target.
        first_m = range_m - self.miss(range_m, target_m[:, 2], turn)[0]
        down, _ = self.miss(first_m, target_m[:, 2], turn)
        _, cross = self.miss(range_m - down, target_m[:, 2], turn)
        aim = np.array(target_m, dtype=np.float64)
        aim[:, :2] -= down[:, None] * forward + cross[:, None] * left
        return aim


def too_much(miss_m: float) -> str:
    """Text of the refusal to correct a mean miss."""
    return (
        f"a mean miss of {miss_m:.2f} m is more than the {MAX_CORRECTION_M} m that aiming may "
        "correct: find its cause with `downrange diagnose throws`"
    )


def features(kinds: Sequence[TermKind], height_m: Array, turn_rad: Array) -> list[Array]:
    """Weight (N,) of each kind of term for throws to heights (N,) with turns (N,)."""
    height = height_m / HEIGHT_SCALE_M
    found: dict[TermKind, Array] = {
        TermKind.NEAR: np.exp(-0.5 * (turn_rad / NEAR_RAD) ** 2),
        TermKind.TURN: turn_rad / np.pi,
        TermKind.HEIGHT: height,
        TermKind.HEIGHT_SQUARED: height * height,
    }
    return [found[kind] for kind in kinds]
