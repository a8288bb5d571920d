"""Tracked flights before they are fitted: turned upright, thinned out, cut at the bounce, checked for units.

What does not fall like a ball is refused.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from diagnosis.alone.reading.layout import RefusedTableError
from machine.conventions import GRAVITY_M_PER_S2, Array

MIN_FLIGHT_ROWS: Final = 10
MAX_FLIGHT_ROWS: Final = 150
"""Rows that a flight is averaged down to: the noise goes, and the motion within a mean of rows is a line."""


class Flight(NamedTuple):
    """One flight; times from its first row."""

    time_s: Array
    position_m: Array
    """(rows, axes) z alone, or x, z, or x, y, z; z up and last."""


def upright(flights: Sequence[Flight]) -> tuple[Sequence[Flight], list[str]]:
    """Turn a last axis that points down, as in films, where rows are counted from the top."""
    falls = [_initial_fall(flight) for flight in flights if len(flight.time_s) >= MIN_FLIGHT_ROWS]
    fall = float(np.median(falls)) if falls else GRAVITY_M_PER_S2
    if not 0.6 < -fall / GRAVITY_M_PER_S2 < 1.4:
        return flights, []
    turned = [f._replace(position_m=f.position_m * _last_turned(f.position_m)) for f in flights]
    return turned, ["the last axis points down (things fall along it): turned"]


def _last_turned(position: Array) -> Array:
    signs = np.ones(position.shape[1])
    signs[-1] = -1.0
    return signs


def thinned(flight: Flight) -> Flight:
    """Means of so many rows that at most `MAX_FLIGHT_ROWS` are left."""
    size = math.ceil(len(flight.time_s) / MAX_FLIGHT_ROWS)
    if size == 1:
        return flight
    rows = len(flight.time_s) // size * size
    return Flight(
        flight.time_s[:rows].reshape(-1, size).mean(axis=1),
        flight.position_m[:rows].reshape(rows // size, size, -1).mean(axis=1),
    )


def trimmed(flight: Flight) -> Flight:
    """Up to the first bounce: where the height turns from falling to rising once it has fallen."""
    z = flight.position_m[:, -1]
    slope = np.gradient(z, flight.time_s)
    fastest_fall = float(np.min(slope))
    if fastest_fall >= 0.0:
        return flight
    fell = int(np.argmin(slope))
    rising = np.flatnonzero(slope[fell:] > 0.2 * abs(fastest_fall))
    if rising.size == 0:
        return flight
    # The gradient mixes the samples around the bounce: leave two out.
    end = max(fell + int(rising[0]) - 1, 1)
    return Flight(flight.time_s[:end], flight.position_m[:end])


def check_fall(flights: Sequence[Flight]) -> None:
    """Refuse what does not fall at about 9.81 m/s^2; other units show by their factor.

    Raises:
        RefusedTableError: another unit or axis, or no free flight.
    """
    down = [_initial_fall(flight) for flight in flights]
    fall = float(np.median(down))
    for factor, unit in ((1000.0, "mm"), (100.0, "cm"), (1.0 / 0.3048, "feet")):
        if 0.85 * factor < fall / GRAVITY_M_PER_S2 < 1.15 * factor:
            raise RefusedTableError(
                f"the ball falls at {fall:.4g} m/s^2: swapped units ({unit} for m). "
                f"Give --length-unit {unit}"
            )
    if not 0.2 < fall / GRAVITY_M_PER_S2 < 1.6:
        raise RefusedTableError(
            f"the ball first falls at {fall:.3g} m/s^2 along z, gravity is 9.81: wrong axis or sign (z is "
            "up), swapped units, or this is no free flight. Choose the columns, or give --length-unit"
        )


def _initial_fall(flight: Flight) -> float:
    """Downward acceleration of a parabola through the first half, m/s^2."""
    half = max(len(flight.time_s) // 2, MIN_FLIGHT_ROWS // 2)
    fit = np.polyfit(flight.time_s[:half], flight.position_m[:half, -1], 2)
    return -2.0 * float(fit[0])


def first_motion(flight: Flight) -> tuple[Array, Array]:
    """Speed and position at the first row from a cubic through the flight, (axes,) each."""
    fits = [np.polyfit(flight.time_s, column, 3) for column in flight.position_m.T]
    return np.array([f[2] for f in fits]), np.array([f[3] for f in fits])


def fastest(flight: Flight) -> float:
    """Its top speed but for outliers, m/s."""
    speeds = np.gradient(flight.position_m, flight.time_s, axis=0)
    return float(np.quantile(np.linalg.norm(speeds, axis=1), 0.95))


def track_noise(flights: Sequence[Flight]) -> float:
    """Noise of one tracked coordinate, m: third differences over sqrt(20), robust."""
    thirds = np.concatenate([np.diff(f.position_m, n=3, axis=0).ravel() for f in flights])
    return 1.4826 * float(np.median(np.abs(thirds - np.median(thirds)))) / math.sqrt(20.0)


def curvature_signal(flights: Sequence[Flight]) -> float:
    """Root mean square of what bends the tracks away from straight lines, m."""
    squares: list[float] = []
    for flight in flights:
        for column in flight.position_m.T:
            line = np.polyval(np.polyfit(flight.time_s, column, 1), flight.time_s)
            squares += ((column - line) ** 2).tolist()
    axes = flights[0].position_m.shape[1]
    return math.sqrt(float(np.mean(squares)) * axes)
