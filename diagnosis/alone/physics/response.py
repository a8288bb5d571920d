"""From a valve command to the speed of a joint, with each effect as one step of the simulation.

Order: hysteresis, dead band, curve, gain per direction, stiction, speed limit, dead time, lag,
acceleration limit; then position, with backlash. An effect whose parameter is absent is not simulated.
"""

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
from scipy.signal import lfilter

from diagnosis.alone.problem import FreeParameter, Option
from machine.conventions import Array

LEAST_TIME_PERIODS: Final = 0.5
LEAST_BAND_RATIO: Final = 0.005
"""Of full command: a smaller dead band is not worth naming (by eye)."""


def actuation_options(
    period_s: float,
    span_s: float,
    top_speed: float,
    travel: float,
    unit: str,
    has_position: bool,
    is_speed: bool = True,
) -> tuple[Option, ...]:
    """What may lie between a command and a joint's speed, or the position of a servo.

    The lower bounds are the smallest sizes worth naming: half a sample period for times, 1 % for ratios.

    Args:
        period_s: median sample period.
        span_s: length of the record.
        top_speed: largest measured speed, unit/s.
        travel: range of the position, unit; 0 without one.
        unit: of the position, ``rad``, ``deg``, ``m``...
        has_position: whether a position was measured.
        is_speed: whether the command means a speed; else a position, and `top_speed` is the largest one.
    """
    longest = min(max(0.1 * span_s, 0.3), 2.0)
    step = max(period_s, 0.01)
    least = LEAST_TIME_PERIODS * period_s
    dead_time = FreeParameter("extra_dead_time_s", "s", least, longest, (2 * step, 0.1, 0.3))
    lag = FreeParameter("extra_lag_s", "s", least, max(5.0 * longest, 1.0), (0.05, 0.3, 1.0))
    options = [
        Option("valve_dead_time", "valve_dead_time", (dead_time,)),
        Option("valve_lag", "valve_lag", (lag,)),
        Option(
            "valve_lag_second",
            "valve_lag",
            (lag, FreeParameter("damping_ratio", "1", 0.05, 0.4, (0.3, 0.3, 0.2), True)),
        ),
        Option(
            "valve_lag_two_sided",
            "valve_lag",
            (lag, FreeParameter("stopping_lag_s", "s", least, 5.0, (0.05, 0.3, 1.0))),
        ),
        *_spool_options(),
        *(
            _limit_options(period_s, top_speed, unit)
            if is_speed
            else (_slew_option(top_speed, unit),)
        ),
    ]
    if has_position:
        gap = FreeParameter(
            "gap_rad_m", unit, 0.002 * travel, 0.3 * travel, (0.01 * travel, 0.05 * travel)
        )
        options.append(Option("backlash", "backlash", (gap,)))
    return tuple(options)


def _spool_options() -> tuple[Option, ...]:
    """What has no clock of its own, over the command in parts of full."""
    band = (0.02, 0.1, 0.25)
    bands = tuple(
        FreeParameter(f"{way}_ratio", "1", 0.0, 0.7, band) for way in ("positive", "negative")
    )
    return (
        Option("valve_dead_band", "valve_dead_band", bands, LEAST_BAND_RATIO),
        Option(
            "valve_dead_band_even",
            "valve_dead_band",
            (FreeParameter("both_ratio", "1", LEAST_BAND_RATIO, 0.7, band),),
        ),
        Option("valve_dead_band_plain", "valve_dead_band", bands, LEAST_BAND_RATIO),
        Option(
            "valve_gain",
            "valve_gain",
            (FreeParameter("positive_ratio", "1", -0.9, 0.9, (0.02, 0.2, -0.2)),),
        ),
        Option(
            "valve_curve",
            "valve_curve",
            (FreeParameter("exponent_ratio", "1", 0.3, 3.0, (1.05, 1.5, 0.7)),),
        ),
        Option(
            "valve_hysteresis",
            "valve_hysteresis",
            (FreeParameter("half_width_ratio", "1", 0.005, 0.3, (0.02, 0.08)),),
        ),
    )


def _limit_options(period_s: float, top_speed: float, unit: str) -> tuple[Option, ...]:
    """What is measured against speeds."""
    speed = f"{unit}/s"
    return (
        Option(
            "speed_limit",
            "speed_limit",
            (
                FreeParameter(
                    "limit_rad_m_per_s",
                    speed,
                    0.2 * top_speed,
                    1.1 * top_speed,
                    (0.95 * top_speed, 0.7 * top_speed),
                ),
            ),
        ),
        Option(
            "acceleration_limit",
            "acceleration_limit",
            (
                FreeParameter(
                    "limit_rad_m_per_s2",
                    f"{unit}/s2",
                    0.02 * top_speed,
                    top_speed / max(period_s, 0.01),
                    (4.0 * top_speed, top_speed, 0.4 * top_speed),
                ),
            ),
        ),
        Option(
            "stiction",
            "stiction",
            (
                FreeParameter(
                    "breakaway_rad_m_per_s",
                    speed,
                    0.005 * top_speed,
                    0.5 * top_speed,
                    (0.05 * top_speed, 0.15 * top_speed),
                    is_threshold=True,
                ),
            ),
        ),
    )


def _slew_option(largest: float, unit: str) -> Option:
    """A servo's position changes at no more than a speed."""
    limit = FreeParameter(
        "limit_rad_m_per_s",
        f"{unit}/s",
        0.02 * largest,
        200.0 * largest,
        (10.0 * largest, 3.0 * largest, 0.5 * largest),
    )
    return Option("servo_speed_limit", "speed_limit", (limit,))


def simulate_speed(command: Array, step_s: float, values: Mapping[str, float]) -> Array:
    """Speed of the joint over a command, unit/s.

    Args:
        command: (ticks,) scaled to -1..1, rest at 0.
        step_s: tick.
        values: parameters by ``option.parameter``; ``speed_per_command`` is the gain.
    """
    u = command
    if (width := values.get("valve_hysteresis.half_width_ratio", 0.0)) > 0.0:
        u = play(u, width)
    x = _curved(u, values)
    r = values.get("valve_gain.positive_ratio", 0.0)
    steady = values["speed_per_command"] * x * np.where(x > 0.0, 1.0 + r, 1.0 - r)
    if (breakaway := values.get("stiction.breakaway_rad_m_per_s", 0.0)) > 0.0:
        steady = _broken_away(steady, breakaway)
    if (limit := values.get("speed_limit.limit_rad_m_per_s", 0.0)) > 0.0:
        steady = np.clip(steady, -limit, limit)
    # A delay changes places with everything before it that has no clock of its own; last, it does not blunt
    # the edges that dead band and stiction look at.
    steady = _delayed(steady, values.get("valve_dead_time.extra_dead_time_s", 0.0) / step_s)
    slew = values.get("servo_speed_limit.limit_rad_m_per_s", 0.0)
    if slew > 0.0 and "valve_lag.extra_lag_s" in values:
        # A servo's loop asks for a speed in proportion to its error, and that speed is what is limited.
        rise = 1.0 - math.exp(-step_s / values["valve_lag.extra_lag_s"])
        speed = _rate_limited(steady, slew * step_s, rise)
    else:
        speed = _lagged(steady, step_s, values)
        speed = _rate_limited(speed, slew * step_s) if slew > 0.0 else speed
    if (limit := values.get("acceleration_limit.limit_rad_m_per_s2", 0.0)) > 0.0:
        speed = _rate_limited(speed, limit * step_s)
    # Lag and limit give the speed that a tick's command has led to at its end: the next tick's beginning.
    return speed if speed is steady else np.concatenate([speed[:1], speed[:-1]])


def simulate_position(command: Array, step_s: float, values: Mapping[str, float]) -> Array:
    """Position of the joint from 0, before backlash; `offset` in `values` is a constant speed."""
    speed = simulate_speed(command, step_s, values) + values["offset"]
    has_inertia = any(key.startswith(("valve_lag", "acceleration_limit")) for key in values)
    # Without inertia the speed is the command's over a whole tick; with it the speed is continuous.
    moved = 0.5 * (speed[1:] + speed[:-1]) if has_inertia else speed[:-1]
    return np.concatenate([[0.0], np.cumsum(moved) * step_s])


def play(signal: Array, half_width: float) -> Array:
    """Lost motion of `half_width` to either side: the output moves only when the input pushes it."""
    first = float(signal[0])
    y = first - math.copysign(min(half_width, abs(first)), first)
    h = half_width
    return np.array(
        [y := x - h if x - h > y else x + h if x + h < y else y for x in signal.tolist()]
    )


def _delayed(signal: Array, ticks: float) -> Array:
    """Shifted by a fractional number of ticks, the first value held before it."""
    if ticks <= 0.0:
        return signal
    index = np.arange(len(signal)) - ticks
    return np.interp(index, np.arange(len(signal)), signal)


def _curved(u: Array, values: Mapping[str, float]) -> Array:
    """Dead band per direction, then a power of the rest.

    With a compensation full command stays full: the rest is stretched. Without one (`plain`) both directions
    lose what the band takes and keep one slope; two even bands differ by that in nothing but the gain.
    """
    both = values.get("valve_dead_band_even.both_ratio", 0.0)
    is_plain = "valve_dead_band_plain.positive_ratio" in values
    name = "valve_dead_band_plain" if is_plain else "valve_dead_band"
    positive = values.get(f"{name}.positive_ratio", both)
    negative = values.get(f"{name}.negative_ratio", both)
    band = np.where(u > 0.0, positive, negative)
    x = np.maximum(np.abs(u) - band, 0.0)
    if not is_plain:
        x = x / (1.0 - band)
    exponent = values.get("valve_curve.exponent_ratio", 1.0)
    return np.sign(u) * (x if exponent == 1.0 else np.power(x, exponent))


def _broken_away(steady: Array, breakaway: float) -> Array:
    """From rest nothing moves until the steady speed exceeds `breakaway`; moving on it keeps moving."""
    state = np.full(len(steady), -1, dtype=np.int64)
    state[np.abs(steady) > breakaway] = 1
    turned = np.concatenate([[False], np.sign(steady[1:]) != np.sign(steady[:-1])])
    state[(np.abs(steady) < 0.02 * breakaway) | (turned & (np.abs(steady) <= breakaway))] = 0
    known = np.where(state >= 0, np.arange(len(state)), 0)
    last = np.maximum.accumulate(known)
    return np.where(state[last] == 1, steady, 0.0)


def _lagged(steady: Array, step_s: float, values: Mapping[str, float]) -> Array:
    first = values.get("valve_lag.extra_lag_s", 0.0)
    if first > 0.0:
        return _first_order(steady, step_s, first)
    second = values.get("valve_lag_second.extra_lag_s", 0.0)
    if second > 0.0:
        damping = values["valve_lag_second.damping_ratio"]
        return _second_order(steady, step_s, 2.0 * damping / second, damping)
    rise = values.get("valve_lag_two_sided.extra_lag_s", 0.0)
    if rise > 0.0:
        return _two_sided(steady, step_s, rise, values["valve_lag_two_sided.stopping_lag_s"])
    return steady


def _first_order(steady: Array, step_s: float, lag_s: float) -> Array:
    a = np.exp(-step_s / lag_s)
    out, _ = lfilter([1.0 - a], [1.0, -a], steady, zi=[a * steady[0]])
    return np.asarray(out)


def _second_order(steady: Array, step_s: float, frequency: float, damping: float) -> Array:
    """Second order, y'' = w^2 (u - y) - 2 z w y', exact for a command held over each tick."""
    w, z = frequency, damping
    root = np.sqrt(complex(z * z - 1.0))
    p1, p2 = np.exp(w * (-z + root) * step_s), np.exp(w * (-z - root) * step_s)
    a1, a2 = float(np.real(-(p1 + p2))), float(np.real(p1 * p2))
    gain = 1.0 + a1 + a2
    # The zero of the sampled system changes only the phase within a tick; unit gain is what counts.
    b = [0.5 * gain, 0.5 * gain]
    y0 = steady[0]
    zi = [y0 * (1.0 - b[0]), y0 * (-a2)]
    out, _ = lfilter(b, [1.0, a1, a2], steady, zi=zi)
    return np.asarray(out)


def _two_sided(steady: Array, step_s: float, rise_s: float, stop_s: float) -> Array:
    """First order with one lag while the speed grows away from rest and another while it falls."""
    rise, stop = 1.0 - math.exp(-step_s / rise_s), 1.0 - math.exp(-step_s / stop_s)
    y = float(steady[0])
    return np.array(
        [y := y + (rise if (u - y) * y >= 0.0 else stop) * (u - y) for u in steady.tolist()]
    )


def _rate_limited(speed: Array, most: float, rise: float = 1.0) -> Array:
    """Goes `rise` of the way to each tick's value, by at most `most` a tick."""
    y = float(speed[0])
    return np.array(
        [
            y := y + (most if (d := rise * (u - y)) > most else -most if d < -most else d)
            for u in speed.tolist()
        ]
    )
