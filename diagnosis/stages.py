"""Contribution of each stage to the miss: simulated stages are replaced by measured ones, link by link.

The chain is simulated repeatedly, each time with one more link taken as measured. The change of the impact
is that link's term. The terms sum to measured minus twin:

    driven joints, one after the other   actuation, per joint
    swing                                swing
    moment of opening                    release
    speed of the load at release         release (needs the ball tracker)
    place and direction at release       aim (needs the ball tracker)
    flight and landing                   flight

Without a ball tracker the last three are one term, under flight. Intervals are bootstraps over throws.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from diagnosis.loading.prepared import PreparedThrow
from diagnosis.verdict import Miss, Stage, StageGap
from machine.ballistics import STEP_S, drag_per_m, step_flight
from machine.calibration import ValveCalibration
from machine.conventions import ACTIVE_JOINTS, Array
from machine.kinematics import to_throw_frame
from machine.spec import load_spec
from sim_twin.effects.table import EFFECTS
from sim_twin.replay.replay import ReplayElement, fly, replay
from sim_twin.replay.types import FourFlags
from sim_twin.twin.profile import TwinProfile

BOOTSTRAP_COUNT = 400
MIN_BALL_COUNT = 6
FREE_ACCELERATION_SD_M_PER_S2 = 2.0
"""Prior of a free constant acceleration in the fit of the release state, which absorbs drag or wind that
the twin lacks."""
TRACKER_SD_M = 0.02
"""Noise of the ball tracker, one standard deviation."""


class Terms(NamedTuple):
    """Terms of N throws; NaN where a throw has no impact."""

    names: tuple[tuple[Stage, str | None], ...]
    """(S,)"""
    term_m: Array
    """(S, N, 2) downrange and crossrange, frame `throw`."""
    gap_m: Array
    """(N, 2) measured minus twin."""
    simulated_m: Array
    """(N, 2) impact of the twin alone, frame `machine`."""


_NAMES: tuple[tuple[Stage, str | None], ...] = (
    *((Stage.ACTUATION, joint) for joint in ACTIVE_JOINTS),
    (Stage.SWING, None),
    (Stage.RELEASE, None),
    (Stage.AIM, None),
    (Stage.FLIGHT, None),
)


def swap_stages(
    prepared: Sequence[PreparedThrow], profile: TwinProfile, calibration: ValveCalibration
) -> Terms:
    """Simulate the chain with one more measured link each time, and take differences."""
    count = len(prepared)
    prefixes: list[FourFlags] = [
        (k >= 1, k >= 2, k >= 3, k >= 4) for k in range(len(ACTIVE_JOINTS) + 1)
    ]
    elements = [ReplayElement(throw, (), joints) for joints in prefixes for throw in range(count)]
    elements += [ReplayElement(t, (), prefixes[-1], measured_swing=True) for t in range(count)]
    elements += [
        ReplayElement(t, (), prefixes[-1], measured_swing=True, measured_opening=True)
        for t in range(count)
    ]
    output = replay([p.input for p in prepared], elements, profile, calibration)
    impacts = output.impact_m.reshape(-1, count, 3)
    last = slice(len(elements) - count, len(elements))
    speed, state = _from_ball(
        prepared,
        profile,
        output.release_position_m[last],
        output.release_velocity_m_per_s[last],
        output.release_t_s[last],
    )
    measured = np.stack([p.throw.impact_m for p in prepared])
    chain = [*impacts, *_with_ball(impacts[-1], speed, state), measured]
    steps = [after - before for before, after in pairwise(chain)]
    # The two release steps (moment, speed) are one stage.
    merged = [*steps[:5], steps[5] + steps[6], *steps[7:]]
    targets = np.stack([p.throw.target_m for p in prepared])
    term = np.stack([to_throw_frame(step, targets)[:, :2] for step in merged])
    gap = to_throw_frame(measured - impacts[0], targets)[:, :2]
    return Terms(_NAMES, term, gap, impacts[0, :, :2])


def _with_ball(before: Array, speed: Array, state: Array) -> tuple[Array, Array]:
    """Impacts with the tracked release speed, then with the whole tracked state; unchanged without one."""
    tracked = np.isfinite(state + speed).all(axis=1, keepdims=True)
    return np.where(tracked, speed, before), np.where(tracked, state, before)


def _from_ball(
    prepared: Sequence[PreparedThrow],
    profile: TwinProfile,
    position_m: Array,
    velocity_m_per_s: Array,
    release_t_s: Array,
) -> tuple[Array, Array]:
    """Impacts (N, 3) of the twin's flight from the tracked speed and from the tracked state; NaN without."""
    found = np.full((len(prepared), 6), np.nan)
    for i, p in enumerate(prepared):
        if p.throw.ball_t_s.size >= MIN_BALL_COUNT and np.isfinite(release_t_s[i]):
            found[i] = release_state(p.throw.ball_t_s - release_t_s[i], p.throw.ball_m)
    height = np.array([p.input.surface_height_m for p in prepared])
    progress = np.array([p.input.progress_ratio for p in prepared])
    own = np.linalg.norm(velocity_m_per_s, axis=1)
    ratio = np.linalg.norm(found[:, 3:], axis=1) / np.maximum(own, 1e-6)
    impacts = [
        fly(
            position,
            velocity,
            _in_survey_frame(profile),
            surface_height_m=height,
            progress_ratio=progress,
        ).impact_m
        for position, velocity in (
            (position_m, velocity_m_per_s * ratio[:, None]),
            (found[:, :3], found[:, 3:]),
        )
    ]
    return impacts[0], impacts[1]


def _in_survey_frame(profile: TwinProfile) -> TwinProfile:
    """The profile's flight effects alone: a tracked state is in the survey's frame and needs no base pose."""
    kept = tuple(e for e in profile.effects if EFFECTS[e.effect].stage == "flight")
    return profile.model_copy(update={"effects": kept})


def release_state(since_s: Array, ball_m: Array) -> Array:
    """Position and velocity (6,) of a load at its release, from its track.

    Gauss-Newton over position, velocity and a free acceleration about the nominal flight. The flight is
    nearly linear in them; three steps suffice.

    Args:
        since_s: (n,) sample times after the release.
        ball_m: (n, 3)
    """
    k = drag_per_m(load_spec().ball)
    order = np.argsort(since_s)
    t, points = since_s[order], ball_m[order]
    fall = np.array([0.0, 0.0, -0.5 * 9.81]) * t[:, None] ** 2
    basis = np.column_stack([np.ones_like(t), t, 0.5 * t**2])
    start = np.linalg.lstsq(basis[:, :2], points - fall, rcond=None)[0]
    state = np.concatenate([start[0], start[1]])
    extra = np.zeros(3)
    precision = basis.T @ basis / TRACKER_SD_M**2
    precision[2, 2] += FREE_ACCELERATION_SD_M_PER_S2**-2.0
    for _ in range(3):
        error = points - _flight(state, t, k) - 0.5 * t[:, None] ** 2 * extra
        right = basis.T @ error / TRACKER_SD_M**2
        right[2] -= extra / FREE_ACCELERATION_SD_M_PER_S2**2
        change = np.linalg.solve(precision, right)
        state = state + np.concatenate([change[0], change[1]])
        extra = extra + change[2]
    return state


def _flight(state: Array, t_s: Array, drag: float) -> Array:
    """Positions (n, 3) of a load at increasing times, some of them possibly before its release."""
    ends = np.arange(min(t_s[0], 0.0) - STEP_S, t_s[-1] + 2 * STEP_S, STEP_S)
    zero = int(np.argmin(np.abs(ends)))
    ends = ends - ends[zero]
    track = np.empty((ends.size, 3))
    track[zero] = state[:3]
    for direction in (1, -1):
        position, velocity = state[:3], state[3:]
        stop = ends.size if direction > 0 else -1
        for k in range(zero + direction, stop, direction):
            position, velocity = step_flight(
                position, velocity, drag, np.zeros(3), np.array(direction * STEP_S)
            )
            track[k] = position
    return np.stack([np.interp(t_s, ends, track[:, axis]) for axis in range(3)], axis=1)


def stage_gaps(terms: Terms, seed: int = 0) -> tuple[StageGap, ...]:
    """Means over throws with bootstrap intervals, in the order of the chain."""
    used = np.isfinite(terms.term_m).all(axis=(0, 2))
    term = terms.term_m[:, used]
    if term.shape[1] == 0:
        return ()
    rng = np.random.default_rng(seed)
    rows = rng.integers(0, term.shape[1], (BOOTSTRAP_COUNT, term.shape[1]))
    drawn = term[:, :, 0][:, rows].mean(axis=2)
    low, high = np.quantile(drawn, (0.05, 0.95), axis=1)
    size = np.sqrt((term**2).sum(axis=2).mean(axis=1))
    share = size / max(float(size.sum()), 1e-12)
    mean = term.mean(axis=1)
    return tuple(
        StageGap(
            stage=stage,
            joint=joint,
            miss_m=Miss(downrange=float(mean[i, 0]), crossrange=float(mean[i, 1])),
            share_ratio=float(share[i]),
            ci90_m=(float(low[i]), float(high[i])),
        )
        for i, (stage, joint) in enumerate(terms.names)
    )
