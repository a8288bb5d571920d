"""Consistency checks of swing and flight records: mixed units, mixed clocks, no motion, clipped sensors."""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from diagnosis.tables.cells import RefusedTableError
from machine.conventions import Array, BoolArray

MIXED_PERIODS_RATIO: Final = 100.0
"""Ratio of two sample periods in one record above which units of time are mixed."""
MIXED_STEPS_RATIO: Final = 8.0
"""Ratio of the median steps after and before a jump above which units of length are mixed."""
JUMP_RATIO: Final = 5.0
"""Smallest jump, in median steps of the faster part."""
MIN_CLIPPED_ROWS: Final = 3
"""Fewest equal extreme values in a row."""
MIN_CLIPPED_EXTREMES: Final = 2
"""Fewest extremes that end at the same value; a body that is held has only one."""
MIN_MOTION_RATIO: Final = 8.0
"""Smallest range of a moving body, in standard deviations of the tracker's noise."""


def refuse_mixed_time_units(times: Sequence[Array]) -> None:
    """Refuse runs, or halves of a run, with very different sample periods.

    Raises:
        RefusedTableError: seconds and milliseconds are mixed in one column.
    """
    halves = [half for t in times for half in np.array_split(np.diff(t), 2) if half.size]
    periods = [float(np.median(half)) for half in halves]
    if max(periods) > MIXED_PERIODS_RATIO * min(periods):
        raise RefusedTableError(
            f"the time goes on in steps of {min(periods):.3g} s in one part of the record and of "
            f"{max(periods):.3g} s in another: units of time are mixed (s and ms?). "
            "Write one unit in all rows"
        )


def refuse_mixed_length_units(time_s: Array, position_m: Array) -> None:
    """Refuse a track (rows, axes) that jumps once and is then much faster or slower than before.

    Raises:
        RefusedTableError: metres and centimetres are mixed in one column.
    """
    steps = np.linalg.norm(np.diff(position_m, axis=0), axis=1)
    k = int(np.argmax(steps))
    if min(k, len(steps) - k - 1) < MIN_CLIPPED_ROWS:
        return
    before, after = float(np.median(steps[:k])), float(np.median(steps[k + 1 :]))
    slow, fast = sorted((before, after))
    if fast > MIXED_STEPS_RATIO * slow > 0.0 and steps[k] > JUMP_RATIO * fast:
        raise RefusedTableError(
            f"{time_s[k + 1]:.4g} s after its start the track jumps by {steps[k]:.4g} m and then moves "
            f"{fast / slow:.2g} times as {'fast' if after > before else 'slowly'} as before: units are mixed "
            "(m and cm?). Write one unit in all rows, or cut the file there"
        )


def refuse_motionless(positions_m: Sequence[Array], noise: float) -> None:
    """Refuse tracks (rows, axes) whose range is within the noise, m.

    Raises:
        RefusedTableError: nothing moves.
    """
    way = max(float(np.max(np.ptp(position, axis=0))) for position in positions_m)
    if way <= MIN_MOTION_RATIO * noise + 1e-9:
        raise RefusedTableError(
            f"the ball moves by {way:.2g} m in all, its tracker's noise is {noise:.2g} m: it rests, or the "
            "channel is constant. Choose the columns of a ball in the air"
        )


def find_clipping(values: Array) -> BoolArray:
    """Mask of samples at the limit of the sensor's range, (rows,).

    An extreme is clipped if it lasts longer than a sine of amplitude A stays within one quantisation step q
    of its extreme: 2 acos(1 - q / A) of phase.
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
    least = max(MIN_CLIPPED_ROWS, math.ceil(2.0 * usual) + 1)
    for extreme in (low, high):
        at = np.concatenate([[False], np.abs(values - extreme) <= 1e-9 * size, [False]])
        starts, ends = np.flatnonzero(~at[:-1] & at[1:]), np.flatnonzero(at[:-1] & ~at[1:])
        long = ends - starts >= least
        if np.count_nonzero(long) >= MIN_CLIPPED_EXTREMES:
            found |= at[1:-1]
    return found
