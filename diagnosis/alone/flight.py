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
from diagnosis.alone.fit import FreeParameter, Option, fit
from diagnosis.alone.physics.flight_path import integrate, sampled
from diagnosis.alone.reading.consistency import (
    refuse_changed_clock,
    refuse_changed_unit,
    refuse_rest,
)
from diagnosis.alone.reading.layout import RefusedTableError
from diagnosis.alone.reading.tracks import (
    SCALE_SLACK_RATIO,
    Flight,
    Scale,
    curvature_signal,
    falls_freely,
    fastest,
    first_motion,
    other_unit,
    refuse_fall,
    track_noise,
    upright,
    usable_flights,
)
from diagnosis.alone.selection import Selection, every_third, select
from diagnosis.alone.verdict import StageNames, diagnosis_of
from diagnosis.verdict import Diagnosis, Stage
from machine.conventions import GRAVITY_M_PER_S2, Array, BoolArray, IntArray

AIR_DENSITY_KG_PER_M3: Final = 1.204
"""20 C at sea level."""
SPHERE_DRAG_COEFFICIENT: Final = 0.47
"""Below the drag crisis (Hoerner, Fluid-Dynamic Drag, 1965)."""
LEAN_RAD: Final = 0.02
"""Of the vertical, by eye: a camera on a tripod is set up to half a degree, by hand to one."""
WIDEST_ROLL_RAD: Final = 0.15
"""Of a camera that nobody levelled, by eye."""
SURELY_WIND: Final = 5.0
"""Difference of log likelihoods beyond which wind is not taken for a rolled camera."""
STEPS_COUNT: Final = 200
FINEST_STEP_S: Final = 0.002
BLOCKS_PER_FLIGHT: Final = 5
UNKNOWN_RATIO: Final = 0.35
METRES: Final = Scale()
DRAGGED_RATIO: Final = 0.1
"""Of what bends the tracks: gravity and drag that leave less explain a fall at another rate."""


class Ball(NamedTuple):
    """What is known about the ball; nan where it is not."""

    mass_kg: float = math.nan
    diameter_m: float = math.nan

    @property
    def drag_per_m(self) -> float:
        """Deceleration over speed squared at a drag coefficient of 1, 1/m."""
        area = 0.25 * math.pi * self.diameter_m**2
        return 0.5 * AIR_DENSITY_KG_PER_M3 * area / self.mass_kg


@dataclass(frozen=True, slots=True)
class FlightProblem:
    """Residuals of all flights of one ball; see `fit.Problem`."""

    flights: tuple[Flight, ...]
    nuisance: tuple[FreeParameter, ...]
    options: tuple[Option, ...]
    block: IntArray
    noise: float
    """Of one coordinate, m."""
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
    def timing_s(self) -> float:
        """None: nothing is commanded."""
        return 0.0

    @property
    def accuracy_ratio(self) -> float:
        """Of Heun steps and interpolated positions."""
        return 0.001

    @property
    def local(self) -> frozenset[str]:
        """Where each flight began, and how fast."""
        return frozenset(p.name for p in self.nuisance if "." in p.name)

    def guess(self, names: Sequence[str]) -> Mapping[str, float]:
        """None: the starts are enough."""
        return {}

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
        path = integrate(
            start_of("p").reshape(-1, axes),
            start_of("v").reshape(-1, axes),
            grid_s,
            {name: np.repeat([one[name] for one in values], count)[:, None] for name in values[0]},
            self.drag_per_m,
        ).reshape(len(grid_s), sets, count, axes)
        delay_s = np.array([one.get("release_delay.extra_delay_s", 0.0) for one in values])
        return [
            sampled(path[:, :, k], grid_s[1], np.maximum(flight.time_s - delay_s[:, None], 0.0))
            for k, flight in enumerate(self.flights)
        ]


def diagnose_ball(
    flights: Sequence[Flight],
    ball: Ball,
    name: str | None = None,
    progress: Callable[[str], None] | None = None,
    is_mixed_refused: bool = False,
    scale: Scale = METRES,
) -> Diagnosis:
    """Diagnose the flights of one ball; `is_mixed_refused` when nothing says that they are of one.

    Raises:
        RefusedTableError: nothing falls in them, lengths in another unit or in two, or several balls.
    """
    refuse_changed_clock([flight.time_s for flight in flights])
    refuse_rest([flight.position_m for flight in flights], track_noise(flights))
    for flight in flights:
        refuse_changed_unit(flight.time_s, flight.position_m)
    flights, notes = upright(flights, scale)
    usable = usable_flights(flights, name, notes)
    problem = make_problem(usable, ball, scale.slack_ratio)
    noise = problem.noise
    if not falls_freely(usable):
        if _is_in_other_unit(usable, ball) or not _is_dragged(
            problem, ("air_drag", "release_delay", "release_spin")
        ):
            refuse_fall(usable)
        notes.append("drag or lift is as strong as gravity for part of the flight")
    split = _disagreement(usable, ball, problem, scale.slack_ratio)
    if split is not None and split.is_mixed and is_mixed_refused:
        raise RefusedTableError(
            f"the {len(usable)} flights of this file disagree ({split.in_words()}): several balls, or other "
            "conditions. Give --group COLUMN that tells balls apart, or one file a ball"
        )
    if split is not None:
        notes.append(f"the {len(usable)} flights disagree beyond their noise: {split.in_words()}")
    signal = curvature_signal(usable)
    selection = select(problem, signal, noise, progress, UNKNOWN_RATIO)
    best = selection.best.fit.as_mapping()
    known = not math.isnan(ball.drag_per_m)
    evidence = _evidence(problem, selection, scale, known, notes)
    found = diagnosis_of(
        problem,
        selection,
        noise,
        StageNames(Stage.FLIGHT, name, "m", _SEPARATING),
        evidence,
        _plots(problem, selection.base.fit.as_mapping(), best),
    )
    if (roll := _roll_in_place_of_wind(problem, selection)) is not None:
        words = (
            f"In place of wind a camera that is rolled by {roll:.2g} degrees explains them as well."
        )
        found = found.model_copy(update={"sentence": f"{found.sentence} {words}"})
    return _with_expected_drag(found, known)


def _roll_in_place_of_wind(problem: FlightProblem, selection: Selection) -> float | None:
    """Lean of the vertical, degrees, with which the flights need no wind; None if they do need it."""
    best = selection.best.fit
    if "wind" not in selection.best.effects:
        return None
    nuisance = tuple(
        p._replace(low=-WIDEST_ROLL_RAD, high=WIDEST_ROLL_RAD, prior_sd=math.inf)
        if p.name.startswith("lean")
        else p
        for p in problem.nuisance
    )
    rest = tuple(option for option in best.options if option.key != "wind")
    rolled = fit(replace(problem, nuisance=nuisance), rest, {})
    independent = len(problem.block) / selection.correlation_samples
    more = 0.5 * independent * math.log(rolled.mean_square / best.mean_square)
    if more > SURELY_WIND:
        return None
    values = rolled.as_mapping()
    leans = [value for name, value in values.items() if name.startswith("lean")]
    return math.degrees(math.hypot(*leans))


def _evidence(
    problem: FlightProblem,
    selection: Selection,
    scale: Scale,
    is_ball_known: bool,
    notes: Sequence[str],
) -> dict[str, Any]:
    """What was seen, and what flights cannot tell."""
    flights, best = problem.flights, selection.best.fit.as_mapping()
    evidence: dict[str, Any] = {
        "flights": len(flights),
        "samples": int(sum(len(flight.time_s) for flight in flights)),
        "axes": flights[0].position_m.shape[1],
        "rate_hz": float(np.median([1.0 / np.median(np.diff(f.time_s)) for f in flights])),
        "noise": {"value": problem.noise, "unit": "m"},
        "top_speed_m_per_s": _top_speed(problem, best),
        "drag_unit": "drag coefficient (mass and diameter given)"
        if is_ball_known
        else "1/m: a = -k |v| v",
        "notes": notes,
        "not_separable": [
            f"a wrong length scale and gravity ({scale.slack_ratio:.0%} are allowed for)",
            "a leaning vertical and horizontal acceleration (1.1 degrees are allowed for)",
            "spin and vertical wind"
            if flights[0].position_m.shape[1] > 1
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
    return evidence


def _with_expected_drag(found: Diagnosis, is_ball_known: bool) -> Diagnosis:
    """Set the drag that could not be seen against that of a sphere: is "none" news?"""
    limits = found.evidence["limits"]
    below = next((limit["below"] for limit in limits if limit["effect"] == "air_drag"), None)
    if below is None:
        return found
    if is_ball_known:
        hidden = "would not be seen here" if below > SPHERE_DRAG_COEFFICIENT else "would be seen"
        words = f"The drag coefficient of a sphere, {SPHERE_DRAG_COEFFICIENT:g}, {hidden}."
    else:
        # k = 0.5 rho (pi / 4) Cd d^2 / m
        full = 0.125 * math.pi * AIR_DENSITY_KG_PER_M3 * SPHERE_DRAG_COEFFICIENT
        words = (
            f"A sphere has that drag at {full / below:.2g} kg per square metre of its diameter; whether "
            "drag of a heavier one acts, these data cannot tell."
        )
    return found.model_copy(update={"sentence": f"{found.sentence} {words}"})


def _is_dragged(problem: FlightProblem, keys: Sequence[str]) -> bool:
    """Whether these effects explain what falls at another rate: a shuttlecock, a paper cone, a topspin."""
    found = fit(problem, tuple(option for option in problem.options if option.key in keys), {})
    return math.sqrt(found.mean_square) < DRAGGED_RATIO * curvature_signal(problem.flights)


def _is_in_other_unit(flights: tuple[Flight, ...], ball: Ball) -> bool:
    """Whether in another unit gravity, with drag, is enough: before any lift has a say."""
    other = other_unit(flights)
    if other is None:
        return False
    scaled = tuple(flight._replace(position_m=flight.position_m / other[0]) for flight in flights)
    return _is_dragged(make_problem(scaled, ball), ("air_drag", "release_delay"))


def make_problem(
    flights: tuple[Flight, ...], ball: Ball, slack_ratio: float = SCALE_SLACK_RATIO
) -> FlightProblem:
    """Parameters and blocks of one ball's flights; `slack_ratio` is how far the length scale may be off."""
    axes = flights[0].position_m.shape[1]
    slack = slack_ratio * GRAVITY_M_PER_S2
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
        speed, first = first_motion(flight)
        top = max(top, fastest(flight))
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
        noise=track_noise(flights),
        drag_per_m=ball.drag_per_m if known else 1.0,
    )


def _options(axes: int, top: float, period_s: float, ball_known: bool) -> tuple[Option, ...]:
    """What may act on a flight, by what `axes` can show."""
    drag = (
        FreeParameter("extra_drag_coefficient_ratio", "1", 0.02, 3.0, (0.1, 0.5, 1.2))
        if ball_known
        else FreeParameter("drag_per_m", "1/m", 2e-4, 20.0, (0.002, 0.02, 0.1, 1.0))
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


def _disagreement(
    flights: Sequence[Flight], ball: Ball, problem: FlightProblem, slack_ratio: float
) -> Disagreement | None:
    """Whether the flights need drag, wind and spin of their own."""
    parts = [
        replace(make_problem((flight,), ball, slack_ratio), options=problem.options)
        for flight in flights
    ]
    return disagreement(problem, parts, ("air_drag", "wind", "release_spin"))


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
