"""Tracked flights before the fit: orient and scale the axes, cut to free flight, average long records.

Tracks that do not fall like a thrown body are refused.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import savgol_filter

from diagnosis.tables.cells import RefusedTableError
from diagnosis.tables.time_series import estimate_noise
from machine.conventions import GRAVITY_M_PER_S2, Array

MIN_FLIGHT_ROWS: Final = 10
"""Fewest rows of a usable flight."""
MAX_FLIGHTS_COUNT: Final = 16
"""Most flights that are fitted; each adds its own initial state."""
MIN_PIECE_ROWS: Final = 20
"""A first piece with fewer rows gives way to the longest one."""
WINDOW_S: Final = 0.15
"""Window of the parabolas that give velocities and accelerations, s; at least 7 rows."""
FLAT_RATIO: Final = 0.1
"""Ratio of the fall along two axes below which the slower axis is not the vertical."""
LAUNCH_ENERGY_RATIO: Final = 0.25
"""Gain of energy, as a share of the largest kinetic energy, above which a launch is in the record."""
SCALE_TOLERANCE_RATIO: Final = 0.02
"""Allowed error of a length scale."""
RETIMED_TOLERANCE_RATIO: Final = 0.1
"""Allowed error of gravity in a film that was converted to another frame rate: 5 % of the rate, squared."""
PIXEL_TOLERANCE_RATIO: Final = 0.25
"""Allowed error of a scale taken from gravity; drag bends the parabola from which it is read."""
UNITS_PER_METRE: Final = ((1000.0, "mm"), (100.0, "cm"), (1.0 / 0.3048, "feet"))
"""Units per metre, and their names."""
SLOW_MOTION_RATIO: Final = 0.3
"""Share of gravity below which a video may be in slow motion."""
MAX_FALL_RATIO: Final = 6.0
"""Largest initial fall in gravities: a table-tennis ball with full topspin reaches about 4."""
MAX_FLIGHT_ROWS: Final = 150
"""Longer flights are averaged down to at most this many rows."""


class FlightRecord(NamedTuple):
    """One tracked flight; times from its first row."""

    time_s: Array
    position_m: Array
    """(rows, axes) z alone, or x, z, or x, y, z; z up and last."""


class TrackScale(NamedTuple):
    """Assumptions that may be made about a track's axes and lengths."""

    are_pixels: bool = False
    may_reorder_axes: bool = False
    """Whether the axes were guessed, so that another one may be the vertical."""
    may_convert_unit: bool = False
    """Whether no unit was given, so that gravity may identify mm and cm."""
    is_retimed: bool = False
    """Whether the film repeats frames, so that its frame rate, and with it gravity, is doubtful."""

    @property
    def tolerance_ratio(self) -> float:
        """Allowed error of the length scale."""
        if self.are_pixels:
            return PIXEL_TOLERANCE_RATIO
        return RETIMED_TOLERANCE_RATIO if self.is_retimed else SCALE_TOLERANCE_RATIO


def orient_tracks(
    flights: Sequence[FlightRecord], scale: TrackScale
) -> tuple[Sequence[FlightRecord], list[str]]:
    """Make the vertical the last axis, upward and in metres; the changes are returned as notes.

    In videos rows are counted from the top, motion capture often has y up, and pixels and mm fall too fast.
    """
    notes: list[str] = []
    axes = flights[0].position_m.shape[1]
    falls = [_estimate_fall(flights, axis) for axis in range(axes)]
    up = int(np.argmax(np.abs(falls)))
    if scale.may_reorder_axes and abs(falls[-1]) < FLAT_RATIO * abs(falls[up]):
        order = [*(axis for axis in range(axes) if axis != up), up]
        flights = [f._replace(position_m=f.position_m[:, order]) for f in flights]
        falls = [falls[axis] for axis in order]
        notes.append(f"things fall along axis {'xyz'[up]}: taken as the vertical")
    fall = falls[-1]
    if scale.are_pixels and fall != 0.0:
        factor = abs(fall) / GRAVITY_M_PER_S2
        flights = [f._replace(position_m=f.position_m / factor) for f in flights]
        fall /= factor
        notes.append(
            f"pixels: {factor:.4g} a metre, from how fast things fall ({PIXEL_TOLERANCE_RATIO:.0%} are "
            "allowed for); a known length in the plane of flight is better"
        )
    for factor, unit in ((1000.0, "mm"), (100.0, "cm")) if scale.may_convert_unit else ():
        if 0.85 * factor < abs(fall) / GRAVITY_M_PER_S2 < 1.15 * factor:
            flights = [f._replace(position_m=f.position_m / factor) for f in flights]
            fall /= factor
            notes.append(f"things fall at {fall * factor:.4g} a second squared: taken as {unit}")
    if 0.6 < -fall / GRAVITY_M_PER_S2 < 1.4 or all(
        _accelerates_along_last_axis(flight) for flight in flights
    ):
        signs = np.array([1.0] * (axes - 1) + [-1.0])
        flights = [f._replace(position_m=f.position_m * signs) for f in flights]
        notes.append("the last axis points down (things fall along it): turned")
    return flights, notes


def _accelerates_along_last_axis(flight: FlightRecord) -> bool:
    """Whether it moves along the last axis with increasing speed, which no free body does upwards."""
    z = flight.position_m[:, -1]
    third = max(len(z) // 3, 2)
    steps = np.diff(z)
    rise = float(np.ptp(z))
    return bool(
        rise > 0.0
        and np.sum(np.minimum(steps, 0.0)) > -0.05 * rise
        and np.mean(steps[: max(len(steps) // 10, 2)]) < 0.7 * np.mean(steps[-third:])
    )


def _estimate_fall(flights: Sequence[FlightRecord], axis: int) -> float:
    """Median downward acceleration along an axis, in the unit of the track per s^2, where it is large."""
    found: list[Array] = []
    for flight in flights:
        if len(flight.time_s) >= MIN_FLIGHT_ROWS:
            found.append(-_derivative(flight, flight.position_m[:, axis], 2))
    if not found:
        return 0.0
    seen = np.concatenate(found)
    strong = seen[np.abs(seen) >= 0.25 * np.quantile(np.abs(seen), 0.75)]
    return float(np.median(strong))


def _derivative(flight: FlightRecord, values: Array, order: int) -> Array:
    """First or second derivative from parabolas through short windows, (rows,)."""
    period_s = float(np.median(np.diff(flight.time_s)))
    size = min(max(round(WINDOW_S / period_s) | 1, 7), (len(values) - 1) // 2 * 2 + 1)
    # Rows may be missing: the parabolas need an even grid.
    even_s = np.linspace(flight.time_s[0], flight.time_s[-1], len(values))
    if np.allclose(even_s, flight.time_s, atol=0.1 * period_s):
        return np.asarray(savgol_filter(values, size, 2, deriv=order, delta=period_s))
    step_s = float(even_s[1] - even_s[0])
    on_grid = np.asarray(CubicSpline(flight.time_s, values)(even_s), dtype=np.float64)
    even: Array = np.asarray(savgol_filter(on_grid, size, 2, deriv=order, delta=step_s), np.float64)
    return np.interp(flight.time_s, even_s, even)


def select_flights(
    flights: Sequence[FlightRecord], name: str | None, notes: list[str]
) -> tuple[FlightRecord, ...]:
    """The flights that are long enough, averaged and trimmed, at most `MAX_FLIGHTS_COUNT` of them.

    Raises:
        RefusedTableError: no flight is long enough.
    """
    usable = tuple(trim_to_free_flight(average_rows(flight)) for flight in flights)
    usable = tuple(flight for flight in usable if len(flight.time_s) >= MIN_FLIGHT_ROWS)
    if not usable:
        raise RefusedTableError(
            f"no flight of {name or 'the ball'} has {MIN_FLIGHT_ROWS} samples in the air; track it longer"
        )
    if len(usable) <= MAX_FLIGHTS_COUNT:
        return usable
    notes.append(f"{MAX_FLIGHTS_COUNT} of {len(usable)} flights used, evenly chosen")
    chosen = np.linspace(0, len(usable) - 1, MAX_FLIGHTS_COUNT).astype(int)
    return tuple(usable[k] for k in chosen)


def average_rows(flight: FlightRecord) -> FlightRecord:
    """Average groups of rows so that at most `MAX_FLIGHT_ROWS` are left."""
    size = math.ceil(len(flight.time_s) / MAX_FLIGHT_ROWS)
    if size == 1:
        return flight
    rows = len(flight.time_s) // size * size
    return FlightRecord(
        flight.time_s[:rows].reshape(-1, size).mean(axis=1),
        flight.position_m[:rows].reshape(rows // size, size, -1).mean(axis=1),
    )


def trim_to_free_flight(flight: FlightRecord) -> FlightRecord:
    """The first free flight of useful length: without launch, bounces and rest on the ground."""
    pieces: list[FlightRecord] = []
    rest = flight
    while len(rest.time_s) >= MIN_FLIGHT_ROWS:
        end = _find_first_bounce(rest)
        pieces.append(_trim_launch(FlightRecord(rest.time_s[:end], rest.position_m[:end])))
        rest = FlightRecord(rest.time_s[end + 2 :], rest.position_m[end + 2 :])
    if not pieces:
        return flight
    # The first piece has the spin and speed of the throw; a later one is used only if the first is too short.
    best = next(
        (piece for piece in pieces if len(piece.time_s) >= MIN_PIECE_ROWS),
        max(pieces, key=lambda piece: len(piece.time_s)),
    )
    start = best.time_s[0] if len(best.time_s) else 0.0
    return FlightRecord(best.time_s - start, best.position_m)


def _find_first_bounce(flight: FlightRecord) -> int:
    """Rows before the height turns from falling to rising or to rest; all rows without a bounce."""
    z = flight.position_m[:, -1]
    slope = np.gradient(z, flight.time_s)
    fastest_fall = float(np.min(slope))
    if fastest_fall >= 0.0:
        return len(z)
    fell = int(np.argmin(slope))
    after = slope[fell:]
    turned = after > 0.2 * abs(fastest_fall)
    # At rest on the ground: less than a tenth of that speed from here on.
    late = np.maximum.accumulate(np.abs(after)[::-1])[::-1]
    stopped = np.flatnonzero(turned | (late < 0.1 * abs(fastest_fall)))
    if stopped.size == 0:
        return len(z)
    # The gradient mixes the samples around the bounce: leave two out.
    return max(fell + int(stopped[0]) - 1, 1)


def _trim_launch(flight: FlightRecord) -> FlightRecord:
    """Drop the rows of the launch: in free flight the sum of kinetic and potential energy does not rise."""
    if len(flight.time_s) < 2 * MIN_FLIGHT_ROWS:
        return flight
    speed = np.stack([_derivative(flight, column, 1) for column in flight.position_m.T], axis=1)
    kinetic = 0.5 * np.sum(speed**2, axis=1)
    energy = kinetic + GRAVITY_M_PER_S2 * flight.position_m[:, -1]
    gained = np.maximum.accumulate(energy) - energy[0]
    most = float(np.max(energy))
    if most - float(energy[0]) < LAUNCH_ENERGY_RATIO * float(np.max(kinetic)):
        return flight
    released = int(np.flatnonzero(energy >= most - 0.05 * float(gained[-1]))[0])
    period_s = float(np.median(np.diff(flight.time_s)))
    start = released + round(0.5 * WINDOW_S / period_s)
    if len(flight.time_s) - start < MIN_FLIGHT_ROWS:
        return flight
    return FlightRecord(flight.time_s[start:], flight.position_m[start:])


def falls_freely(flights: Sequence[FlightRecord]) -> bool:
    """Whether the initial fall is 0.2 to 1.6 times gravity."""
    fall = float(np.median([_estimate_initial_fall(flight) for flight in flights]))
    return 0.2 < fall / GRAVITY_M_PER_S2 < 1.6


def falls_impossibly(flights: Sequence[FlightRecord]) -> bool:
    """Whether the initial fall exceeds what drag and lift can add to gravity."""
    fall = float(np.median([_estimate_initial_fall(flight) for flight in flights]))
    return abs(fall) > MAX_FALL_RATIO * GRAVITY_M_PER_S2


def guess_length_unit(flights: Sequence[FlightRecord]) -> tuple[float, str] | None:
    """Units per metre and name of the unit in which the initial fall is gravity within 15 %; else None."""
    fall = float(np.median([_estimate_initial_fall(flight) for flight in flights]))
    return next(
        (one for one in UNITS_PER_METRE if 0.85 * one[0] < fall / GRAVITY_M_PER_S2 < 1.15 * one[0]),
        None,
    )


def refuse_no_free_fall(flights: Sequence[FlightRecord]) -> None:
    """Refuse flights that neither gravity nor drag explains; the message suggests unit or frame rate.

    Raises:
        RefusedTableError: always.
    """
    fall = float(np.median([_estimate_initial_fall(flight) for flight in flights]))
    if (other := guess_length_unit(flights)) is not None:
        raise RefusedTableError(
            f"the ball falls at {fall:.4g} m/s^2: swapped units ({other[1]} for m). "
            f"Give --length-unit {other[1]}"
        )
    slowed = ""
    if 0.0 < fall < SLOW_MOTION_RATIO * GRAVITY_M_PER_S2:
        slowed = (
            f"; a film in slow motion, if it is one, runs {math.sqrt(GRAVITY_M_PER_S2 / fall):.2g} times too "
            "slowly: give --fps of the camera in place of the player's"
        )
    raise RefusedTableError(
        f"the ball first falls at {fall:.3g} m/s^2 along z, gravity is 9.81: wrong axis or sign (z is "
        "up), swapped units, or this is no free flight. Choose the columns, or give --length-unit (px takes "
        f"the scale from gravity){slowed}"
    )


def _estimate_initial_fall(flight: FlightRecord) -> float:
    """Downward acceleration of a parabola through the first half, m/s^2."""
    half = max(len(flight.time_s) // 2, MIN_FLIGHT_ROWS // 2)
    fit = np.polyfit(flight.time_s[:half], flight.position_m[:half, -1], 2)
    return -2.0 * float(fit[0])


def estimate_initial_state(flight: FlightRecord) -> tuple[Array, Array]:
    """Velocity and position at the first row from a cubic through the flight, (axes,) each."""
    fits = [np.polyfit(flight.time_s, column, 3) for column in flight.position_m.T]
    return np.array([f[2] for f in fits]), np.array([f[3] for f in fits])


def estimate_top_speed(flight: FlightRecord) -> float:
    """The 95 % quantile of the speed, m/s."""
    speeds = np.gradient(flight.position_m, flight.time_s, axis=0)
    return float(np.quantile(np.linalg.norm(speeds, axis=1), 0.95))


def estimate_track_noise(flights: Sequence[FlightRecord]) -> float:
    """Standard deviation of one coordinate's noise, m."""
    return estimate_noise([flight.position_m for flight in flights])


def measure_curvature(flights: Sequence[FlightRecord]) -> float:
    """Root mean square deviation of the tracks from straight lines, m."""
    squares: list[float] = []
    for flight in flights:
        for column in flight.position_m.T:
            line = np.polyval(np.polyfit(flight.time_s, column, 1), flight.time_s)
            squares += ((column - line) ** 2).tolist()
    axes = flights[0].position_m.shape[1]
    return math.sqrt(float(np.mean(squares)) * axes)
