"""Diagnose the flight of a tracked ball from its positions: drag, wind, spin, late release, or none.

The initial state of each flight is fitted. The length scale may be wrong by 2 % and the vertical tilted by
1.1 degrees, so that neither is mistaken for drag or wind. Axis z is up.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.stats import f as fisher

from diagnosis.single_stage.fit import fit_structure
from diagnosis.single_stage.fit_problem import EffectOption, FitProblem
from diagnosis.single_stage.flight_problem import (
    AIR_DENSITY_KG_PER_M3,
    BallProperties,
    FlightProblem,
    make_flight_problem,
)
from diagnosis.single_stage.stage_result import StageLabels, build_diagnosis
from diagnosis.single_stage.structure_selection import Selection, select_structure
from diagnosis.single_stage.uncertainty import estimate_correlation_samples
from diagnosis.tables.cells import RefusedTableError
from diagnosis.tables.consistency import (
    refuse_mixed_length_units,
    refuse_mixed_time_units,
    refuse_motionless,
)
from diagnosis.tables.tracks import (
    FlightRecord,
    TrackScale,
    estimate_track_noise,
    falls_freely,
    falls_impossibly,
    guess_length_unit,
    measure_curvature,
    orient_tracks,
    refuse_no_free_fall,
    select_flights,
)
from diagnosis.verdict import Ambiguity, Diagnosis, Stage, VerdictKind

DISAGREEMENT_P_VALUE: Final = 1e-3
"""Probability under equal parameters below which runs disagree."""
MIXED_RATIO: Final = 2.0
"""Residual of the pooled fit, relative to separate fits, above which runs are of different bodies."""
SPHERE_DRAG_COEFFICIENT: Final = 0.47
"""Drag coefficient of a sphere below the drag crisis (Hoerner, Fluid-Dynamic Drag, 1965)."""
MAX_ROLL_RAD: Final = 0.15
"""Largest roll of an unlevelled camera, rad."""
WIND_LOG_LIKELIHOOD_GAIN: Final = 5.0
"""Gain of log-likelihood from which wind is preferred to a rolled camera."""
MAX_SPHERE_DRAG_COEFFICIENT: Final = 0.7
"""Drag coefficient above which a body is no sphere; 0.47 with 50 % for lengths and roughness."""
MAX_LIKELY_DRAG_PER_M: Final = 0.25
"""Drag above which a film of an unknown body is doubted; a shuttlecock that falls at 6.7 m/s has 0.22."""
DEFAULT_SCALE: Final = TrackScale()
DRAG_EXPLAINED_RATIO: Final = 0.1
"""Residual, as a share of the tracks' curvature, below which gravity and drag explain the fall."""


class Disagreement(NamedTuple):
    """Runs whose parameters differ by more than their noise allows."""

    ratio: float
    """Root mean square residual of the pooled fit relative to separate fits."""
    values: tuple[Mapping[str, float], ...]
    """Effect parameters by run."""

    @property
    def is_mixed(self) -> bool:
        """Whether pooled parameters would be grossly wrong."""
        return self.ratio > MIXED_RATIO

    def describe(self) -> str:
        """The parameter that differs most, by run."""
        names = list(self.values[0])
        spread = [
            np.ptp([v[n] for v in self.values])
            / (abs(float(np.median([v[n] for v in self.values]))) + 1e-9)
            for n in names
        ]
        most_variable = names[int(np.argmax(spread))]
        sizes = ", ".join(f"{v[most_variable]:.3g}" for v in self.values[:8])
        more = ", ..." if len(self.values) > 8 else ""
        return (
            f"{most_variable} by run: {sizes}{more}; a fit for each leaves {1.0 / self.ratio:.0%} of the "
            "residual"
        )


def find_disagreement(
    pooled: FitProblem, parts: Sequence[FitProblem], keys: Sequence[str]
) -> Disagreement | None:
    """F test of one fit for all runs against one per run; None if they agree or there is one run.

    Args:
        pooled: all runs together.
        parts: each run by itself, with the same options.
        keys: options that are fitted.
    """
    if len(parts) < 2:
        return None
    pooled_fit = fit_structure(pooled, _select_options(pooled, keys), {})
    separate_fits = [fit_structure(part, _select_options(part, keys), {}) for part in parts]
    separate_squares = sum(float(np.sum(one.residual**2)) for one in separate_fits)
    pooled_squares = float(np.sum(pooled_fit.residual**2))
    lengths = [
        estimate_correlation_samples(one.residual, part.block)
        for one, part in zip(separate_fits, parts, strict=True)
    ]
    # Residuals of the separate fits: those of the pooled fit are correlated by the disagreement itself.
    count = len(pooled_fit.residual) / float(np.mean(lengths))
    size = sum(len(one.values) for one in separate_fits)
    extra_parameters = max(size - len(pooled_fit.values), 1)
    freedom = max(count - size, 1.0)
    ratio2 = (max(pooled_squares - separate_squares, 0.0) / extra_parameters) / max(
        separate_squares / freedom, 1e-300
    )
    if float(fisher.sf(ratio2, extra_parameters, freedom)) > DISAGREEMENT_P_VALUE:
        return None
    names = {f"{o.key}.{p.name}" for o in pooled_fit.options for p in o.parameters}
    return Disagreement(
        float(np.sqrt(pooled_squares / max(separate_squares, 1e-300))),
        tuple({n: v for n, v in one.as_mapping().items() if n in names} for one in separate_fits),
    )


def _select_options(problem: FitProblem, keys: Sequence[str]) -> tuple[EffectOption, ...]:
    return tuple(option for option in problem.options if option.key in keys)


def diagnose_flight(
    flights: Sequence[FlightRecord],
    ball: BallProperties,
    name: str | None = None,
    progress: Callable[[str], None] | None = None,
    is_mixed_refused: bool = False,
    scale: TrackScale = DEFAULT_SCALE,
) -> Diagnosis:
    """Diagnose the flights of one ball.

    Args:
        flights: its tracked flights.
        ball: mass and diameter, nan where unknown.
        name: its name in the result.
        progress: called with a line of text at each level of the search.
        is_mixed_refused: whether flights that disagree are refused; set if no label assigns them to one ball.
        scale: assumptions that may be made about axes and lengths.

    Raises:
        RefusedTableError: nothing falls, length units are wrong or mixed, or there are several balls.
    """
    refuse_mixed_time_units([flight.time_s for flight in flights])
    refuse_motionless([flight.position_m for flight in flights], estimate_track_noise(flights))
    for flight in flights:
        refuse_mixed_length_units(flight.time_s, flight.position_m)
    flights, notes = orient_tracks(flights, scale)
    usable = select_flights(flights, name, notes)
    problem = make_flight_problem(usable, ball, scale.tolerance_ratio)
    noise = problem.noise
    if not falls_freely(usable):
        if (
            falls_impossibly(usable)
            or _is_in_other_unit(usable, ball)
            or not _is_explained_by_drag(problem, ("air_drag", "release_delay", "release_spin"))
        ):
            refuse_no_free_fall(usable)
        notes.append("drag or lift is as strong as gravity for part of the flight")
    run_disagreement = _find_flight_disagreement(usable, ball, problem, scale.tolerance_ratio)
    if run_disagreement is not None:
        notes.append(_describe_disagreement(run_disagreement, len(usable), is_mixed_refused))
    signal = measure_curvature(usable)
    selection = select_structure(problem, signal, noise, progress)
    best = selection.best.fit.as_mapping()
    is_ball_known = not math.isnan(ball.drag_per_m)
    evidence = _evidence(problem, selection, scale, is_ball_known, notes)
    found = build_diagnosis(
        problem,
        selection,
        noise,
        StageLabels(Stage.FLIGHT, name, "m", SEPARATING_RECORDS),
        evidence,
        _plots(problem, selection.base.fit.as_mapping(), best),
    )
    if (roll := _find_equivalent_roll(problem, selection)) is not None:
        words = (
            f"In place of wind a camera that is rolled by {roll:.2g} degrees explains them as well."
        )
        found = found.model_copy(update={"sentence": f"{found.sentence} {words}"})
    if problem.flights[0].position_m.shape[1] == 2 and found.verdict is VerdictKind.EXPLAINED:
        found = _qualify_film(found, name, is_ball_known)
    return _compare_with_sphere_drag(found, is_ball_known)


def _qualify_film(found: Diagnosis, name: str | None, is_ball_known: bool) -> Diagnosis:
    """Say that a film of one plane lacks depth; a drag that few bodies have may then be the camera's view."""
    words = (
        "The film shows one plane: motion toward or away from the camera is not seen, and a plane that is "
        "not square to the camera changes lengths and drag."
    )
    found = found.model_copy(update={"sentence": f"{found.sentence} {words}"})
    limit = MAX_SPHERE_DRAG_COEFFICIENT if is_ball_known else MAX_LIKELY_DRAG_PER_M
    drag = next((effect for effect in found.causes[0].effects if effect.effect == "air_drag"), None)
    if drag is None or min(p.value for p in drag.parameters.values()) <= limit:
        return found
    why = (
        f"drag is above a sphere's, at most {MAX_SPHERE_DRAG_COEFFICIENT:g}"
        if is_ball_known
        else f"drag is above a shuttlecock's, {MAX_LIKELY_DRAG_PER_M:g} 1/m, and mass and diameter are not "
        "given (--mass-kg, --diameter-m)"
    )
    ambiguity = Ambiguity(
        members=(found.causes[0].name, "camera not square to the flight"),
        separating_motion={
            "kind": Stage.FLIGHT.value,
            "joint": name,
            "words": "the same throw filmed square to its plane from further away, or by two cameras",
        },
        why=why,
    )
    sentence = f"{found.sentence} It may as well be the camera's view: {why}."
    return found.model_copy(
        update={"verdict": VerdictKind.AMBIGUOUS, "ambiguity": ambiguity, "sentence": sentence}
    )


def _describe_disagreement(
    run_disagreement: Disagreement, flight_count: int, is_mixed_refused: bool
) -> str:
    """Note on the parameters in which the flights disagree.

    Raises:
        RefusedTableError: the flights are of several balls and `is_mixed_refused`.
    """
    if run_disagreement.is_mixed and is_mixed_refused:
        raise RefusedTableError(
            f"the {flight_count} flights of this file disagree ({run_disagreement.describe()}): several "
            "balls, or other conditions. Give --group COLUMN that tells balls apart, or one file a ball"
        )
    return f"the {flight_count} flights disagree beyond their noise: {run_disagreement.describe()}"


def _find_equivalent_roll(problem: FlightProblem, selection: Selection) -> float | None:
    """Tilt of the vertical, degrees, that explains the flights as well as wind; None if wind is needed."""
    best = selection.best.fit
    if "wind" not in selection.best.effects:
        return None
    nuisance = tuple(
        p._replace(low=-MAX_ROLL_RAD, high=MAX_ROLL_RAD, prior_sd=math.inf)
        if p.name.startswith("lean")
        else p
        for p in problem.nuisance
    )
    rest = tuple(option for option in best.options if option.key != "wind")
    roll_fit = fit_structure(replace(problem, nuisance=nuisance), rest, {})
    independent = len(problem.block) / selection.correlation_samples
    log_likelihood_gain = 0.5 * independent * math.log(roll_fit.mean_square / best.mean_square)
    if log_likelihood_gain > WIND_LOG_LIKELIHOOD_GAIN:
        return None
    values = roll_fit.as_mapping()
    leans = [value for name, value in values.items() if name.startswith("lean")]
    return math.degrees(math.hypot(*leans))


def _evidence(
    problem: FlightProblem,
    selection: Selection,
    scale: TrackScale,
    is_ball_known: bool,
    notes: Sequence[str],
) -> dict[str, Any]:
    """Facts of the record, and what flights cannot separate."""
    flights, best = problem.flights, selection.best.fit.as_mapping()
    evidence: dict[str, Any] = {
        "flights": len(flights),
        "samples": int(sum(len(flight.time_s) for flight in flights)),
        "axes": flights[0].position_m.shape[1],
        "rate_hz": float(np.median([1.0 / np.median(np.diff(f.time_s)) for f in flights])),
        "noise": {"value": problem.noise, "unit": "m"},
        "top_speed_m_per_s": _simulate_top_speed(problem, best),
        "drag_unit": "drag coefficient (mass and diameter given)"
        if is_ball_known
        else "1/m: a = -k |v| v",
        "notes": notes,
        "not_separable": [
            f"a wrong length scale and gravity ({scale.tolerance_ratio:.0%} are allowed for)",
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


def _compare_with_sphere_drag(found: Diagnosis, is_ball_known: bool) -> Diagnosis:
    """Add whether the drag of a sphere would have been seen."""
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


def _is_explained_by_drag(problem: FlightProblem, keys: Sequence[str]) -> bool:
    """Whether these effects explain a fall at another rate than gravity's, as of a shuttlecock."""
    found = fit_structure(
        problem, tuple(option for option in problem.options if option.key in keys), {}
    )
    return math.sqrt(found.mean_square) < DRAG_EXPLAINED_RATIO * measure_curvature(problem.flights)


def _is_in_other_unit(flights: tuple[FlightRecord, ...], ball: BallProperties) -> bool:
    """Whether gravity and drag, without lift, explain the flights in another unit of length."""
    other = guess_length_unit(flights)
    if other is None:
        return False
    scaled = tuple(flight._replace(position_m=flight.position_m / other[0]) for flight in flights)
    return _is_explained_by_drag(make_flight_problem(scaled, ball), ("air_drag", "release_delay"))


def _find_flight_disagreement(
    flights: Sequence[FlightRecord],
    ball: BallProperties,
    problem: FlightProblem,
    scale_tolerance_ratio: float,
) -> Disagreement | None:
    """Whether the flights need different drag, wind and spin."""
    parts = [
        replace(
            make_flight_problem((flight,), ball, scale_tolerance_ratio), options=problem.options
        )
        for flight in flights
    ]
    return find_disagreement(problem, parts, ("air_drag", "wind", "release_spin"))


def _simulate_top_speed(problem: FlightProblem, values: Mapping[str, float]) -> float:
    tracks = [track[0] for track in problem.simulate([values])]
    return max(
        float(np.max(np.linalg.norm(np.gradient(track, flight.time_s, axis=0), axis=1)))
        for track, flight in zip(tracks, problem.flights, strict=True)
    )


def _plots(
    problem: FlightProblem, base: Mapping[str, float], best: Mapping[str, float]
) -> dict[str, Any]:
    """Measured, ideal and explained height by flight."""
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


SEPARATING_RECORDS: Final[Mapping[frozenset[str], str]] = {
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
