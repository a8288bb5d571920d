"""The twin's prediction of a throw's vector from simulations: rows at the sensors' times, by block."""

from collections.abc import Sequence
from functools import cache

import numpy as np

from diagnosis.healthy.filters import HealthyModel, correction
from diagnosis.linearisation.parameters import NONSMOOTH_EFFECTS, ReplayKind, joint_index
from diagnosis.linearisation.simulation import Simulated, late
from diagnosis.loading.prepared import AXES, Block, PreparedThrow
from machine.conventions import (
    CONTROL_PERIOD_S,
    GRAVITY_M_PER_S2,
    Array,
    BoolArray,
    IntArray,
)
from sim_twin.effects.effect import Effect

FORCE_AFTER_TICK_S = 0.5 * CONTROL_PERIOD_S
"""Time offset of the twin's specific force, s: it belongs to the tick that begins with its row, and the
passive joints' angles are half a tick ahead."""


def view_of(block: Block) -> ReplayKind | None:
    """The simulation that a block is compared with; none for the switch."""
    return _view_of(block.name)


@cache
def _view_of(name: str) -> ReplayKind | None:
    stage = name.partition(".")[0]
    return ReplayKind(stage) if stage in tuple(ReplayKind) else None


def predict(
    prepared: PreparedThrow,
    output: Simulated,
    elements: IntArray,
    view: ReplayKind,
    effects: Sequence[Effect],
    healthy: HealthyModel,
) -> Array:
    """Predictions (m, n) of the throw's vector in a view; 0 in blocks of other views."""
    out = np.zeros((elements.size, prepared.measured.size))
    # The first element is the set of effects itself; the others perturb one parameter each.
    motion = prepared.motion.early(output.joint_latency_s[elements[0]])
    for block in prepared.blocks:
        if view_of(block) is not view:
            continue
        channel = block.name.partition(".")[2]
        if view is ReplayKind.ACTUATION:
            joint, rows = joint_index(channel), prepared.motion.t_s.size
            track = output.joint_velocity_rad_m_per_s[elements, :rows, joint]
            # The misfit of every machine follows the motion under the effects.
            healthy_velocity = track + correction(healthy, motion, joint, track)
            # A joint that is held stands, whatever the other joints do.
            track = np.where(_held(track, effects, channel), 0.0, healthy_velocity)
            # The correction belongs to the motion, which a late sensor reports later.
            latency_s = output.joint_latency_s[elements, joint]
            track = np.stack([late(one, s) for one, s in zip(track, latency_s, strict=True)])
            out[:, block.rows] = _at(track, prepared.joint_at_s) @ prepared.joint_pair.T
        elif view is ReplayKind.SWING:
            kind, letter = channel.split(".")
            is_rate = kind == "gyro"
            source = output.gyro_rad_per_s if is_rate else output.accel_m_per_s2
            track = source[elements, :, AXES.index(letter)]
            at_s = prepared.imu_at_s - (0.0 if is_rate else FORCE_AFTER_TICK_S)
            out[:, block.rows] = _at(track, at_s) @ prepared.imu_pair.T
        elif channel == "ball":
            out[:, block.rows] = _ball(output, elements, prepared.throw.ball_t_s)
        else:
            out[:, block.rows] = output.impact_m[elements, :2]
    return out


def _held(track: Array, effects: Sequence[Effect], joint: str) -> BoolArray:
    """Where a joint's predicted track (m, T) stands because it sticks or its drive is within its backlash."""
    holds = any(e.effect in NONSMOOTH_EFFECTS and e.joint == joint for e in effects)
    return (track == 0.0) & holds


def _at(track: Array, t_s: Array) -> Array:
    """Linear interpolation of ticks (m, T) at times (n,), held beyond the ends."""
    last = track.shape[1] - 1
    place = np.clip(t_s / CONTROL_PERIOD_S, 0.0, last)
    whole = np.minimum(np.floor(place).astype(np.int64), last - 1)
    share = place - whole
    return (
        np.nan_to_num(track[:, whole]) * (1.0 - share) + np.nan_to_num(track[:, whole + 1]) * share
    )


def _ball(output: Simulated, elements: IntArray, t_s: Array) -> Array:
    """Ball positions (m, 3 n) at times (n,): the simulated track, parabolas beyond its ends."""
    out = np.full((elements.size, t_s.size, 3), np.nan)
    for row, element in enumerate(elements):
        flown = output.ball[element]
        if flown is None or flown[1].shape[0] < 3:
            continue
        start_s, points = flown
        ticks = start_s + CONTROL_PERIOD_S * np.arange(points.shape[0])
        inside = (t_s >= ticks[0]) & (t_s <= ticks[-1])
        for axis in range(3):
            out[row, inside, axis] = np.interp(t_s[inside], ticks, points[:, axis])
        early, late = t_s < ticks[0], t_s > ticks[-1]
        out[row, early] = _parabola(points[0], points[1], t_s[early] - ticks[0])
        out[row, late] = _parabola(points[-1], points[-2], ticks[-1] - t_s[late])
    return out.reshape(elements.size, -1)


def _parabola(end: Array, inner: Array, after_s: Array) -> Array:
    """Free flight beyond an end of a track: points (n, 3), `after_s` counted towards `inner`."""
    gravity = np.array([0.0, 0.0, -GRAVITY_M_PER_S2])
    speed = (inner - end) / CONTROL_PERIOD_S - 0.5 * gravity * CONTROL_PERIOD_S
    return end + speed * after_s[:, None] + 0.5 * gravity * after_s[:, None] ** 2
