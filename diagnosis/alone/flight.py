"""Diagnoses the flight of a tracked ball from its positions alone: drag, wind, spin, late release, or none.

Every flight's start and speed are fitted with it. Lengths may be wrong by 2 % and the vertical may lean by
1.1 degrees, so that a camera's scale is not taken for drag, nor its roll for wind. Axis z is up.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np

from diagnosis.alone.agreement import Disagreement, disagreement
from diagnosis.alone.fit import FreeParameter, Option
from diagnosis.alone.reading.layout import RefusedTableError
from diagnosis.alone.selection import Selection, every_third, select
from diagnosis.alone.verdict import StageNames, diagnosis_of
from diagnosis.verdict import Diagnosis, Stage
from machine.conventions import GRAVITY_M_PER_S2, Array, BoolArray, IntArray

AIR_DENSITY_KG_PER_M3: Final = 1.204
"""20 C at sea level."""
GRAVITY_SLACK_RATIO: Final = 0.02
"""Of the length scale, by eye: a metre stick that is read to a centimetre, a ball nearer than its scale."""
LEAN_RAD: Final = 0.02
"""Of the vertical, by eye: a camera on a tripod is set up to half a degree, by hand to one."""
MAX_FLIGHTS_COUNT: Final = 16
"""Each flight has its own start and speed to be fitted; more of them add time and little else."""
MAX_FLIGHT_ROWS: Final = 150
"""Rows that a flight is averaged down to: the noise goes, and the motion within a mean of rows is a line."""
STEPS_COUNT: Final = 200
FINEST_STEP_S: Final = 0.002
MIN_FLIGHT_ROWS: Final = 10
BLOCKS_PER_FLIGHT: Final = 5
UNKNOWN_RATIO: Final = 0.35
CRISIS_WIDTH_M_PER_S: Final = 1.5
"""A smooth sphere's drag falls within about a sixth of its critical speed (Achenbach 1972)."""


class Ball(NamedTuple):
    """What is known about the ball; nan where it is not."""

    mass_kg: float = math.nan
    diameter_m: float = math.nan

    @property
    def drag_per_m(self) -> float:
        """Deceleration over speed squared at a drag coefficient of 1, 1/m."""
        area = 0.25 * math.pi * self.diameter_m**2
        return 0.5 * AIR_DENSITY_KG_PER_M3 * area / self.mass_kg


class Flight(NamedTuple):
    """One flight; times from its first row."""

    time_s: Array
    position_m: Array
    """(rows, axes) z alone, or x, z, or x, y, z; z up and last."""


@dataclass(frozen=True, slots=True)
class FlightProblem:
    """Residuals of all flights of one ball; see `fit.Problem`."""

    flights: tuple[Flight, ...]
    nuisance: tuple[FreeParameter, ...]
    options: tuple[Option, ...]
    block: IntArray
    drag_per_m: float
    """At drag coefficient 1; 1 when mass or diameter are unknown."""

    @property
    def rich(self) -> tuple[str, ...]:
        """The search from nothing is enough."""
        return ()

    @property
    def held(self) -> BoolArray:
        """Every second flight; every third piece when there is one flight."""
        if len(self.flights) == 1:
            return every_third(self.block)
        return (self.block // BLOCKS_PER_FLIGHT) % 2 == 1

    @property
    def local(self) -> frozenset[str]:
        """Where each flight began, and how fast."""
        return frozenset(p.name for p in self.nuisance if "." in p.name)

    def residuals(self, values: Sequence[Mapping[str, float]]) -> Array:
        """(sets, samples) measured minus simulated, flights and axes one after the other, m."""
        measured = np.concatenate([flight.position_m.ravel(order="F") for flight in self.flights])
        tracks = self.simulate(values)
        return measured - np.concatenate(
            [track.transpose(0, 2, 1).reshape(len(values), -1) for track in tracks], axis=1
        )

    def simulate(self, values: Sequence[Mapping[str, float]]) -> list[Array]:
        """Positions at each flight's own sample times, a (sets, rows, axes) a flight."""
        axes = self.flights[0].position_m.shape[1]
        count, sets = len(self.flights), len(values)

        def start_of(letter: str) -> Array:
            return np.array(
                [
                    [[one[f"{letter}{axis}.{k}"] for axis in range(axes)] for k in range(count)]
                    for one in values
                ]
            )

        last = max(float(flight.time_s[-1]) for flight in self.flights)
        step_s = max(last / STEPS_COUNT, FINEST_STEP_S)
        grid_s = np.arange(0.0, last + 2.0 * step_s, step_s)
        # (steps, sets * flights, axes): every set of every flight is one more particle.
        path = _integrate(
            start_of("p").reshape(-1, axes),
            start_of("v").reshape(-1, axes),
            grid_s,
            {name: np.repeat([one[name] for one in values], count)[:, None] for name in values[0]},
            self.drag_per_m,
        ).reshape(len(grid_s), sets, count, axes)
        delay_s = np.array([one.get("release_delay.extra_delay_s", 0.0) for one in values])
        return [
            _sampled(path[:, :, k], grid_s[1], np.maximum(flight.time_s - delay_s[:, None], 0.0))
            for k, flight in enumerate(self.flights)
        ]


def _sampled(path: Array, step_s: float, time_s: Array) -> Array:
    """Linear interpolation of paths (steps, sets, axes) at times (sets, rows); (sets, rows, axes)."""
    index = np.minimum((time_s / step_s).astype(np.int64), len(path) - 2)
    share = (time_s / step_s - index)[..., None]
    sets = np.arange(path.shape[1])[:, None]
    return path[index, sets] * (1.0 - share) + path[index + 1, sets] * share


def diagnose_ball(
    flights: Sequence[Flight],
    ball: Ball,
    name: str | None = None,
    progress: Callable[[str], None] | None = None,
    is_mixed_refused: bool = False,
) -> Diagnosis:
    """Diagnose the flights of one ball; `is_mixed_refused` when nothing says that they are of one.

    Raises:
        RefusedTableError: nothing falls in them, lengths in another unit, or flights of several balls.
    """
    flights, notes = _upright(flights)
    usable = tuple(_trimmed(_thinned(flight)) for flight in flights)
    usable = tuple(flight for flight in usable if len(flight.time_s) >= MIN_FLIGHT_ROWS)
    if not usable:
        raise RefusedTableError(
            f"no flight of {name or 'the ball'} has {MIN_FLIGHT_ROWS} samples in the air; track it longer"
        )
    if len(usable) > MAX_FLIGHTS_COUNT:
        notes.append(f"{MAX_FLIGHTS_COUNT} of {len(usable)} flights used, evenly chosen")
        chosen = np.linspace(0, len(usable) - 1, MAX_FLIGHTS_COUNT).astype(int)
        usable = tuple(usable[k] for k in chosen)
    _check_fall(usable)
    problem = make_problem(usable, ball)
    noise = _track_noise(usable)
    signal = _curvature_signal(usable)
    selection = select(problem, signal, noise, progress, UNKNOWN_RATIO)
    best = selection.best.fit.as_mapping()
    split = _disagreement(usable, ball, problem, selection)
    if split is not None and split.is_mixed and is_mixed_refused:
        raise RefusedTableError(
            f"the {len(usable)} flights of this file disagree ({split.in_words()}): several balls, or other "
            "conditions. Give --group COLUMN that tells balls apart, or one file a ball"
        )
    if split is not None:
        notes.append(f"the {len(usable)} flights disagree beyond their noise: {split.in_words()}")
    known = not math.isnan(ball.drag_per_m)
    evidence: dict[str, Any] = {
        "flights": len(usable),
        "samples": int(sum(len(flight.time_s) for flight in usable)),
        "axes": usable[0].position_m.shape[1],
        "rate_hz": float(np.median([1.0 / np.median(np.diff(f.time_s)) for f in usable])),
        "noise": {"value": noise, "unit": "m"},
        "top_speed_m_per_s": _top_speed(problem, best),
        "drag_unit": "drag coefficient (mass and diameter given)" if known else "1/m: a = -k |v| v",
        "notes": notes,
        "not_separable": [
            "a wrong length scale and gravity (2 % are allowed for)",
            "a leaning vertical and horizontal acceleration (1.1 degrees are allowed for)",
            "spin and vertical wind"
            if usable[0].position_m.shape[1] > 1
            else "wind, spin: one axis only",
        ],
    }
    if "drag_crisis" in selection.best.effects:
        evidence["drag_crisis"] = (
            f"drag falls to {best['drag_crisis.above_ratio']:.2f} of its low-speed value above "
            f"{best['drag_crisis.critical_speed_m_per_s']:.1f} m/s"
        )
        constant = next((s for s in selection.ranked if s.effects == ("air_drag",)), None)
        if constant is not None:
            values = constant.fit.as_mapping()
            evidence["constant_drag"] = next(
                v for n, v in values.items() if n.startswith("air_drag.")
            )
    return diagnosis_of(
        problem,
        selection,
        noise,
        StageNames(Stage.FLIGHT, name, "m", _SEPARATING),
        evidence,
        _plots(problem, selection.base.fit.as_mapping(), best),
    )


def make_problem(flights: tuple[Flight, ...], ball: Ball) -> FlightProblem:
    """Parameters and blocks of one ball's flights."""
    axes = flights[0].position_m.shape[1]
    slack = GRAVITY_SLACK_RATIO * GRAVITY_M_PER_S2
    nuisance = [
        FreeParameter(
            "gravity",
            "m/s2",
            GRAVITY_M_PER_S2 - slack,
            GRAVITY_M_PER_S2 + slack,
            (GRAVITY_M_PER_S2,),
            prior_sd=slack / math.sqrt(3.0),
        )
    ]
    nuisance += [
        FreeParameter(
            f"lean{axis}", "rad", -LEAN_RAD, LEAN_RAD, (0.0,), prior_sd=LEAN_RAD / math.sqrt(3.0)
        )
        for axis in range(axes - 1)
    ]
    top = 0.0
    for k, flight in enumerate(flights):
        speed, first = _first_motion(flight)
        top = max(top, _fastest(flight))
        for axis in range(axes):
            reach = float(np.ptp(flight.position_m[:, axis])) + 1.0
            p, v = float(first[axis]), float(speed[axis])
            nuisance.append(FreeParameter(f"p{axis}.{k}", "m", p - reach, p + reach, (p,)))
            limit = 20.0 + 2.0 * abs(v)
            nuisance.append(FreeParameter(f"v{axis}.{k}", "m/s", v - limit, v + limit, (v,)))
    known = not math.isnan(ball.drag_per_m)
    period_s = float(np.median(np.diff(flights[0].time_s)))
    blocks: list[IntArray] = []
    for flight in flights:
        rows = len(flight.time_s)
        piece = np.arange(rows) * BLOCKS_PER_FLIGHT // rows
        offset = BLOCKS_PER_FLIGHT * len(blocks)
        blocks.append(np.tile(piece + offset, axes).astype(np.int64))
    return FlightProblem(
        flights=flights,
        nuisance=tuple(nuisance),
        options=_options(axes, top, period_s, known),
        block=np.concatenate(blocks),
        drag_per_m=ball.drag_per_m if known else 1.0,
    )


def _options(axes: int, top: float, period_s: float, ball_known: bool) -> tuple[Option, ...]:
    """What may act on a flight, by what `axes` can show."""
    drag = (
        FreeParameter("extra_drag_coefficient_ratio", "1", 0.02, 3.0, (0.1, 0.5, 1.2))
        if ball_known
        else FreeParameter("drag_per_m", "1/m", 2e-4, 1.0, (0.002, 0.02, 0.1))
    )
    options = [
        Option("air_drag", "air_drag", (drag,)),
        Option(
            "drag_crisis",
            "drag_crisis",
            (
                FreeParameter(
                    "critical_speed_m_per_s", "m/s", 0.3 * top, 0.95 * top, (0.6 * top, 0.8 * top)
                ),
                FreeParameter("above_ratio", "1", 0.05, 1.0, (0.4, 0.7)),
            ),
        ),
        Option(
            "release_delay",
            "release_delay",
            (FreeParameter("extra_delay_s", "s", 0.5 * period_s, 1.0, (2.0 * period_s, 0.2)),),
        ),
    ]
    if axes >= 2:
        winds = [FreeParameter("x_m_per_s", "m/s", -15.0, 15.0, (1.0, -1.0))]
        spins = [FreeParameter("backspin_lift_per_m", "1/m", -0.2, 0.2, (0.002, -0.002))]
        if axes == 3:
            winds.append(FreeParameter("y_m_per_s", "m/s", -15.0, 15.0, (0.5, 0.5)))
            spins.append(FreeParameter("sidespin_lift_per_m", "1/m", -0.2, 0.2, (0.001, 0.001)))
        options.append(Option("wind", "wind", tuple(winds)))
        options.append(Option("release_spin", "release_spin", tuple(spins)))
    return tuple(options)


def _integrate(
    start: Array, speed: Array, grid_s: Array, values: Mapping[str, Array], drag_per_m: float
) -> Array:
    """Paths of particles, (steps, particles, axes), by Heun's method; `values` are (particles, 1)."""
    count, axes = start.shape
    nothing = np.zeros((count, 1))
    k = values.get(
        "air_drag.extra_drag_coefficient_ratio", values.get("air_drag.drag_per_m", nothing)
    )
    # A wrong length scale s shows as gravity s g; the true motion is 1 / s of the one seen.
    scale = values["gravity"] / GRAVITY_M_PER_S2
    k = k * drag_per_m / scale
    wind = np.zeros((count, axes))
    if axes >= 2:
        wind[:, :1] = scale * values.get("wind.x_m_per_s", nothing)
    if axes == 3:
        wind[:, 1:2] = scale * values.get("wind.y_m_per_s", nothing)
    critical = values.get("drag_crisis.critical_speed_m_per_s")
    above = values.get("drag_crisis.above_ratio", nothing)
    back = values.get("release_spin.backspin_lift_per_m")
    gravity = np.zeros((count, axes))
    gravity[:, -1:] = -values["gravity"]
    for axis in range(axes - 1):
        gravity[:, axis : axis + 1] = values["gravity"] * values[f"lean{axis}"]
    spin = None
    if back is not None:
        spin = _spin_axes(
            speed, back / scale, values.get("release_spin.sidespin_lift_per_m", nothing) / scale
        )

    def acceleration(v: Array) -> Array:
        relative = v - wind
        fast = np.sqrt(np.sum(relative * relative, axis=1, keepdims=True))
        drag = k
        if critical is not None:
            falling = 0.5 - 0.5 * np.tanh(0.5 * (fast - critical) / CRISIS_WIDTH_M_PER_S)
            drag = k * (above + (1.0 - above) * falling)
        a = gravity - drag * fast * relative
        if spin is None:
            return a
        # Lift along the ground speed: otherwise wind without drag could bend a flight through its spin.
        return a + np.sqrt(np.sum(v * v, axis=1, keepdims=True)) * _lift(spin, v)

    path = np.empty((len(grid_s), count, axes))
    p, v, step_s = start, speed, float(grid_s[1])
    for index in range(len(grid_s)):
        path[index] = p
        a = acceleration(v)
        ahead = v + step_s * a
        p = p + 0.5 * step_s * (v + ahead)
        v = v + 0.5 * step_s * (a + acceleration(ahead))
    return path


def _spin_axes(speed: Array, back: Array, side: Array) -> Array:
    """Spin axis times lift per metre, (flights, 3): backspin lifts, sidespin turns to the left."""
    count, axes = speed.shape
    full = np.zeros((count, 3))
    full[:, 0] = speed[:, 0]
    if axes == 3:
        full[:, 1] = speed[:, 1]
    ahead = full / np.maximum(np.linalg.norm(full, axis=1, keepdims=True), 1e-9)
    # axis x forward = up, with x forward and z up, for an axis along -y: (y, -x, 0) of the heading.
    right = np.stack([ahead[:, 1], -ahead[:, 0], np.zeros(count)], axis=1)
    return back * right + side * np.array([0.0, 0.0, 1.0])


def _lift(axis: Array, speed: Array) -> Array:
    """Magnus direction axis x velocity, per unit of speed, in the axes at hand."""
    axes = speed.shape[1]
    full = np.zeros((len(speed), 3))
    full[:, 0], full[:, 2] = speed[:, 0], speed[:, -1]
    if axes == 3:
        full[:, 1] = speed[:, 1]
    lifted = np.cross(axis, full)
    return lifted if axes == 3 else lifted[:, [0, 2]]


def _disagreement(
    flights: Sequence[Flight], ball: Ball, problem: FlightProblem, selection: Selection
) -> Disagreement | None:
    parts = [replace(make_problem((flight,), ball), options=problem.options) for flight in flights]
    drag = [option for option in problem.options if option.key == "air_drag"]
    return disagreement(parts, selection, drag)


def _upright(flights: Sequence[Flight]) -> tuple[Sequence[Flight], list[str]]:
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


def _thinned(flight: Flight) -> Flight:
    """Means of so many rows that at most `MAX_FLIGHT_ROWS` are left."""
    size = math.ceil(len(flight.time_s) / MAX_FLIGHT_ROWS)
    if size == 1:
        return flight
    rows = len(flight.time_s) // size * size
    return Flight(
        flight.time_s[:rows].reshape(-1, size).mean(axis=1),
        flight.position_m[:rows].reshape(rows // size, size, -1).mean(axis=1),
    )


def _trimmed(flight: Flight) -> Flight:
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


def _check_fall(flights: Sequence[Flight]) -> None:
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


def _first_motion(flight: Flight) -> tuple[Array, Array]:
    """Speed and position at the first row from a cubic through the flight, (axes,) each."""
    fits = [np.polyfit(flight.time_s, column, 3) for column in flight.position_m.T]
    return np.array([f[2] for f in fits]), np.array([f[3] for f in fits])


def _fastest(flight: Flight) -> float:
    speeds = np.gradient(flight.position_m, flight.time_s, axis=0)
    return float(np.quantile(np.linalg.norm(speeds, axis=1), 0.95))


def _track_noise(flights: Sequence[Flight]) -> float:
    """Noise of one tracked coordinate, m: third differences over sqrt(20), robust."""
    thirds = np.concatenate([np.diff(f.position_m, n=3, axis=0).ravel() for f in flights])
    return 1.4826 * float(np.median(np.abs(thirds - np.median(thirds)))) / math.sqrt(20.0)


def _curvature_signal(flights: Sequence[Flight]) -> float:
    """Root mean square of what bends the tracks away from straight lines, m."""
    squares: list[float] = []
    for flight in flights:
        for column in flight.position_m.T:
            line = np.polyval(np.polyfit(flight.time_s, column, 1), flight.time_s)
            squares += ((column - line) ** 2).tolist()
    axes = flights[0].position_m.shape[1]
    return math.sqrt(float(np.mean(squares)) * axes)


def _top_speed(problem: FlightProblem, values: Mapping[str, float]) -> float:
    tracks = [track[0] for track in problem.simulate([values])]
    return max(
        float(np.max(np.linalg.norm(np.gradient(track, flight.time_s, axis=0), axis=1)))
        for track, flight in zip(tracks, problem.flights, strict=True)
    )


def _plots(
    problem: FlightProblem, base: Mapping[str, float], best: Mapping[str, float]
) -> dict[str, Any]:
    """Height residuals of gravity alone and of the explanation, by flight."""
    plots: dict[str, Any] = {}
    pairs = zip(problem.flights, problem.simulate([base]), problem.simulate([best]), strict=True)
    for k, (flight, (ideal,), (explained,)) in enumerate(pairs):
        plots[f"flight_{k}"] = {
            "x": flight.time_s.tolist(),
            "x_unit": "s",
            "measured": flight.position_m[:, -1].tolist(),
            "ideal": ideal[:, -1].tolist(),
            "explained": explained[:, -1].tolist(),
            "unit": "m",
        }
    return plots


_SEPARATING: Final[Mapping[frozenset[str], str]] = {
    frozenset(
        ("air_drag", "wind")
    ): "the same throw in the opposite direction: drag turns with it, wind does not",
    frozenset(
        ("air_drag", "release_delay")
    ): "tracking that begins before the release, at 60 Hz or more",
    frozenset(
        ("air_drag", "release_spin")
    ): "throws at two speeds with a marked ball, filmed from the side",
}
