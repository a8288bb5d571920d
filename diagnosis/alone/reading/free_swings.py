"""The free part of a swing's record: from the release until it is lost in the noise, about its rest angle.

A gyro's bias grows the angle along a line; it is read off the middle of the swing.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from diagnosis.alone.reading.columns import integrated
from machine.conventions import Array, IntArray

MIN_PERIODS: Final = 2.0
MAX_SAMPLES_PER_RUN: Final = 1_000
NOISE_AMPLITUDES: Final = 3.0
"""An angle this many standard deviations of the sensor's noise from rest is no noise."""
STILL_NOISES: Final = 2.0
"""A period over which the angle scatters by less than as many standard deviations of noise is none of a
swing; a swing whose amplitude is that of `NOISE_AMPLITUDES` scatters by 2.3."""


class Swing(NamedTuple):
    """One free swing; times from its first row."""

    time_s: Array
    angle_rad: Array


def free_part(swing: Swing, noise: float) -> Swing | None:
    """From the first large turning point until the swing is lost in the noise, about its rest angle."""
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
    stride = max(1, (end - start) // MAX_SAMPLES_PER_RUN)
    keep = slice(start, end, stride)
    time_s = swing.time_s[keep]
    return Swing(time_s - time_s[0], angle[keep])


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


def half_swings(angle: Array, noise: float) -> IntArray:
    """Rows at which the angle comes out on the other side of rest, clear of the noise."""
    clear = np.flatnonzero(np.abs(angle) > NOISE_AMPLITUDES * noise)
    return clear[1:][np.diff(np.sign(angle[clear])) != 0.0]


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

    The middle is the mean over a whole period, so that neither the decay nor a body that was still held
    counts as drift.
    """
    noise = 1.4826 * float(np.median(np.abs(np.diff(rate)))) / math.sqrt(2.0)
    centred = rate - _middle(rate)
    crossed = half_swings(centred, max(noise, 1e-3 * float(np.ptp(rate))))
    angle = integrated(time_s, rate)
    if len(crossed) < 4:
        return Swing(time_s, angle - np.polyval(np.polyfit(time_s, angle, 1), time_s))
    # Over an even number of half swings the angle's mean is its middle.
    ends = list(zip(crossed[:-2], crossed[2:], strict=True))
    middle_s = np.array([0.5 * (time_s[i] + time_s[j]) for i, j in ends])
    middle = np.array([np.trapezoid(angle[i : j + 1], time_s[i : j + 1]) for i, j in ends])
    middle /= np.array([time_s[j] - time_s[i] for i, j in ends])
    smooth = 0.5 * (middle[1:] + middle[:-1])
    line = np.polyfit(0.5 * (middle_s[1:] + middle_s[:-1]), smooth, 1)
    return Swing(time_s, angle - np.polyval(line, time_s))
