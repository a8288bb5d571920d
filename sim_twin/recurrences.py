"""Loops over the ticks of a record in which each tick depends on the last; compiled at their first use."""

import math
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

import numba
import numpy as np

from machine.conventions import Array

P = ParamSpec("P")
T = TypeVar("T")


def _compiled(function: Callable[P, T]) -> Callable[P, T]:
    # Not kept on the disk: the folder of an installation may not be writable.
    return cast("Callable[P, T]", cast("Any", numba).njit(function))


def apply_play(signal: Array, half_width: float) -> Array:
    """Play operator (backlash) with `half_width` to either side, (ticks,)."""
    first = float(signal[0])
    start = first - math.copysign(min(half_width, abs(first)), first)
    return _play(_floats(signal), float(half_width), start)


def limit_rate(speed: Array, max_change: float, rise: float = 1.0) -> Array:
    """Move `rise` of the way to each tick's value, by at most `max_change` per tick, (ticks,)."""
    return _follow(_floats(speed), float(max_change), float(rise))


def lag_two_sided(steady: Array, step_s: float, rise_s: float, stop_s: float) -> Array:
    """First-order lag, (ticks,), with one time constant while the speed grows and another while it falls."""
    rise, stop = 1.0 - math.exp(-step_s / rise_s), 1.0 - math.exp(-step_s / stop_s)
    return _lag(_floats(steady), rise, stop)


def _floats(signal: Array) -> Array:
    return np.ascontiguousarray(signal, dtype=np.float64)


@_compiled
def _play(signal: Array, half_width: float, start: float) -> Array:
    out = np.empty_like(signal)
    y = start
    for k in range(len(signal)):
        x = signal[k]
        if x - half_width > y:
            y = x - half_width
        elif x + half_width < y:
            y = x + half_width
        out[k] = y
    return out


@_compiled
def _follow(speed: Array, max_change: float, rise: float) -> Array:
    out = np.empty_like(speed)
    y = speed[0]
    for k in range(len(speed)):
        change = rise * (speed[k] - y)
        if change > max_change:
            change = max_change
        elif change < -max_change:
            change = -max_change
        y = y + change
        out[k] = y
    return out


@_compiled
def _lag(steady: Array, rise: float, stop: float) -> Array:
    out = np.empty_like(steady)
    y = steady[0]
    for k in range(len(steady)):
        away = steady[k] - y
        y = y + (rise if away * y >= 0.0 else stop) * away
        out[k] = y
    return out
