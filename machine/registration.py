"""Registration: where a machine's loads come down on average, and where to aim so that they hit.

Gunners call it that: a few throws are surveyed, and the aim is moved by the mean miss. It corrects what
one machine does with one policy at each range; the spread stays what it is.
"""

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from machine.conventions import Array

SMOOTHING_RANGE_M = 0.2
"""Width of the kernel over the range: the miss of a policy changes within half a metre."""
KNOT_STEP_M = 0.25
PRIOR_THROW_COUNT = 1.0
"""Throws without a miss to every mean, so that one odd throw moves little."""
MAX_CORRECTION_M = 0.6
"""A mean miss beyond this is a fault to be found, not to be aimed away."""


class Registration(BaseModel):
    """Mean miss of one machine with one policy over the range aimed at, frame `throw`."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    policy_sha256: str
    throw_count: int = Field(ge=1)
    range_m: tuple[float, ...] = Field(min_length=1)
    downrange_m: tuple[float, ...]
    crossrange_m: tuple[float, ...]

    @model_validator(mode="after")
    def _fits(self) -> "Registration":
        if not len(self.range_m) == len(self.downrange_m) == len(self.crossrange_m):
            raise ValueError("a registration needs as many misses as ranges")
        if np.any(np.diff(self.range_m) <= 0.0):
            raise ValueError("the ranges of a registration must increase")
        worst = max(map(abs, (*self.downrange_m, *self.crossrange_m)))
        if worst > MAX_CORRECTION_M:
            raise ValueError(
                f"a mean miss of {worst:.2f} m is more than the {MAX_CORRECTION_M} m that aiming may "
                "correct: find its cause with `downrange diagnose throws`"
            )
        return self

    def aim(self, target_m: Array) -> Array:
        """Points (N, 3) to aim at so that the loads hit `target_m` (N, 3) on average; frame `machine`."""
        range_m = np.hypot(target_m[:, 0], target_m[:, 1])
        safe_m = np.maximum(range_m, 1e-9)
        forward = target_m[:, :2] / safe_m[:, None]
        left = np.stack([-forward[:, 1], forward[:, 0]], axis=-1)
        # The miss belongs to the range aimed at, not to the one wished for.
        first_m = range_m - np.interp(range_m, self.range_m, self.downrange_m)
        down = np.interp(first_m, self.range_m, self.downrange_m)
        aimed_m = range_m - down
        cross = np.interp(aimed_m, self.range_m, self.crossrange_m)
        aim = np.array(target_m, dtype=np.float64)
        aim[:, :2] -= down[:, None] * forward + cross[:, None] * left
        return aim


def register(
    policy_sha256: str, aimed_range_m: Array, downrange_m: Array, crossrange_m: Array
) -> Registration:
    """Mean miss every quarter of a metre from surveyed throws; arrays (N,), misses from the point aimed at.

    Raises:
        ValueError: no throws, or a mean miss that aiming must not correct.
    """
    if aimed_range_m.size == 0:
        raise ValueError("a registration needs at least one throw that landed")
    first, last = (
        np.floor(aimed_range_m.min() / KNOT_STEP_M),
        np.ceil(aimed_range_m.max() / KNOT_STEP_M),
    )
    knots = KNOT_STEP_M * np.arange(first, last + 1.0)
    weight = np.exp(-0.5 * ((knots[:, None] - aimed_range_m) / SMOOTHING_RANGE_M) ** 2)
    total = weight.sum(axis=1) + PRIOR_THROW_COUNT
    return Registration(
        policy_sha256=policy_sha256,
        throw_count=int(aimed_range_m.size),
        range_m=tuple(knots.tolist()),
        downrange_m=tuple((weight @ downrange_m / total).tolist()),
        crossrange_m=tuple((weight @ crossrange_m / total).tolist()),
    )
