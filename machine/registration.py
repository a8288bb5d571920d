"""Registration: where a machine's loads come down on average, and where to aim so that they hit.

Gunners call it that: a few throws are surveyed, and the aim is moved by the mean miss. It corrects what
one machine does with one policy at each target; the spread stays what it is.
"""

from collections.abc import Sequence
from enum import StrEnum

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from machine.conventions import Array, wrap_angle_rad

MAX_CORRECTION_M = 0.6
"""A mean miss beyond this is a fault to be found, not to be aimed away; no aim is moved by more."""
NEAR_RAD = 0.25
"""Throws of 3D policies that begin with the cabin this near to the target miss otherwise than those that
turn first: on units 0 and 203 the difference is there below 0.1 rad and gone beyond 0.3 (decision 5)."""
HEIGHT_SCALE_M = 3.0
"""Height at which the terms of height count in full."""


class TermKind(StrEnum):
    """What a mean miss hangs on besides the range."""

    NEAR = "near"
    """The cabin stands near the target when the throw begins: exp(-(turn / `NEAR_RAD`)^2 / 2)."""
    TURN = "turn"
    """The turn to the target over half a turn, positive to the left."""
    HEIGHT = "height"
    """Height of the target over `HEIGHT_SCALE_M`."""
    HEIGHT_SQUARED = "height_squared"


class Term(BaseModel):
    """Mean miss a unit of its kind at every range of the registration; frame `throw`."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    kind: TermKind
    downrange_m: tuple[float, ...]
    crossrange_m: tuple[float, ...]


class Registration(BaseModel):
    """Mean miss of one machine with one policy, frame `throw`: over the range, and what is added to it."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    policy_sha256: str
    throw_count: int = Field(ge=1)
    range_m: tuple[float, ...] = Field(min_length=1)
    downrange_m: tuple[float, ...]
    crossrange_m: tuple[float, ...]
    range_per_height_ratio: float = 0.0
    """Added to the range a metre of height before the tables are read: what happens to a load on its way
    to a raised target happens on its way to the ground behind it, too."""
    terms: tuple[Term, ...] = ()
    """Empty in files from before heights and turns were registered."""

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
            height_m: of the point aimed at, above ground.
            turn_rad: (N,) that the cabin has to turn to the target, positive to the left.
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
        """Points (N, 3) to aim at so that the loads hit `target_m` (N, 3) on average; frame `machine`.

        Args:
            target_m: to be hit.
            slew_rad: (N,) where the cabin stands when the throw begins.
        """
        range_m = np.hypot(target_m[:, 0], target_m[:, 1])
        safe_m = np.maximum(range_m, 1e-9)
        forward = target_m[:, :2] / safe_m[:, None]
        left = np.stack([-forward[:, 1], forward[:, 0]], axis=-1)
        bearing = np.arctan2(target_m[:, 1], target_m[:, 0])
        turn = np.asarray(wrap_angle_rad(bearing - slew_rad))
        # The miss belongs to the range aimed at, not to the one wished for.
        first_m = range_m - self.miss(range_m, target_m[:, 2], turn)[0]
        down, _ = self.miss(first_m, target_m[:, 2], turn)
        _, cross = self.miss(range_m - down, target_m[:, 2], turn)
        aim = np.array(target_m, dtype=np.float64)
        aim[:, :2] -= down[:, None] * forward + cross[:, None] * left
        return aim


def too_much(miss_m: float) -> str:
    """Why a mean miss is not corrected."""
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
