"""Where a joint sits at an end stop: at the end of its range while commanded further.

A joint that turns around, rests, or waits within its dead band at the end of its range sits at no stop: there
the command would not move it elsewhere either.
"""

from typing import Final, NamedTuple

import numpy as np
from scipy.ndimage import median_filter

from machine.conventions import Array, BoolArray

NOISES: Final = 6.0
SPAN_RATIO: Final = 0.003
"""Within as much of its range (or 6 standard deviations of the noise) a position is at the end of it."""
EVIDENCE_RATIO: Final = 5.0
"""The travel that the command would give elsewhere, in tolerances; arriving and turning is one or two."""
STAY_RATIO: Final = 1.0
"""Once a stop is there, stays at it with as much travel are taken out as well."""
BINS_COUNT: Final = 10
"""Of commands from rest to full, each with the median speed that it gives away from the ends."""
LEAST_BIN_TICKS: Final = 10


class EndStops(NamedTuple):
    """Ends of the range at which the joint was held."""

    is_held: BoolArray
    """(ticks,) from the arrival until it has left again."""
    places: tuple[float, ...]
    """Positions of the stops, in their unit."""


def find_end_stops(
    position: Array, speed: Array, push: Array, noise: float, step_s: float, smooth_ticks: int
) -> EndStops:
    """End stops of a joint that moves at a speed in proportion to its command.

    Args:
        position: (ticks,) as measured.
        speed: (ticks,) from it, unit/s.
        push: (ticks,) the command, positive where it moves the position up.
        noise: standard deviation of a measured position.
        step_s: tick.
        smooth_ticks: over as many a median takes out noise.
    """
    held = np.zeros(len(position), dtype=np.bool_)
    places: list[float] = []
    tolerance = max(NOISES * noise, SPAN_RATIO * float(np.ptp(position)))
    for side in (-1.0, 1.0):
        way = side * median_filter(position, max(smooth_ticks | 1, 3), mode="nearest")
        end = float(np.max(way))
        near = way >= end - tolerance
        usual = _usual_speed(side * speed, side * push, near)
        stays = _stays(near)
        travels = [float(np.sum(usual[stay])) * step_s / tolerance for stay in stays]
        if max(travels) < EVIDENCE_RATIO:
            continue
        places.append(side * end)
        stays = [s for s, travel in zip(stays, travels, strict=True) if travel > STAY_RATIO]
        for stay in stays:
            first = stay.start + int(np.argmax(usual[stay] > 0.0))
            left = np.flatnonzero(way[stay.stop :] < end - 2.0 * tolerance)
            held[first : stay.stop + (int(left[0]) if left.size else 0)] = True
    return EndStops(held, tuple(places))


def _usual_speed(speed: Array, push: Array, near: BoolArray) -> Array:
    """(ticks,) speed outwards that a command as large gives away from the end; 0 where it pulls back."""
    top = max(float(np.max(push)), 1e-12)
    bins = np.clip(np.floor(BINS_COUNT * push / top), 0, BINS_COUNT - 1).astype(np.int64)
    usual = np.zeros(BINS_COUNT)
    for number in range(BINS_COUNT):
        elsewhere = speed[(bins == number) & (push > 0.0) & ~near]
        if elsewhere.size >= LEAST_BIN_TICKS:
            usual[number] = max(float(np.median(elsewhere)), 0.0)
    return np.where(push > 0.0, usual[bins], 0.0)


def _stays(near: BoolArray) -> list[slice]:
    """Stretches of ticks at the end."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], near.astype(np.int64), [0]])))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
