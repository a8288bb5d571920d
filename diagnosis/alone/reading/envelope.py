"""How wide a swing goes from turn to turn: where a hand ends it, and whether something keeps feeding it.

No friction takes more of the width from one turn to the next than it took before, and none gives any: viscous
friction takes a share of it, air drag a share that falls, dry friction as much each time until it holds.
"""

from typing import Final, NamedTuple

import numpy as np

from machine.conventions import Array, BoolArray, IntArray

NOISE_AMPLITUDES: Final = 3.0
"""An angle this many standard deviations of the sensor's noise from rest is no noise."""
WIDTH_NOISES: Final = 8.0
"""Of the difference of two widths, each of two extremes of noise, by eye."""
COLLAPSE_RATIO: Final = 3.0
"""Of the usual loss of width: more than that at once is no friction that acted before."""
COLLAPSE_SHARE: Final = 0.15
"""Of the width, by eye: what a loss must exceed beyond the usual one."""
USUAL_COUNT: Final = 6
"""Losses that make up a usual one; the first two have nothing to be compared with."""
GROWTH_SHARE: Final = 0.1
"""Of the width, by eye: what a swing gains before it counts as fed."""
GRADUAL_COUNT: Final = 4
"""Half swings over which it must gain that; a push takes less."""
PUSH_RATIO: Final = 1.4
"""Of the width: what grows by more at once was pushed, or is held by a hand before or after the swing."""
STEP_SHARE: Final = 0.5
"""Of the whole gain: a half swing that gained more was pushed."""
LARGE_SHARE: Final = 0.2
"""Of the widest half swing: less is not asked whether it grows."""
KEPT_SHARE: Final = 0.7
"""Of its width: a swing that grew at first and then lost less than the rest of it was not let go."""
EVEN_RATIOS: Final = (0.6, 1.6)
"""Of the usual time between two turns: outside of it a hand or noise makes the turns."""


class Envelope(NamedTuple):
    """The turns of a swing and what lies between them."""

    edge: IntArray
    """(turns,) row from which the angle is on the side of each turn."""
    turn: IntArray
    """(turns,) rows of the extremes."""
    width: Array
    """(turns - 1,) way from each turn to the next, against its sign where it does not get across."""


class Growth(NamedTuple):
    """A swing that is fed."""

    share: float
    """Gain over the width before."""
    rows: tuple[int, int]
    is_kept: bool = True
    """Whether the swing goes on growing or keeps its width; else it was pumped up and let go."""


def half_swings(angle: Array, noise: float) -> IntArray:
    """Rows at which the angle comes out on the other side of rest, clear of the noise."""
    clear = np.flatnonzero(np.abs(angle) > NOISE_AMPLITUDES * noise)
    return clear[1:][np.diff(np.sign(angle[clear])) != 0.0]


def envelope(values: Array, noise: float) -> Envelope:
    """Turns of a deflection or of its rate about its middle, (rows,); one more where a turn is missing.

    After the last turn the body must come to the other side within half a period: where it is then, is the
    missing one.
    """
    low, high = np.quantile(values, [0.05, 0.95])
    away = values - 0.5 * float(low + high)
    edges = np.concatenate([[0], half_swings(away, noise)]).astype(np.int64)
    ends = np.append(edges[1:], len(away))
    turns = np.array([i + np.argmax(np.abs(away[i:j])) for i, j in zip(edges, ends, strict=True)])
    half = round(float(np.median(np.diff(turns)))) if len(turns) > 1 else len(away)
    if len(turns) > 2 and len(away) - turns[-1] <= max(half // 8, 1):
        # The record ends on the way to that turn.
        edges, turns = edges[:-1], turns[:-1]
        return Envelope(edges, turns, np.sign(away[turns[:-1]]) * -np.diff(values[turns]))
    side = np.sign(away[turns])
    if turns[-1] + half < len(away):
        edges, turns = np.append(edges, turns[-1] + half), np.append(turns, turns[-1] + half)
    return Envelope(edges, turns, side[: len(turns) - 1] * -np.diff(values[turns]))


def collapse(found: Envelope, noise: float) -> int | None:
    """Row before which a hand or an obstacle has not yet acted on a swing that it ends; None without."""
    loss = -np.diff(found.width)
    first = first_free(found)
    for k in range(first + 2, len(loss)):
        usual = max(float(np.median(loss[max(first, k - USUAL_COUNT) : k])), 0.0)
        before = found.width[k]
        slack = COLLAPSE_SHARE * before + WIDTH_NOISES * noise
        if (
            loss[k] > COLLAPSE_RATIO * usual + slack
            or -loss[k] > (PUSH_RATIO - 1.0) * before + slack
        ):
            # The turn after the next is wrong; the hand may have touched the one before it on its way.
            return int(found.edge[k + 1])
    return None


def first_free(found: Envelope) -> int:
    """Number of the turn with which the widest half swing begins that takes as long as most of them."""
    if len(found.width) == 0:
        return 0
    even = _is_even(found)
    most = float(np.max(found.width[even])) if np.any(even) else float(np.max(found.width))
    return int(np.flatnonzero(found.width >= 0.8 * most)[0])


def growth(found: Envelope, noise: float) -> Growth | None:
    """The gain of width of a swing that is fed, or was before it was let go; None without one."""
    first = first_free(found)
    whole = _gain(found, noise, 0)
    if whole is None or _gain(found, noise, first) is not None:
        return whole
    clear = np.flatnonzero(found.width > WIDTH_NOISES * noise)
    is_kept = clear.size > 0 and found.width[clear[-1]] > KEPT_SHARE * found.width[first]
    return whole._replace(is_kept=bool(is_kept))


def _gain(found: Envelope, noise: float, first: int) -> Growth | None:
    """The largest gain from turn `first` on, over even half swings of which none was a push."""
    width, best, start = found.width, None, first
    if len(width) == 0:
        return None
    asked = _is_even(found) & (width > LARGE_SHARE * np.max(width))
    for k in range(first, len(width)):
        if not asked[k] or (k > start and width[k] > PUSH_RATIO * width[k - 1]):
            start = k + (0 if asked[k] else 1)
            continue
        if k - start < GRADUAL_COUNT:
            continue
        least = start + int(np.argmin(width[start : k - GRADUAL_COUNT + 1]))
        gain = float(width[k] - width[least])
        step = float(np.max(np.diff(width[least : k + 1])))
        if gain < GROWTH_SHARE * width[least] + WIDTH_NOISES * noise or step > STEP_SHARE * gain:
            continue
        share = gain / float(width[least])
        if best is None or share > best.share:
            best = Growth(share, (int(found.turn[least]), int(found.turn[k + 1])))
    return best


def _is_even(found: Envelope) -> BoolArray:
    """(turns - 1,) whether a half swing takes about as long as most of the wide ones."""
    took = np.diff(found.turn)
    wide = found.width > 0.3 * np.max(found.width)
    usual = float(np.median(took[wide]))
    return (took > EVEN_RATIOS[0] * usual) & (took < EVEN_RATIOS[1] * usual)
