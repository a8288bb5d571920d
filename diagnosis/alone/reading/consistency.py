"""What a record of a swing or a flight must not do half way: change its unit, its clock, or hit its range."""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from diagnosis.alone.reading.layout import RefusedTableError
from machine.conventions import Array, BoolArray

CHANGED_CLOCK_RATIO: Final = 100.0
"""Of two sampling periods in one record: no logger changes as much, s for ms does."""
CHANGED_UNIT_RATIO: Final = 8.0
"""Of the usual steps after and before a jump: feet for metres make 3, cm for m 100."""
JUMP_RATIO: Final = 5.0
"""Of the larger usual step: a shorter one is part of the motion."""
CLIPPED_ROWS: Final = 3
"""Equal extremes one after the other: more than a turn has by chance."""
CLIPPED_TURNS: Final = 2
"""Turns that must end at the same value: a body that is held has one."""
REST_NOISES: Final = 8.0
"""Of a tracker: what moves less does not move."""


def refuse_changed_clock(times: Sequence[Array]) -> None:
    """Refuse runs, or halves of a run, that were sampled at hugely different rates.

    Raises:
        RefusedTableError: seconds and milliseconds in one column.
    """
    halves = [half for t in times for half in np.array_split(np.diff(t), 2) if half.size]
    periods = [float(np.median(half)) for half in halves]
    if max(periods) > CHANGED_CLOCK_RATIO * min(periods):
        raise RefusedTableError(
            f"the time goes on in steps of {min(periods):.3g} s in one part of the record and of "
            f"{max(periods):.3g} s in another: units of time are mixed (s and ms?). "
            "Write one unit in all rows"
        )


def refuse_changed_unit(time_s: Array, position_m: Array) -> None:
    """Refuse a track (rows, axes) that jumps once and moves on far faster or slower than before.

    Raises:
        RefusedTableError: metres and centimetres in one column.
    """
    steps = np.linalg.norm(np.diff(position_m, axis=0), axis=1)
    k = int(np.argmax(steps))
    if min(k, len(steps) - k - 1) < CLIPPED_ROWS:
        return
    before, after = float(np.median(steps[:k])), float(np.median(steps[k + 1 :]))
    slow, fast = sorted((before, after))
    if fast > CHANGED_UNIT_RATIO * slow > 0.0 and steps[k] > JUMP_RATIO * fast:
        raise RefusedTableError(
            f"{time_s[k + 1]:.4g} s after its start the track jumps by {steps[k]:.4g} m and then moves "
            f"{fast / slow:.2g} times as {'fast' if after > before else 'slowly'} as before: units are mixed "
            "(m and cm?). Write one unit in all rows, or cut the file there"
        )


def refuse_rest(positions_m: Sequence[Array], noise: float) -> None:
    """Refuse tracks (rows, axes) of which none goes further than noise.

    Raises:
        RefusedTableError: nothing moves.
    """
    way = max(float(np.max(np.ptp(position, axis=0))) for position in positions_m)
    if way <= REST_NOISES * noise + 1e-9:
        raise RefusedTableError(
            f"the ball moves by {way:.2g} m in all, its tracker's noise is {noise:.2g} m: it rests, or the "
            "channel is constant. Choose the columns of a ball in the air"
        )


def clipped(values: Array) -> BoolArray:
    """(rows,) samples at the end of the sensor's range: equal extremes for longer than a turn has them.

    A turn of amplitude A is within one step q of its extreme for 2 acos(1 - q / A) of phase.
    """
    found = np.zeros(len(values), np.bool_)
    low, high = float(np.min(values)), float(np.max(values))
    size = 0.5 * (high - low)
    distinct = np.unique(values)
    if size <= 0.0 or len(distinct) < 2:
        return found
    finest = float(np.min(np.diff(distinct)))
    crossed = np.count_nonzero(np.diff(np.sign(values - 0.5 * (low + high))) != 0.0)
    half_rows = len(values) / max(crossed, 1)
    usual = half_rows * 2.0 * math.acos(max(1.0 - finest / size, -1.0)) / math.pi
    least = max(CLIPPED_ROWS, math.ceil(2.0 * usual) + 1)
    for extreme in (low, high):
        at = np.concatenate([[False], np.abs(values - extreme) <= 1e-9 * size, [False]])
        starts, ends = np.flatnonzero(~at[:-1] & at[1:]), np.flatnonzero(at[:-1] & ~at[1:])
        long = ends - starts >= least
        if np.count_nonzero(long) >= CLIPPED_TURNS:
            found |= at[1:-1]
    return found
