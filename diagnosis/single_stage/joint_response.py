"""Response of a joint to its valve command, with one simulation step per effect.

Order: hysteresis, dead band, curve, gain per direction, stiction, speed limit, dead time, lag, acceleration
limit, dependence on position and time; then position and backlash. An effect whose parameter is absent is not
simulated.
"""

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
from scipy.signal import lfilter

from diagnosis.single_stage.fit_problem import EffectOption, FreeParameter
from machine.conventions import Array
from sim_twin.recurrences import apply_play, lag_two_sided, limit_rate

MIN_TIME_PERIODS: Final = 1.0
"""Smallest dead time or lag worth naming, in sample periods."""
MIN_BAND_RATIO: Final = 0.02
"""Smallest dead band worth naming, as a share of full command; a curve can cancel a smaller one."""
MIN_CURVE_RATIO: Final = 0.05
"""Smallest distance of a valve curve's exponent from 1 worth naming: 2 % of the largest speed."""
MIN_SLOPE_RATIO: Final = 0.03
"""Smallest change of the speed over half the range of positions worth naming."""
MIN_DRIFT_RATIO: Final = 0.1
"""Smallest change of the speed from one time on worth naming."""
PLACES: Final = {"low_end": -1.0, "lower_half": -0.5, "upper_half": 0.5, "high_end": 1.0}
"""Places in the range of positions whose speed relative to the middle's is fitted; lines join them."""


def list_actuation_options(
    period_s: float,
    span_s: float,
    top_speed: float,
    travel: float,
    unit: str,
    has_position: bool,
    is_speed: bool = True,
    sine_s: float | None = None,
) -> tuple[EffectOption, ...]:
    """Effect options between a command and a joint's speed, or the position of a servo.

    Lower bounds are the smallest magnitudes worth naming.

    Args:
        period_s: median sample period.
        span_s: length of the record.
        top_speed: largest measured speed, unit/s.
        travel: range of the position, unit; 0 without one.
        unit: of the position, ``rad``, ``deg``, ``m``...
        has_position: whether a position was measured.
        is_speed: whether a command means a speed; else a position, and `top_speed` is the largest one.
        sine_s: period of a command that is one sine; a dead time is then known up to half of it.
    """
    max_dead_time_s = min(max(0.1 * span_s, 0.3), 2.0)
    if sine_s is not None:
        max_dead_time_s = max(min(max_dead_time_s, 0.5 * sine_s), 2.0 * period_s)
    step = max(period_s, 0.01)
    min_time_s = MIN_TIME_PERIODS * period_s
    dead_time = FreeParameter(
        "extra_dead_time_s", "s", min_time_s, max_dead_time_s, (2 * step, 0.1, 0.3)
    )
    lag = FreeParameter(
        "extra_lag_s", "s", min_time_s, max(5.0 * max_dead_time_s, 1.0), (0.05, 0.3, 1.0)
    )
    options = [
        EffectOption("valve_dead_time", "valve_dead_time", (dead_time,)),
        *((_two_sided_dead_time_option(dead_time, period_s),) if is_speed else ()),
        EffectOption("valve_lag", "valve_lag", (lag,)),
        *(() if sine_s is not None else (_resonance_option(period_s),)),
        EffectOption(
            "valve_lag_two_sided",
            "valve_lag",
            (lag, FreeParameter("stopping_lag_s", "s", min_time_s, 5.0, (0.05, 0.3, 1.0))),
            least_difference=period_s,
        ),
        *_list_static_options(),
        *(
            (*_list_limit_options(period_s, top_speed, unit), *_list_drive_options())
            if is_speed
            else (_servo_speed_option(top_speed, unit),)
        ),
    ]
    if has_position:
        gap = FreeParameter(
            "gap_rad_m", unit, 0.002 * travel, 0.3 * travel, (0.01 * travel, 0.05 * travel)
        )
        options.append(EffectOption("backlash", "backlash", (gap,)))
    return tuple(options)


def _two_sided_dead_time_option(dead_time: FreeParameter, period_s: float) -> EffectOption:
    """A dead time for each sign of the command."""
    ways = tuple(
        dead_time._replace(name=f"{way}_dead_time_s", low=0.0) for way in ("positive", "negative")
    )
    return EffectOption(
        "valve_dead_time_two_sided", "valve_dead_time", ways, MIN_TIME_PERIODS * period_s, period_s
    )


def _resonance_option(period_s: float) -> EffectOption:
    """An oscillating response, as of a load on an oil spring, in place of a lag."""
    frequency = FreeParameter(
        "frequency_hz", "Hz", 0.05, 0.25 / period_s, (0.5, 1.0, 2.0), is_absent_at_low=False
    )
    damping = FreeParameter("damping_ratio", "1", 0.05, 0.4, (0.3, 0.3, 0.2), True)
    return EffectOption("resonance", "resonance", (frequency, damping), stands_for="valve_lag")


def _list_drive_options() -> tuple[EffectOption, ...]:
    """A kinked valve; speed at equal commands that depends on the position or changes, as with a load."""
    starts = (0.1, -0.3, 0.3)
    ways = tuple(
        FreeParameter(f"{way}_slope_ratio", "1", -0.95, 0.95, starts)
        for way in ("positive", "negative")
    )
    places = tuple(
        FreeParameter(f"{name}_ratio", "1", -0.95, 3.0, (0.2 * place,))
        for name, place in PLACES.items()
    )
    change = FreeParameter("change_ratio", "1", -0.95, 2.0, (-0.2, -0.2, -0.2))
    middle = FreeParameter(
        "middle_ratio", "1", 0.02, 0.98, (0.5, 0.25, 0.75), is_absent_at_low=False
    )
    duration = FreeParameter("duration_ratio", "1", 0.01, 1.0, (0.2,))
    return (
        EffectOption(
            "valve_curve_kink",
            "valve_curve",
            (
                FreeParameter("kink_ratio", "1", 0.1, 0.9, (0.4, 0.4, 0.6), is_absent_at_low=False),
                FreeParameter("kink_speed_ratio", "1", 0.01, 0.99, (0.2, 0.6, 0.4)),
            ),
        ),
        EffectOption("speed_by_position", "speed_by_position", places, MIN_SLOPE_RATIO),
        EffectOption(
            "speed_by_position_two_sided",
            "speed_by_position",
            ways,
            MIN_SLOPE_RATIO,
            least_difference=2.0 * MIN_SLOPE_RATIO,
        ),
        EffectOption("speed_drift", "speed_drift", (change, middle, duration), MIN_DRIFT_RATIO),
    )


def _list_static_options() -> tuple[EffectOption, ...]:
    """Memoryless effects and hysteresis of the valve, over the command as a share of full."""
    band = (0.02, 0.1, 0.25)
    bands = tuple(
        FreeParameter(f"{way}_ratio", "1", 0.0, 0.7, band) for way in ("positive", "negative")
    )
    return (
        EffectOption("valve_dead_band", "valve_dead_band", bands, MIN_BAND_RATIO),
        EffectOption(
            "valve_dead_band_even",
            "valve_dead_band",
            (FreeParameter("both_ratio", "1", MIN_BAND_RATIO, 0.7, band),),
        ),
        EffectOption("valve_dead_band_plain", "valve_dead_band", bands, MIN_BAND_RATIO),
        EffectOption(
            "valve_gain",
            "valve_gain",
            (FreeParameter("positive_ratio", "1", -0.9, 0.9, (0.02, 0.2, -0.2)),),
        ),
        EffectOption(
            "valve_curve",
            "valve_curve",
            (
                FreeParameter(
                    "exponent_ratio", "1", 0.3, 3.0, (1.05, 1.5, 0.7), is_absent_at_low=False
                ),
            ),
            least=MIN_CURVE_RATIO,
            null=1.0,
        ),
        EffectOption(
            "valve_hysteresis",
            "valve_hysteresis",
            (FreeParameter("half_width_ratio", "1", 0.005, 0.3, (0.02, 0.08)),),
        ),
    )


def _list_limit_options(period_s: float, top_speed: float, unit: str) -> tuple[EffectOption, ...]:
    """Effects whose parameters are speeds or accelerations."""
    speed = f"{unit}/s"
    return (
        EffectOption(
            "speed_limit",
            "speed_limit",
            (
                FreeParameter(
                    "limit_rad_m_per_s",
                    speed,
                    0.2 * top_speed,
                    1.1 * top_speed,
                    (0.95 * top_speed, 0.7 * top_speed),
                    is_absent_at_low=False,
                ),
            ),
        ),
        EffectOption(
            "acceleration_limit",
            "acceleration_limit",
            (
                FreeParameter(
                    "limit_rad_m_per_s2",
                    f"{unit}/s2",
                    0.02 * top_speed,
                    # A ramp that takes less than two samples is not seen.
                    0.5 * top_speed / max(period_s, 0.01),
                    (4.0 * top_speed, top_speed, 0.4 * top_speed),
                    is_absent_at_high=True,
                    is_absent_at_low=False,
                ),
            ),
        ),
        EffectOption(
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


def _servo_speed_option(largest: float, unit: str) -> EffectOption:
    """Speed limit of a position servo; `largest` is its largest position."""
    limit = FreeParameter(
        "limit_rad_m_per_s",
        f"{unit}/s",
        0.02 * largest,
        200.0 * largest,
        (10.0 * largest, 3.0 * largest, 0.5 * largest),
        is_absent_at_low=False,
    )
    return EffectOption("servo_speed_limit", "speed_limit", (limit,))


def simulate_speed(
    command: Array,
    step_s: float,
    values: Mapping[str, float],
    starts_at_rest: bool = False,
    place: Array | None = None,
) -> Array:
    """Speed of the joint, (ticks,) unit/s.

    Args:
        command: (ticks,) scaled to -1..1, rest at 0.
        step_s: tick.
        values: parameters by ``option.parameter``; ``speed_per_command`` is the gain.
        starts_at_rest: whether the command was at rest before the first tick; else its first value is held.
        place: (ticks,) measured position, -1 and 1 at the ends of its range; None where it plays no part.
    """
    u = command
    if (width := values.get("valve_hysteresis.half_width_ratio", 0.0)) > 0.0:
        u = apply_play(u, width)
    x = _apply_static_curve(u, values)
    r = values.get("valve_gain.positive_ratio", 0.0)
    steady = values["speed_per_command"] * x * np.where(x > 0.0, 1.0 + r, 1.0 - r)
    if (breakaway := values.get("stiction.breakaway_rad_m_per_s", 0.0)) > 0.0:
        steady = _apply_stiction(steady, breakaway)
    if (limit := values.get("speed_limit.limit_rad_m_per_s", 0.0)) > 0.0:
        steady = np.clip(steady, -limit, limit)
    # The delay commutes with the memoryless effects. Applied after them, its interpolation does not blur the
    # edges at dead band and stiction.
    before = 0.0 if starts_at_rest else float(steady[0])
    steady = np.concatenate([[before], _apply_dead_time(steady, x, step_s, values, before)])
    speed_limit = values.get("servo_speed_limit.limit_rad_m_per_s", 0.0)
    if speed_limit > 0.0 and "valve_lag.extra_lag_s" in values:
        # The loop of a servo commands a speed in proportion to its error; this speed is limited.
        rise = 1.0 - math.exp(-step_s / values["valve_lag.extra_lag_s"])
        speed = limit_rate(steady, speed_limit * step_s, rise)
    else:
        speed = _apply_lag(steady, step_s, values)
        speed = limit_rate(speed, speed_limit * step_s) if speed_limit > 0.0 else speed
    if (limit := values.get("acceleration_limit.limit_rad_m_per_s2", 0.0)) > 0.0:
        speed = limit_rate(speed, limit * step_s)
    # Lag and limits give the speed at the end of a tick, which is the start of the next.
    speed = steady[1:] if speed is steady else speed[:-1]
    return speed * _slope_factor(speed, values, place)


def _slope_factor(speed: Array, values: Mapping[str, float], place: Array | None) -> Array | float:
    """(ticks,) speed relative to that in the middle of the range of positions, and of the record."""
    factor: Array | float = 1.0
    if place is not None:
        if "speed_by_position.low_end_ratio" in values:
            low, lower, upper, high = (values[f"speed_by_position.{name}_ratio"] for name in PLACES)
            knots = (-1.0, -0.5, 0.0, 0.5, 1.0)
            factor = 1.0 + np.interp(place, knots, (low, lower, 0.0, upper, high))
        elif (
            positive := values.get("speed_by_position_two_sided.positive_slope_ratio")
        ) is not None:
            negative = values["speed_by_position_two_sided.negative_slope_ratio"]
            factor = 1.0 + np.where(speed > 0.0, positive, negative) * place
    if (change := values.get("speed_drift.change_ratio")) is not None:
        since = np.linspace(0.0, 1.0, len(speed)) - values["speed_drift.middle_ratio"]
        passed = np.clip(0.5 + since / values["speed_drift.duration_ratio"], 0.0, 1.0)
        factor = factor * (1.0 + change * passed)
    return factor


def simulate_position(
    command: Array,
    step_s: float,
    values: Mapping[str, float],
    starts_at_rest: bool = False,
    place: Array | None = None,
) -> Array:
    """Position of the joint from 0, (ticks,), before backlash; ``offset`` in `values` is a constant speed."""
    speed = simulate_speed(command, step_s, values, starts_at_rest, place) + values["offset"]
    has_inertia = any(
        key.startswith(("valve_lag", "resonance", "acceleration_limit")) for key in values
    )
    # Without inertia the speed is constant over a tick; with it the speed is continuous.
    moved = 0.5 * (speed[1:] + speed[:-1]) if has_inertia else speed[:-1]
    return np.concatenate([[0.0], np.cumsum(moved) * step_s])


def _apply_dead_time(
    steady: Array, x: Array, step_s: float, values: Mapping[str, float], before: float
) -> Array:
    """Delay the steady speed, for each sign of the command `x` by its own dead time if there are two."""
    if "valve_dead_time_two_sided.positive_dead_time_s" not in values:
        delay = values.get("valve_dead_time.extra_dead_time_s", 0.0) / step_s
        return _apply_delay(steady, delay, before)
    is_positive_before = bool(x[0] > 0.0)
    late = np.zeros_like(steady)
    for way, is_positive in (("positive", True), ("negative", False)):
        delay = values[f"valve_dead_time_two_sided.{way}_dead_time_s"] / step_s
        part = np.where((x > 0.0) == is_positive, steady, 0.0)
        late += _apply_delay(part, delay, before if is_positive == is_positive_before else 0.0)
    return late


def _apply_delay(signal: Array, ticks: float, before: float) -> Array:
    """Shift by a fractional number of ticks; `before` is the value before the first tick."""
    if ticks <= 0.0:
        return signal
    index = np.arange(len(signal)) - ticks
    return np.interp(index, np.arange(len(signal)), signal, left=before)


def _apply_static_curve(u: Array, values: Mapping[str, float]) -> Array:
    """Dead band per direction, then a power law or two straight pieces.

    With compensation full command stays full: the rest is stretched. Without compensation (``plain``) both
    directions lose the dead band and keep the slope; two equal bands differ from that only in the gain.
    """
    both = values.get("valve_dead_band_even.both_ratio", 0.0)
    is_uncompensated = "valve_dead_band_plain.positive_ratio" in values
    name = "valve_dead_band_plain" if is_uncompensated else "valve_dead_band"
    positive = values.get(f"{name}.positive_ratio", both)
    negative = values.get(f"{name}.negative_ratio", both)
    band = np.where(u > 0.0, positive, negative)
    x = np.maximum(np.abs(u) - band, 0.0)
    if not is_uncompensated:
        x = x / (1.0 - band)
    if (kink := values.get("valve_curve_kink.kink_ratio")) is not None:
        height = values["valve_curve_kink.kink_speed_ratio"]
        beyond = height + (x - kink) * (1.0 - height) / (1.0 - kink)
        return np.sign(u) * np.where(x < kink, x * height / kink, beyond)
    exponent = values.get("valve_curve.exponent_ratio", 1.0)
    return np.sign(u) * (x if exponent == 1.0 else np.power(x, exponent))


def _apply_stiction(steady: Array, breakaway: float) -> Array:
    """Hold rest until the steady speed exceeds `breakaway`; a joint in motion keeps moving."""
    state = np.full(len(steady), -1, dtype=np.int64)
    state[np.abs(steady) > breakaway] = 1
    turned = np.concatenate([[False], np.sign(steady[1:]) != np.sign(steady[:-1])])
    state[(np.abs(steady) < 0.02 * breakaway) | (turned & (np.abs(steady) <= breakaway))] = 0
    known = np.where(state >= 0, np.arange(len(state)), 0)
    last = np.maximum.accumulate(known)
    return np.where(state[last] == 1, steady, 0.0)


def _apply_lag(steady: Array, step_s: float, values: Mapping[str, float]) -> Array:
    first = values.get("valve_lag.extra_lag_s", 0.0)
    if first > 0.0:
        return _lag_first_order(steady, step_s, first)
    frequency_hz = values.get("resonance.frequency_hz", 0.0)
    if frequency_hz > 0.0:
        damping = values["resonance.damping_ratio"]
        return _lag_second_order(steady, step_s, 2.0 * math.pi * frequency_hz, damping)
    rise = values.get("valve_lag_two_sided.extra_lag_s", 0.0)
    if rise > 0.0:
        return lag_two_sided(steady, step_s, rise, values["valve_lag_two_sided.stopping_lag_s"])
    return steady


def _lag_first_order(steady: Array, step_s: float, lag_s: float) -> Array:
    a = np.exp(-step_s / lag_s)
    out, _ = lfilter([1.0 - a], [1.0, -a], steady, zi=[a * steady[0]])
    return np.asarray(out)


def _lag_second_order(steady: Array, step_s: float, frequency: float, damping: float) -> Array:
    """Second-order lag y'' = w^2 (u - y) - 2 z w y' for a command held over each tick."""
    w, z = frequency, damping
    root = np.sqrt(complex(z * z - 1.0))
    p1, p2 = np.exp(w * (-z + root) * step_s), np.exp(w * (-z - root) * step_s)
    a1, a2 = float(np.real(-(p1 + p2))), float(np.real(p1 * p2))
    gain = 1.0 + a1 + a2
    # The zero of the sampled system only changes the phase within a tick; the gain must be 1.
    b = [0.5 * gain, 0.5 * gain]
    y0 = steady[0]
    zi = [y0 * (1.0 - b[0]), y0 * (-a2)]
    out, _ = lfilter(b, [1.0, a1, a2], steady, zi=zi)
    return np.asarray(out)
