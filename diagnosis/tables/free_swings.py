"""The free part of a swing record: from the release until a disturbance, rest, or the noise ends it.

Friction reduces the width from one extreme to the next: viscous friction by a constant share, air drag by a
falling share, Coulomb friction by a constant amount until it holds the body. A sudden larger loss is a
disturbance; a gradual gain means that energy is fed in. The bias of a gyro makes its integral drift; the
drift of the mean over whole periods is removed.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from scipy.integrate import cumulative_trapezoid

from diagnosis.tables.cells import RefusedTableError
from diagnosis.tables.consistency import find_clipping
from diagnosis.tables.time_series import estimate_noise
from machine.conventions import Array, BoolArray, IntArray

CLEAR_OF_NOISE_RATIO: Final = 3.0
"""Distance from rest, in standard deviations of the noise, beyond which a deflection is not noise."""
WIDTH_NOISE_RATIO: Final = 8.0
"""Noise allowance of the difference of two widths, in standard deviations of one sample."""
DISTURBANCE_RATIO: Final = 3.0
"""Loss of width, in typical losses, above which a disturbance acted."""
DISTURBANCE_SHARE: Final = 0.15
"""Share of the width that the loss must exceed beyond that."""
TYPICAL_LOSSES_COUNT: Final = 6
"""Number of preceding losses whose median is the typical loss."""
GROWTH_SHARE: Final = 0.1
"""Smallest gain of a growing swing, as a share of its width."""
MIN_GROWTH_COUNT: Final = 4
"""Fewest half periods over which a swing gains that; a push takes fewer."""
PUSH_RATIO: Final = 1.4
"""Ratio of two successive widths above which the body was pushed or held."""
MAX_STEP_SHARE: Final = 0.5
"""Largest share of the whole gain in one half period; more is a push."""
MIN_WIDTH_SHARE: Final = 0.2
"""Share of the largest width below which growth is not tested."""
SUSTAINED_SHARE: Final = 0.7
"""Share of its width that a swing must keep after its growth to count as driven, not released."""
EVEN_PERIOD_RATIOS: Final = (0.6, 1.6)
"""Lower and upper limit of a half period, in median half periods."""
MIN_PERIODS: Final = 2.0
"""Fewest periods of a usable swing."""
MAX_SAMPLES_PER_RUN: Final = 1_000
"""Longer swings are decimated to at most about twice this many samples."""
REST_NOISE_RATIO: Final = 2.0
"""Scatter over one period, in standard deviations of the noise, below which the body rests.

A sine whose amplitude is `CLEAR_OF_NOISE_RATIO` standard deviations scatters by 2.3 of them.
"""
RECORD_ENDS: Final = "the record ends"
"""Reasons for the end of a swing."""
DISTURBANCE_ENDS: Final = "then a hand or an obstacle ends it"
LOST: Final = "then it rests, or is lost in the noise"


class SwingEnvelope(NamedTuple):
    """Extremes of a swing and the widths between them."""

    edge: IntArray
    """(extremes,) first row on the side of each extreme."""
    turn: IntArray
    """(extremes,) row of each extreme."""
    width: Array
    """(extremes - 1,) distance from each extreme to the next; negative if the body does not cross over."""


class AmplitudeGrowth(NamedTuple):
    """A gradual growth of a swing's amplitude."""

    share: float
    """Gain as a share of the width before."""
    rows: tuple[int, int]
    """First and last row of the growth."""
    is_sustained: bool = True
    """Whether the swing then keeps growing or keeps its width; otherwise it was pumped up and released."""


def find_half_periods(angle: Array, noise: float) -> IntArray:
    """Rows at which the deflection first clears the noise on the other side of rest, (crossings,)."""
    clear = np.flatnonzero(np.abs(angle) > CLEAR_OF_NOISE_RATIO * noise)
    return clear[1:][np.diff(np.sign(angle[clear])) != 0.0]


def find_envelope(values: Array, noise: float) -> SwingEnvelope:
    """Extremes of a deflection or of its rate about its middle, `values` (rows,).

    One extreme is added half a period after the last one, unless the record ends before it.
    """
    low, high = np.quantile(values, [0.05, 0.95])
    away = values - 0.5 * float(low + high)
    edges = np.concatenate([[0], find_half_periods(away, noise)]).astype(np.int64)
    ends = np.append(edges[1:], len(away))
    turns = np.array([i + np.argmax(np.abs(away[i:j])) for i, j in zip(edges, ends, strict=True)])
    half = round(float(np.median(np.diff(turns)))) if len(turns) > 1 else len(away)
    if len(turns) > 2 and len(away) - turns[-1] <= max(half // 8, 1):
        # The record ends before that extreme.
        edges, turns = edges[:-1], turns[:-1]
        return SwingEnvelope(edges, turns, np.sign(away[turns[:-1]]) * -np.diff(values[turns]))
    side = np.sign(away[turns])
    if turns[-1] + half < len(away):
        edges, turns = np.append(edges, turns[-1] + half), np.append(turns, turns[-1] + half)
    return SwingEnvelope(edges, turns, side[: len(turns) - 1] * -np.diff(values[turns]))


def find_disturbance(found: SwingEnvelope, noise: float) -> int | None:
    """First row that a hand or an obstacle may have affected; None if the swing is undisturbed."""
    loss = -np.diff(found.width)
    first = find_first_free_turn(found)
    for k in range(first + 2, len(loss)):
        usual = max(float(np.median(loss[max(first, k - TYPICAL_LOSSES_COUNT) : k])), 0.0)
        before = found.width[k]
        slack = DISTURBANCE_SHARE * before + WIDTH_NOISE_RATIO * noise
        if (
            loss[k] > DISTURBANCE_RATIO * usual + slack
            or -loss[k] > (PUSH_RATIO - 1.0) * before + slack
        ):
            # The extreme after the next is wrong; the disturbance may have begun before the one between.
            return int(found.edge[k + 1])
    return None


def find_first_free_turn(found: SwingEnvelope) -> int:
    """Index of the extreme that begins the first nearly widest half period of usual length."""
    if len(found.width) == 0:
        return 0
    even = _mask_even_half_periods(found)
    most = float(np.max(found.width[even])) if np.any(even) else float(np.max(found.width))
    return int(np.flatnonzero(found.width >= 0.8 * most)[0])


def find_growth(found: SwingEnvelope, noise: float) -> AmplitudeGrowth | None:
    """Growth of a driven swing, or of one that was pumped up before its release; None without growth."""
    first = find_first_free_turn(found)
    whole = _find_gain(found, noise, 0)
    if whole is None or _find_gain(found, noise, first) is not None:
        return whole
    clear = np.flatnonzero(found.width > WIDTH_NOISE_RATIO * noise)
    is_sustained = clear.size > 0 and found.width[clear[-1]] > SUSTAINED_SHARE * found.width[first]
    return whole._replace(is_sustained=bool(is_sustained))


def _find_gain(found: SwingEnvelope, noise: float, first: int) -> AmplitudeGrowth | None:
    """The largest gain from extreme `first` on, over even half periods without a push."""
    width, best, start = found.width, None, first
    if len(width) == 0:
        return None
    asked = _mask_even_half_periods(found) & (width > MIN_WIDTH_SHARE * np.max(width))
    for k in range(first, len(width)):
        if not asked[k] or (k > start and width[k] > PUSH_RATIO * width[k - 1]):
            start = k + (0 if asked[k] else 1)
            continue
        if k - start < MIN_GROWTH_COUNT:
            continue
        least = start + int(np.argmin(width[start : k - MIN_GROWTH_COUNT + 1]))
        gain = float(width[k] - width[least])
        step = float(np.max(np.diff(width[least : k + 1])))
        if (
            gain < GROWTH_SHARE * width[least] + WIDTH_NOISE_RATIO * noise
            or step > MAX_STEP_SHARE * gain
        ):
            continue
        share = gain / float(width[least])
        if best is None or share > best.share:
            best = AmplitudeGrowth(share, (int(found.turn[least]), int(found.turn[k + 1])))
    return best


def _mask_even_half_periods(found: SwingEnvelope) -> BoolArray:
    """(extremes - 1,) whether a half period has about the usual length."""
    took = np.diff(found.turn)
    wide = found.width > 0.3 * np.max(found.width)
    usual = float(np.median(took[wide]))
    return (took > EVEN_PERIOD_RATIOS[0] * usual) & (took < EVEN_PERIOD_RATIOS[1] * usual)


class EnergyInput(NamedTuple):
    """Energy that is fed in while a body swings."""

    share: float
    """Gain of the width."""
    from_s: float
    to_s: float


class SwingRecord(NamedTuple):
    """One swing; times from its first row."""

    time_s: Array
    angle_rad: Array
    """(rows,) rad, or m on a spring."""
    start_s: float = 0.0
    """Time of its first row in the record, s."""
    end_reason: str | None = None
    """Why the swing ends where it does; None before it was trimmed."""
    energy_input: EnergyInput | None = None
    """None unless the amplitude grows."""


def extract_free_swing(swing: SwingRecord, noise: float) -> SwingRecord | None:
    """The free swing about its rest angle, from its first large extreme until it is lost in the noise.

    A driven swing is kept whole. None if less than `MIN_PERIODS` are left.
    """
    if swing.end_reason is None:
        swing = trim_disturbance(swing, swing.angle_rad, noise)
    if swing.energy_input is not None:
        angle = swing.angle_rad - _estimate_rest(swing.angle_rad)
        return _decimate(swing, angle, 0, len(angle), "the whole record is kept")
    tail = max(len(swing.angle_rad) // 4, 10)
    rest = _estimate_rest(swing.angle_rad[-tail:])
    angle = swing.angle_rad - rest
    size = float(np.quantile(np.abs(angle), 0.995))
    if size < 5.0 * noise or size <= 0.0:
        return None
    # The body may be held at first: the swing begins when it leaves the largest deflection for good.
    beyond = np.flatnonzero(np.abs(angle) > 0.9 * size)
    start = int(beyond[0])
    side = np.sign(angle[start])
    # A held body crosses the threshold repeatedly by noise: the last crossing counts.
    across = np.flatnonzero(side * angle[start:] < -CLEAR_OF_NOISE_RATIO * noise)
    if across.size == 0:
        return None
    first_quarter = side * angle[start : start + int(across[0])]
    start += int(np.flatnonzero(first_quarter > 0.9 * size)[-1])
    end = start + _count_moving_rows(angle[start:], noise)
    if len(find_half_periods(angle[start:end], noise)) < 2 * MIN_PERIODS:
        return None
    is_lost = swing.end_reason == RECORD_ENDS and len(angle) - end > len(angle[start:end]) / 50
    return _decimate(swing, angle, start, end, LOST if is_lost else swing.end_reason or RECORD_ENDS)


def _decimate(swing: SwingRecord, angle: Array, start: int, end: int, why: str) -> SwingRecord:
    """Rows `start` to `end` of a swing, decimated, with angles about rest (rows,)."""
    stride = max(1, (end - start) // MAX_SAMPLES_PER_RUN)
    keep = slice(start, end, stride)
    time_s = swing.time_s[keep]
    return SwingRecord(
        time_s - time_s[0], angle[keep], swing.start_s + float(time_s[0]), why, swing.energy_input
    )


def trim_disturbance(swing: SwingRecord, seen: Array, noise: float) -> SwingRecord:
    """Cut a swing where a disturbance ends it, and find whether energy is fed in.

    Args:
        swing: the record.
        seen: (rows,) the angle, or the rate that it was integrated from, whose noise is white.
        noise: standard deviation of the noise of `seen`.
    """
    turns = find_envelope(seen, noise)
    found = find_growth(turns, noise)
    if found is not None and found.is_sustained:
        times = (swing.start_s + float(swing.time_s[row]) for row in found.rows)
        return swing._replace(end_reason=RECORD_ENDS, energy_input=EnergyInput(found.share, *times))
    start = 0 if found is None else found.rows[1]
    cut = find_disturbance(turns, noise)
    rows = slice(start, cut)
    time_s = swing.time_s[rows] - swing.time_s[start]
    start_s = swing.start_s + float(swing.time_s[start])
    why = RECORD_ENDS if cut is None else DISTURBANCE_ENDS
    return SwingRecord(time_s, swing.angle_rad[rows], start_s, why)


def _count_moving_rows(angle: Array, noise: float) -> int:
    """Rows until the body rests; single noisy samples after dry friction has stopped it are not motion."""
    clear = np.flatnonzero(np.abs(angle) > CLEAR_OF_NOISE_RATIO * noise)
    end = int(clear[-1]) + 1
    crossed = find_half_periods(angle[:end], noise)
    if len(crossed) < 3:
        return end
    # Only the first half periods are used: those near the noise level have random lengths.
    period = 2 * int(np.median(np.diff(crossed[: 1 + 2 * math.ceil(MIN_PERIODS)])))
    if end <= period:
        return end
    sums = np.cumsum(np.insert(angle[:end], 0, 0.0)), np.cumsum(np.insert(angle[:end] ** 2, 0, 0.0))
    mean, square = ((total[period:] - total[:-period]) / period for total in sums)
    moving = np.flatnonzero(square - mean**2 > (REST_NOISE_RATIO * noise) ** 2)
    return min(end, int(moving[-1]) + period) if moving.size else end


def _estimate_rest(angle: Array) -> float:
    """Rest angle: middle of the 5 and 95 % quantiles."""
    low, high = np.quantile(angle, [0.05, 0.95])
    return 0.5 * float(low + high)


def estimate_period(swing: SwingRecord, noise: float) -> float:
    """Period from the crossings of the rest angle, s."""
    return 2.0 * float(np.median(np.diff(swing.time_s[find_half_periods(swing.angle_rad, noise)])))


def estimate_swing_noise(swings: Sequence[SwingRecord]) -> float:
    """Standard deviation of one sample's noise, rad: the smaller estimate from third and sixth differences.

    With few samples per period third differences still contain motion. At least 1e-9 is returned.
    """
    angles = [swing.angle_rad for swing in swings]
    return min(estimate_noise(angles, order) for order in (3, 6)) + 1e-9


def swing_from_rate(time_s: Array, rate: Array) -> SwingRecord:
    """A swing from its angular rate: trimmed, integrated, and without the drift from the rate's bias.

    The drift is a line through the means over whole periods, so that decay does not count as drift.

    Raises:
        RefusedTableError: the rate is clipped.
    """
    if np.any(out := find_clipping(rate)):
        raise RefusedTableError(
            f"the rate of turn is cut off at {float(np.max(np.abs(rate[out]))):.4g} rad/s in "
            f"{int(np.sum(out))} of {len(out)} samples: what lies beyond cannot be integrated. Set a larger "
            "range of the gyro, or swing less far"
        )
    noise = max(estimate_swing_noise((SwingRecord(time_s, rate),)), 1e-3 * float(np.ptp(rate)))
    swing, rate = _extract_free_rate(SwingRecord(time_s, rate), noise)
    time_s = swing.time_s
    crossed = find_half_periods(rate - _estimate_rest(rate), noise)
    angle = cumulative_trapezoid(rate, time_s, initial=0.0)
    if len(crossed) < 4:
        line = np.polyfit(time_s, angle, 1)
        return swing._replace(angle_rad=angle - np.polyval(line, time_s))
    # Over a whole period the mean of the angle is its middle.
    ends = list(zip(crossed[:-2], crossed[2:], strict=True))
    middle_s = np.array([0.5 * (time_s[i] + time_s[j]) for i, j in ends])
    middle = np.array([np.trapezoid(angle[i : j + 1], time_s[i : j + 1]) for i, j in ends])
    middle /= np.array([time_s[j] - time_s[i] for i, j in ends])
    smooth = 0.5 * (middle[1:] + middle[:-1])
    line = np.polyfit(0.5 * (middle_s[1:] + middle_s[:-1]), smooth, 1)
    return swing._replace(angle_rad=angle - np.polyval(line, time_s))


def _extract_free_rate(swing: SwingRecord, noise: float) -> tuple[SwingRecord, Array]:
    """The free rows of a swing and the rates in them; `swing` holds rates in place of angles."""
    swing = trim_disturbance(swing, swing.angle_rad, noise)
    rate = swing.angle_rad
    if swing.energy_input is not None:
        return swing, rate
    turns = find_envelope(rate, noise)
    first = int(turns.turn[find_first_free_turn(turns)])
    end = first + _count_moving_rows(rate[first:] - _estimate_rest(rate[first:]), noise)
    time_s = swing.time_s[first:end]
    why = LOST if swing.end_reason == RECORD_ENDS and end < len(rate) else swing.end_reason
    start_s = swing.start_s + float(time_s[0])
    return SwingRecord(time_s - time_s[0], rate[first:end], start_s, why), rate[first:end]
