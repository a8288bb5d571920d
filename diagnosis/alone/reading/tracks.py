"""Tracked flights before they are fitted: turned upright, scaled, cut to the free flight, thinned out.

What does not fall like a ball is refused.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from scipy.signal import savgol_filter

from diagnosis.alone.reading.layout import RefusedTableError
from machine.conventions import GRAVITY_M_PER_S2, Array

MIN_FLIGHT_ROWS: Final = 10
MAX_FLIGHTS_COUNT: Final = 16
"""Each flight has its own start and speed to be fitted; more of them add time and little else."""
MIN_PIECE_ROWS: Final = 20
"""A first piece of fewer rows gives way to the longest one."""
WINDOW_S: Final = 0.15
"""Of the parabolas that give speeds and accelerations; at least 7 rows."""
FLAT_RATIO: Final = 0.1
"""An axis along which things fall this much slower than along another is not the vertical."""
HAND_WORK_RATIO: Final = 0.25
"""Of the largest kinetic energy: what a record gains in energy before it counts as pushed."""
SCALE_SLACK_RATIO: Final = 0.02
"""Of the length scale, by eye: a metre stick that is read to a centimetre, a ball nearer than its scale."""
PIXEL_SLACK_RATIO: Final = 0.25
"""Of a scale taken from gravity, by eye: drag bends the parabola that it is read from."""
UNITS: Final = ((1000.0, "mm"), (100.0, "cm"), (1.0 / 0.3048, "feet"))
"""How many make a metre."""
SLOWED_RATIO: Final = 0.3
"""Of gravity: films in slow motion are slowed at least twice."""
MAX_FLIGHT_ROWS: Final = 150
"""Rows that a flight is averaged down to: the noise goes, and the motion within a mean of rows is a line."""


class Flight(NamedTuple):
    """One flight; times from its first row."""

    time_s: Array
    position_m: Array
    """(rows, axes) z alone, or x, z, or x, y, z; z up and last."""


class Scale(NamedTuple):
    """What may be assumed about a track's axes and lengths."""

    are_pixels: bool = False
    may_turn: bool = False
    """Whether the axes were guessed, so that another one may point up."""
    may_convert: bool = False
    """Whether no unit was given, so that gravity may tell mm and cm."""

    @property
    def slack_ratio(self) -> float:
        """How far the scale may be off."""
        return PIXEL_SLACK_RATIO if self.are_pixels else SCALE_SLACK_RATIO


def upright(flights: Sequence[Flight], scale: Scale) -> tuple[Sequence[Flight], list[str]]:
    """Turn the axis that things fall along to be the last, up, and in metres.

    In films rows are counted from the top; motion capture often has y up; pixels and mm fall too fast.
    """
    notes: list[str] = []
    axes = flights[0].position_m.shape[1]
    falls = [_typical_fall(flights, axis) for axis in range(axes)]
    up = int(np.argmax(np.abs(falls)))
    if scale.may_turn and abs(falls[-1]) < FLAT_RATIO * abs(falls[up]):
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
            f"pixels: {factor:.4g} a metre, from how fast things fall ({PIXEL_SLACK_RATIO:.0%} are "
            "allowed for); a known length in the plane of flight is better"
        )
    for factor, unit in ((1000.0, "mm"), (100.0, "cm")) if scale.may_convert else ():
        if 0.85 * factor < abs(fall) / GRAVITY_M_PER_S2 < 1.15 * factor:
            flights = [f._replace(position_m=f.position_m / factor) for f in flights]
            fall /= factor
            notes.append(f"things fall at {fall * factor:.4g} a second squared: taken as {unit}")
    if 0.6 < -fall / GRAVITY_M_PER_S2 < 1.4 or all(_speeds_up(flight) for flight in flights):
        signs = np.array([1.0] * (axes - 1) + [-1.0])
        flights = [f._replace(position_m=f.position_m * signs) for f in flights]
        notes.append("the last axis points down (things fall along it): turned")
    return flights, notes


def _speeds_up(flight: Flight) -> bool:
    """Whether it moves along the last axis, and the faster the later: with z up nothing rises like this."""
    z = flight.position_m[:, -1]
    third = max(len(z) // 3, 2)
    steps = np.diff(z)
    rise = float(np.ptp(z))
    return bool(
        rise > 0.0
        and np.sum(np.minimum(steps, 0.0)) > -0.05 * rise
        and np.mean(steps[: max(len(steps) // 10, 2)]) < 0.7 * np.mean(steps[-third:])
    )


def _typical_fall(flights: Sequence[Flight], axis: int) -> float:
    """Downward acceleration along an axis, a second squared, for most of the time in which there is one."""
    found: list[Array] = []
    for flight in flights:
        if len(flight.time_s) >= MIN_FLIGHT_ROWS:
            found.append(-_derivative(flight, flight.position_m[:, axis], 2))
    if not found:
        return 0.0
    seen = np.concatenate(found)
    strong = seen[np.abs(seen) >= 0.25 * np.quantile(np.abs(seen), 0.75)]
    return float(np.median(strong))


def _derivative(flight: Flight, values: Array, order: int) -> Array:
    """First or second derivative from parabolas through short windows, (rows,)."""
    period_s = float(np.median(np.diff(flight.time_s)))
    size = min(max(round(WINDOW_S / period_s) | 1, 7), (len(values) - 1) // 2 * 2 + 1)
    return np.asarray(savgol_filter(values, size, 2, deriv=order, delta=period_s))


def usable_flights(
    flights: Sequence[Flight], name: str | None, notes: list[str]
) -> tuple[Flight, ...]:
    """Flights that are long enough, at most `MAX_FLIGHTS_COUNT` of them."""
    usable = tuple(trimmed(thinned(flight)) for flight in flights)
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
    """The longest piece in the air: without the hand that throws, bounces, and what lies on the ground."""
    pieces: list[Flight] = []
    rest = flight
    while len(rest.time_s) >= MIN_FLIGHT_ROWS:
        end = _bounce(rest)
        pieces.append(_out_of_hand(Flight(rest.time_s[:end], rest.position_m[:end])))
        rest = Flight(rest.time_s[end + 2 :], rest.position_m[end + 2 :])
    if not pieces:
        return flight
    # The first piece has the spin and the speed of the throw; a later one only counts when it is lost.
    best = next(
        (piece for piece in pieces if len(piece.time_s) >= MIN_PIECE_ROWS),
        max(pieces, key=lambda piece: len(piece.time_s)),
    )
    start = best.time_s[0] if len(best.time_s) else 0.0
    return Flight(best.time_s - start, best.position_m)


def _bounce(flight: Flight) -> int:
    """Rows before the height turns from falling to rising, or to rest, once it has fallen; all without."""
    z = flight.position_m[:, -1]
    slope = np.gradient(z, flight.time_s)
    fastest_fall = float(np.min(slope))
    if fastest_fall >= 0.0:
        return len(z)
    fell = int(np.argmin(slope))
    after = slope[fell:]
    turned = after > 0.2 * abs(fastest_fall)
    # On the ground: hardly a tenth of that speed, and nowhere more from there on.
    late = np.maximum.accumulate(np.abs(after)[::-1])[::-1]
    stopped = np.flatnonzero(turned | (late < 0.1 * abs(fastest_fall)))
    if stopped.size == 0:
        return len(z)
    # The gradient mixes the samples around the bounce: leave two out.
    return max(fell + int(stopped[0]) - 1, 1)


def _out_of_hand(flight: Flight) -> Flight:
    """From where a hand has done its work: in the air the sum of kinetic and potential energy only falls."""
    if len(flight.time_s) < 2 * MIN_FLIGHT_ROWS:
        return flight
    speed = np.stack([_derivative(flight, column, 1) for column in flight.position_m.T], axis=1)
    kinetic = 0.5 * np.sum(speed**2, axis=1)
    energy = kinetic + GRAVITY_M_PER_S2 * flight.position_m[:, -1]
    gained = np.maximum.accumulate(energy) - energy[0]
    most = float(np.max(energy))
    if most - float(energy[0]) < HAND_WORK_RATIO * float(np.max(kinetic)):
        return flight
    released = int(np.flatnonzero(energy >= most - 0.05 * float(gained[-1]))[0])
    period_s = float(np.median(np.diff(flight.time_s)))
    start = released + round(0.5 * WINDOW_S / period_s)
    if len(flight.time_s) - start < MIN_FLIGHT_ROWS:
        return flight
    return Flight(flight.time_s[start:], flight.position_m[start:])


def falls_freely(flights: Sequence[Flight]) -> bool:
    """Whether most flights first fall at about 9.81 m/s^2."""
    fall = float(np.median([_initial_fall(flight) for flight in flights]))
    return 0.2 < fall / GRAVITY_M_PER_S2 < 1.6


def other_unit(flights: Sequence[Flight]) -> tuple[float, str] | None:
    """How many of a unit make a metre, and its name, when the flights first fall as fast as in that unit."""
    fall = float(np.median([_initial_fall(flight) for flight in flights]))
    return next(
        (one for one in UNITS if 0.85 * one[0] < fall / GRAVITY_M_PER_S2 < 1.15 * one[0]), None
    )


def refuse_fall(flights: Sequence[Flight]) -> None:
    """Refuse what neither gravity nor drag explains; other units, and slowed films, show by their factor.

    Raises:
        RefusedTableError: another unit or axis, or no free flight.
    """
    fall = float(np.median([_initial_fall(flight) for flight in flights]))
    if (other := other_unit(flights)) is not None:
        raise RefusedTableError(
            f"the ball falls at {fall:.4g} m/s^2: swapped units ({other[1]} for m). "
            f"Give --length-unit {other[1]}"
        )
    slowed = ""
    if 0.0 < fall < SLOWED_RATIO * GRAVITY_M_PER_S2:
        slowed = (
            f"; a film in slow motion, if it is one, runs {math.sqrt(GRAVITY_M_PER_S2 / fall):.2g} times too "
            "slowly: give --fps of the camera in place of the player's"
        )
    raise RefusedTableError(
        f"the ball first falls at {fall:.3g} m/s^2 along z, gravity is 9.81: wrong axis or sign (z is "
        "up), swapped units, or this is no free flight. Choose the columns, or give --length-unit (px takes "
        f"the scale from gravity){slowed}"
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
