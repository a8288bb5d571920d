"""The free part of a swing's record: from the release until it is lost in the noise, about its rest angle.

A gyro's bias grows the angle along a line; it is read off the middle of the swing.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from diagnosis.alone.reading.columns import integrated
from diagnosis.alone.reading.consistency import clipped
from diagnosis.alone.reading.envelope import (
    NOISE_AMPLITUDES,
    collapse,
    envelope,
    first_free,
    growth,
    half_swings,
)
from diagnosis.alone.reading.layout import RefusedTableError
from machine.conventions import Array

MIN_PERIODS: Final = 2.0
MAX_SAMPLES_PER_RUN: Final = 1_000
STILL_NOISES: Final = 2.0
"""A period over which the angle scatters by less than as many standard deviations of noise is none of a
swing; a swing whose amplitude is that of `NOISE_AMPLITUDES` scatters by 2.3."""


RECORD_ENDS: Final = "the record ends"
HAND_ENDS: Final = "then a hand or an obstacle ends it"
LOST: Final = "then it rests, or is lost in the noise"


class Fed(NamedTuple):
    """Energy that comes in while a body swings."""

    share: float
    """Gain of its width."""
    from_s: float
    to_s: float


class Swing(NamedTuple):
    """One free swing; times from its first row."""

    time_s: Array
    angle_rad: Array
    since_s: float = 0.0
    """When in the record its first row was."""
    end: str | None = None
    """Why it ends where it does; None when that was not looked for yet."""
    fed: Fed | None = None


def free_part(swing: Swing, noise: float) -> Swing | None:
    """From the first large turning point until the swing is lost in the noise, about its rest angle.

    One that is fed is kept whole.
    """
    if swing.end is None:
        swing = without_hand(swing, swing.angle_rad, noise)
    if swing.fed is not None:
        angle = swing.angle_rad - _middle(swing.angle_rad)
        return _thinned(swing, angle, 0, len(angle), "the whole record is kept")
    tail = max(len(swing.angle_rad) // 4, 10)
    rest = _middle(swing.angle_rad[-tail:])
    angle = swing.angle_rad - rest
    size = float(np.quantile(np.abs(angle), 0.995))
    if size < 5.0 * noise or size <= 0.0:
        return None
    # Still held: nothing moves until the largest deflection is left for good.
    beyond = np.flatnonzero(np.abs(angle) > 0.9 * size)
    start = int(beyond[0])
    side = np.sign(angle[start])
    # Held against noise a body is beyond it and short of it in turns: what counts is the last time.
    across = np.flatnonzero(side * angle[start:] < -NOISE_AMPLITUDES * noise)
    if across.size == 0:
        return None
    first_quarter = side * angle[start : start + int(across[0])]
    start += int(np.flatnonzero(first_quarter > 0.9 * size)[-1])
    end = start + _moving_rows(angle[start:], noise)
    if len(half_swings(angle[start:end], noise)) < 2 * MIN_PERIODS:
        return None
    is_lost = swing.end == RECORD_ENDS and len(angle) - end > len(angle[start:end]) / 50
    return _thinned(swing, angle, start, end, LOST if is_lost else swing.end or RECORD_ENDS)


def _thinned(swing: Swing, angle: Array, start: int, end: int, why: str) -> Swing:
    """Some of its rows, with angles about rest (rows,)."""
    stride = max(1, (end - start) // MAX_SAMPLES_PER_RUN)
    keep = slice(start, end, stride)
    time_s = swing.time_s[keep]
    return Swing(time_s - time_s[0], angle[keep], swing.since_s + float(time_s[0]), why, swing.fed)


def without_hand(swing: Swing, seen: Array, noise: float) -> Swing:
    """The swing until its width collapses, and whether it is fed.

    Args:
        swing: as recorded.
        seen: (rows,) its angle, or the rate that it was made of, in which noise is white.
        noise: of `seen`.
    """
    turns = envelope(seen, noise)
    found = growth(turns, noise)
    if found is not None and found.is_kept:
        times = (swing.since_s + float(swing.time_s[row]) for row in found.rows)
        return swing._replace(end=RECORD_ENDS, fed=Fed(found.share, *times))
    start = 0 if found is None else found.rows[1]
    cut = collapse(turns, noise)
    rows = slice(start, cut)
    time_s = swing.time_s[rows] - swing.time_s[start]
    since_s = swing.since_s + float(swing.time_s[start])
    why = RECORD_ENDS if cut is None else HAND_ENDS
    return Swing(time_s, swing.angle_rad[rows], since_s, why)


def _moving_rows(angle: Array, noise: float) -> int:
    """Rows until the body rests: single samples of noise after dry friction has stopped it are no motion."""
    clear = np.flatnonzero(np.abs(angle) > NOISE_AMPLITUDES * noise)
    end = int(clear[-1]) + 1
    crossed = half_swings(angle[:end], noise)
    if len(crossed) < 3:
        return end
    # Early half swings are clear of the noise, those of the tail are as long as noise likes.
    period = 2 * int(np.median(np.diff(crossed[: 1 + 2 * math.ceil(MIN_PERIODS)])))
    if end <= period:
        return end
    sums = np.cumsum(np.insert(angle[:end], 0, 0.0)), np.cumsum(np.insert(angle[:end] ** 2, 0, 0.0))
    mean, square = ((total[period:] - total[:-period]) / period for total in sums)
    moving = np.flatnonzero(square - mean**2 > (STILL_NOISES * noise) ** 2)
    return min(end, int(moving[-1]) + period) if moving.size else end


def _middle(angle: Array) -> float:
    """Rest angle of a swing that goes on: the mean of its typical highest and lowest."""
    low, high = np.quantile(angle, [0.05, 0.95])
    return 0.5 * float(low + high)


def swing_period(swing: Swing, noise: float) -> float:
    """From crossings of the rest angle, s."""
    return 2.0 * float(np.median(np.diff(swing.time_s[half_swings(swing.angle_rad, noise)])))


def swing_noise(swings: Sequence[Swing]) -> float:
    """Noise of one sample, rad: the less of what third and sixth differences show; at least a rounding error.

    A swing of few samples a period moves third differences more than its noise does.
    """
    return min(_noise_of_differences(swings, order) for order in (3, 6)) + 1e-9


def _noise_of_differences(swings: Sequence[Swing], order: int) -> float:
    """Robust standard deviation of differences over that of white noise of size 1, sqrt(binomial(2n, n))."""
    differences = np.concatenate([np.diff(swing.angle_rad, n=order) for swing in swings])
    scatter = np.median(np.abs(differences - np.median(differences)))
    return 1.4826 * float(scatter) / math.sqrt(math.comb(2 * order, order))


def swing_of_rate(time_s: Array, rate: Array) -> Swing:
    """A swing from its rate of turn: integrated, and the drift of its middle taken off.

    What a hand does before and after it is left out first, and the rest after it, where only noise would be
    integrated. The middle is the mean over a whole period, so that the decay does not count as drift.

    Raises:
        RefusedTableError: the gyro's range was too small.
    """
    if np.any(out := clipped(rate)):
        raise RefusedTableError(
            f"the rate of turn is cut off at {float(np.max(np.abs(rate[out]))):.4g} rad/s in "
            f"{int(np.sum(out))} of {len(out)} samples: what lies beyond cannot be integrated. Set a larger "
            "range of the gyro, or swing less far"
        )
    noise = max(swing_noise((Swing(time_s, rate),)), 1e-3 * float(np.ptp(rate)))
    swing, rate = _free_of_rate(Swing(time_s, rate), noise)
    time_s = swing.time_s
    crossed = half_swings(rate - _middle(rate), noise)
    angle = integrated(time_s, rate)
    if len(crossed) < 4:
        line = np.polyfit(time_s, angle, 1)
        return swing._replace(angle_rad=angle - np.polyval(line, time_s))
    # Over an even number of half swings the angle's mean is its middle.
    ends = list(zip(crossed[:-2], crossed[2:], strict=True))
    middle_s = np.array([0.5 * (time_s[i] + time_s[j]) for i, j in ends])
    middle = np.array([np.trapezoid(angle[i : j + 1], time_s[i : j + 1]) for i, j in ends])
    middle /= np.array([time_s[j] - time_s[i] for i, j in ends])
    smooth = 0.5 * (middle[1:] + middle[:-1])
    line = np.polyfit(0.5 * (middle_s[1:] + middle_s[:-1]), smooth, 1)
    return swing._replace(angle_rad=angle - np.polyval(line, time_s))


def _free_of_rate(swing: Swing, noise: float) -> tuple[Swing, Array]:
    """Its free rows, and the rates in them; `swing` holds the rates in place of angles."""
    swing = without_hand(swing, swing.angle_rad, noise)
    rate = swing.angle_rad
    if swing.fed is not None:
        return swing, rate
    turns = envelope(rate, noise)
    first = int(turns.turn[first_free(turns)])
    end = first + _moving_rows(rate[first:] - _middle(rate[first:]), noise)
    time_s = swing.time_s[first:end]
    why = LOST if swing.end == RECORD_ENDS and end < len(rate) else swing.end
    since_s = swing.since_s + float(time_s[0])
    return Swing(time_s - time_s[0], rate[first:end], since_s, why), rate[first:end]
