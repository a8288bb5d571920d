"""Delay from the opening command to the load in free flight, from openings at rest or from throws.

There are two measurements. The gripper's switch reports late by its latch (15 to 40 ms,
diagnosis.loading.measured). The flight of a tracked load gives the moment of release. With a tracker the
latch is measured rather than assumed.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict
from scipy.optimize import least_squares

from diagnosis.identification.quantity import CONFIDENCE_RATIO, Quantity, mean_quantity, unknown
from diagnosis.loading.measured import SWITCH_LAG_S, SWITCH_TICK_S, measured_motion
from diagnosis.loading.throw_data import ThrowData
from diagnosis.loading.velocity_lag import velocity_lag_s
from machine.ballistics import drag_per_m, step_flight
from machine.conventions import CONTROL_PERIOD_S, Array
from machine.kinematics import grip_centre
from machine.spec import MachineSpec
from sim_twin.child_processes import one_blas_thread
from sim_twin.confidence_intervals import deviation_interval

PAPER_MEAN_S, PAPER_SD_S, PAPER_COUNT = 0.258, 0.015, 39
"""Paper, section III-F."""
LATCH_WIDTH_S = 0.025
"""Width of the uniform distribution of latch and debounce, s: 15 to 40 ms (docs/virtual_machine.md)."""
GRASP_SD_M = 0.06
"""Standard deviation of the load's place in the gripper at release, m, per axis: grasp, arm lengths,
levelling."""
TRACKER_SD_M = 0.02
MIN_TRACKED = 8
LATEST_S = 0.7
"""Longest delay after the command that is searched, s."""
MIN_COUNT = 3


class ReleaseDelay(BaseModel):
    """Release delay over all openings."""

    model_config = ConfigDict(frozen=True)
    mean: Quantity
    sd: Quantity
    latch: Quantity
    """Delay of the switch's report behind the release."""
    method: str
    """``tracker`` or ``switch``."""
    delays_s: tuple[float, ...]
    """Delay of each opening by that method."""
    single_sd_s: float
    """Measurement error of one opening, one standard deviation."""
    without_switch_count: int


class _Opening(NamedTuple):
    """One opening, s after the command; NaN where a measurement is missing."""

    switch_s: float
    tracked_s: float
    tracked_sd_s: float


def identify_release(throws: Sequence[ThrowData], spec: MachineSpec) -> ReleaseDelay:
    """Mean and standard deviation of the delay."""
    with one_blas_thread():
        openings = [_opening(throw, spec) for throw in throws]
    switch = np.array([o.switch_s for o in openings])
    tracked = np.array([o.tracked_s for o in openings])
    tracked_sd = np.array([o.tracked_sd_s for o in openings])
    has_tracker = int(np.isfinite(tracked).sum()) >= max(MIN_COUNT, len(openings) // 2)
    seen = np.isfinite(switch) & np.isfinite(tracked)
    if has_tracker:
        known = np.isfinite(tracked)
        delays, single = tracked[known], float(np.sqrt(np.mean(tracked_sd[known] ** 2)))
        if int(seen.sum()) >= 2:
            latch = mean_quantity((switch - SWITCH_TICK_S - tracked)[seen], "s")
        else:
            latch = unknown("s", "the switch said nothing")
    else:
        delays = (switch - SWITCH_TICK_S - SWITCH_LAG_S)[np.isfinite(switch)]
        # The latch and the phase of the tick that reads it, both uniform.
        single = math.hypot(LATCH_WIDTH_S, CONTROL_PERIOD_S) / math.sqrt(12.0)
        latch = unknown("s", "no tracked load; taken as 15 to 40 ms, all values alike")
    return ReleaseDelay(
        mean=_mean(delays, has_tracker),
        sd=_deviation(delays, single),
        latch=latch,
        method="tracker" if has_tracker else "switch",
        delays_s=tuple(float(d) for d in delays),
        single_sd_s=single,
        without_switch_count=int((~np.isfinite(switch)).sum()),
    )


def _mean(delays: Array, has_tracker: bool) -> Quantity:
    if delays.size < MIN_COUNT:
        return unknown(
            "s", f"{delays.size} openings were seen, {MIN_COUNT} are needed", count=delays.size
        )
    mean = mean_quantity(delays, "s")
    if has_tracker or mean.ci90 is None:
        return mean
    # Without a tracker the latch's mean is unknown; more openings do not narrow it.
    half = 0.45 * LATCH_WIDTH_S
    low, high = mean.ci90
    return mean.model_copy(
        update={
            "ci90": (low - half, high + half),
            "why": f"{1e3 * half:.0f} ms of the interval are the switch's latch, which only a tracker shows",
        }
    )


def _deviation(delays: Array, single_s: float) -> Quantity:
    """Standard deviation of the delay itself: the measurement's variance is subtracted."""
    n = int(delays.size)
    if n < MIN_COUNT:
        return unknown("s", f"{n} openings were seen, {MIN_COUNT} are needed", count=n)
    total = float(np.std(delays, ddof=1))
    low, high = deviation_interval(total, n, CONFIDENCE_RATIO)

    def without_error(sd: float) -> float:
        return math.sqrt(max(sd**2 - single_s**2, 0.0))

    if without_error(total) == 0.0:
        why = f"the scatter, {1e3 * total:.0f} ms, is no more than the measurement's own"
        return unknown("s", why, count=n)
    return Quantity(
        unit="s",
        value=without_error(total),
        ci90=(without_error(low), without_error(high)),
        count=n,
    )


def _opening(throw: ThrowData, spec: MachineSpec) -> _Opening:
    switch = throw.switch_open_t_s - throw.open_command_t_s
    if throw.ball_t_s.size < MIN_TRACKED:
        return _Opening(switch, math.nan, math.nan)
    tracked, sd = _let_go(throw, spec)
    return _Opening(switch, tracked, sd)


def _let_go(throw: ThrowData, spec: MachineSpec) -> tuple[float, float]:
    """Start of the tracked load's flight, s after the command, and its standard error.

    Before release the load moves with the grip centre; afterwards it flies ballistically. The motion of the
    grip is measured; the load's offset in the claws is fitted with its prior.
    """
    motion = measured_motion(throw, velocity_lag_s([throw]))
    position = np.concatenate([motion.position_rad_m, motion.swing_rad], axis=1)
    velocity = np.concatenate([motion.velocity_rad_m_per_s, motion.swing_rate_rad_per_s], axis=1)
    grip = grip_centre(spec, position, velocity)
    drag = drag_per_m(spec.ball)
    at = throw.ball_t_s

    def at_opening(table: Array, t_s: float) -> Array:
        return np.array([np.interp(t_s, motion.t_s, table[:, k]) for k in range(3)])

    def residual(x: Array) -> Array:
        t0 = throw.open_command_t_s + float(x[0])
        p, v = at_opening(grip.position_m, t0), at_opening(grip.velocity_m_per_s, t0)
        flown = np.empty((at.size, 3))
        last = t0
        for k, t in enumerate(at):
            if t > last:
                p, v = step_flight(p, v, drag, np.zeros(3), t - last)
                last = float(t)
            flown[k] = p
        misses = (flown + x[1:] - throw.ball_m).ravel() / TRACKER_SD_M
        return np.concatenate([misses, x[1:] / GRASP_SD_M])

    # The load is tracked from its first moment in the air on: it was free by then.
    first = float(np.clip(at[0] - throw.open_command_t_s, 0.02, LATEST_S - 0.02))
    start = np.array([max(first - 0.02, 0.0), 0.0, 0.0, 0.0])
    limits = ([0.0, -0.2, -0.2, -0.2], [LATEST_S, 0.2, 0.2, 0.2])
    found = least_squares(residual, start, bounds=limits, x_scale=[0.01, 0.02, 0.02, 0.02])
    covariance = np.linalg.pinv(found.jac.T @ found.jac)
    return float(found.x[0]), float(math.sqrt(max(covariance[0, 0], 0.0)))
