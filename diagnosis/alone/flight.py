"""Diagnoses the flight of a tracked ball from its positions alone: drag, wind, spin, late release, or none.

Every flight's start and speed are fitted with it. Lengths may be wrong by 2 % and the vertical may lean by
1.1 degrees, so that a camera's scale is not taken for drag, nor its roll for wind. Axis z is up.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from diagnosis.alone.agreement import Disagreement, disagreement
from diagnosis.alone.fit import fit
from diagnosis.alone.flight_problem import (
    AIR_DENSITY_KG_PER_M3,
    Ball,
    FlightProblem,
    make_problem,
)
from diagnosis.alone.reading.consistency import (
    refuse_changed_clock,
    refuse_changed_unit,
    refuse_rest,
)
from diagnosis.alone.reading.layout import RefusedTableError
from diagnosis.alone.reading.tracks import (
    Flight,
    Scale,
    curvature_signal,
    falls_freely,
    other_unit,
    refuse_fall,
    track_noise,
    upright,
    usable_flights,
)
from diagnosis.alone.selection import Selection, select
from diagnosis.alone.verdict import StageNames, diagnosis_of
from diagnosis.verdict import Diagnosis, Stage

SPHERE_DRAG_COEFFICIENT: Final = 0.47
"""Below the drag crisis (Hoerner, Fluid-Dynamic Drag, 1965)."""
WIDEST_ROLL_RAD: Final = 0.15
"""Of a camera that nobody levelled, by eye."""
SURELY_WIND: Final = 5.0
"""Difference of log likelihoods beyond which wind is not taken for a rolled camera."""
UNKNOWN_RATIO: Final = 0.35
METRES: Final = Scale()
DRAGGED_RATIO: Final = 0.1
"""Of what bends the tracks: gravity and drag that leave less explain a fall at another rate."""


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
    if split is not None:
        notes.append(_in_words(split, len(usable), is_mixed_refused))
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


def _in_words(split: Disagreement, flight_count: int, is_mixed_refused: bool) -> str:
    """What flights disagree in.

    Raises:
        RefusedTableError: several balls, where those are refused.
    """
    if split.is_mixed and is_mixed_refused:
        raise RefusedTableError(
            f"the {flight_count} flights of this file disagree ({split.in_words()}): several balls, or other "
            "conditions. Give --group COLUMN that tells balls apart, or one file a ball"
        )
    return f"the {flight_count} flights disagree beyond their noise: {split.in_words()}"


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
