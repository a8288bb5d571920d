"""Diagnoses the free swing of a hanging body from its angle alone: which friction, length, stiffness.

The ideal body swings without loss. With one angle sensor its latency shifts the whole record and cannot be
told; with no reference length the frequency gives the length and is no effect.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from diagnosis.alone.fit import fit
from diagnosis.alone.frequency_drift import frequency_drift
from diagnosis.alone.problem import Option
from diagnosis.alone.reading.consistency import clipped, refuse_changed_clock
from diagnosis.alone.reading.free_swings import MIN_PERIODS, Swing, free_part, swing_noise
from diagnosis.alone.reading.layout import RefusedTableError
from diagnosis.alone.selection import CLEAN_NOISES, RELEVANT_RATIO, select
from diagnosis.alone.swing_problem import SwingProblem, make_problem
from diagnosis.alone.verdict import StageNames, diagnosis_of
from diagnosis.verdict import Diagnosis, Stage
from machine.conventions import GRAVITY_M_PER_S2

UNKNOWN_RATIO: Final = 0.3
STRANGE_UNKNOWN: Final = 0.95
"""Probability that something else acts on a swing that grows, or whose frequency drifts."""
SPRING_RATIO: Final = 0.5
"""Mean square left on a spring over that left as a pendulum: below this it is a spring."""
_NOT_SEPARABLE: Final = [
    "latency of the angle sensor or IMU: it shifts the whole record; it needs a second sensor",
    "length and stiffness: both change the frequency alone",
    "mass: a free pendulum's swing does not depend on it",
]


def diagnose_swing(
    swings: Sequence[Swing],
    length_m: float = math.nan,
    joint: str | None = None,
    progress: Callable[[str], None] | None = None,
    is_length: bool = False,
) -> Diagnosis:
    """Diagnose free swings of one hanging body.

    Args:
        swings: each from a release on; what comes before the first turning point is left out.
        length_m: of the ideal pendulum, pivot to centre of swing; nan if there is no reference.
        joint: its name in the result.
        progress: told what was found.
        is_length: the swings are ways in m, of a mass on a spring.

    Raises:
        RefusedTableError: nothing swings, or too few samples a period.
    """
    notes: list[str] = []
    problem = _posed(_checked(swings, length_m, notes), length_m, is_length, notes)
    noise, usable = problem.noise, problem.swings
    left = fit(problem, _frictions(problem), {}).mean_square
    is_clean = math.sqrt(left) < CLEAN_NOISES * noise
    if not is_length and not is_clean and _is_on_a_spring(problem, left):
        problem = replace(problem, is_linear=True)
        notes.append(
            "the period does not grow with the angle as a pendulum's: taken as a spring or a torsion wire"
        )
    signal = math.sqrt(float(np.mean(np.concatenate([s.angle_rad for s in usable]) ** 2)))
    # What is left after the frictions of a clean record is noise: nothing else can pass for a small one.
    relevant_ratio = 0.0 if is_clean else RELEVANT_RATIO
    selection = select(problem, signal, noise, progress, UNKNOWN_RATIO, relevant_ratio)
    words = _energy_fed_in(usable) or ("" if is_clean else _drift_in_words(problem))
    if words:
        # No effect of the library does that: what fits best is a coincidence.
        selection = replace(selection, unknown_probability=STRANGE_UNKNOWN)
    unit = "m" if is_length else "rad"
    best = selection.best.fit.as_mapping()
    found = diagnosis_of(
        problem,
        selection,
        noise,
        StageNames(Stage.SWING, joint, unit, _SEPARATING),
        _evidence(problem, best["frequency_rad_per_s"], unit, notes),
        _plots(problem, selection.base.fit.as_mapping(), best),
    )
    return found.model_copy(update={"sentence": f"{words} {found.sentence}".strip()})


def _posed(
    swings: Sequence[Swing], length_m: float, is_length: bool, notes: list[str]
) -> SwingProblem:
    """The free part of every swing that has one; notes say which.

    Raises:
        RefusedTableError: none has.
    """
    noise = swing_noise(swings)
    usable = tuple(s for s in (free_part(swing, noise) for swing in swings) if s is not None)
    if not usable:
        raise RefusedTableError(
            f"fewer than {MIN_PERIODS:g} periods of free swing above the noise ({noise:.2g}"
            f"{'' if is_length else ' rad'}): record from the release until the swing has died down"
        )
    notes += [_used(swing) for swing in usable]
    return make_problem(usable, length_m, noise, is_length)


def _checked(swings: Sequence[Swing], length_m: float, notes: list[str]) -> list[Swing]:
    """The swings without what their sensor cut off.

    Raises:
        RefusedTableError: a length below 0, or a clock that changes.
    """
    if math.isfinite(length_m) and length_m <= 0.0:
        raise RefusedTableError(
            f"a length of {length_m:g} m from the pivot to the centre of swing: it must be above 0. Give "
            "--length-m in metres, or leave it out"
        )
    refuse_changed_clock([swing.time_s for swing in swings])
    return [_in_range(swing, notes) for swing in swings]


def _evidence(
    problem: SwingProblem, frequency: float, unit: str, notes: Sequence[str]
) -> dict[str, Any]:
    """What was seen, and what swings cannot tell; `frequency` in rad/s."""
    swings = problem.swings
    return {
        "swings": len(swings),
        "samples": int(sum(len(s.time_s) for s in swings)),
        "span_s": float(sum(s.time_s[-1] for s in swings)),
        "rate_hz": float(np.median([1.0 / np.median(np.diff(s.time_s)) for s in swings])),
        "noise": {"value": problem.noise, "unit": unit},
        "frequency_hz": frequency / (2.0 * math.pi),
        "pulls_back": "in proportion to the deflection" if problem.is_linear else "as a pendulum",
        "length_of_equal_pendulum_m": GRAVITY_M_PER_S2 / frequency**2,
        "notes": notes,
        "largest_angle_rad": float(max(np.max(np.abs(s.angle_rad)) for s in swings)),
        "not_separable": _NOT_SEPARABLE,
    }


def _energy_fed_in(swings: Sequence[Swing]) -> str:
    """How much a swing grows; empty when none does."""
    fed = next((swing.fed for swing in swings if swing.fed is not None), None)
    if fed is None:
        return ""
    return (
        f"The amplitude grows by {fed.share:.0%} from {fed.from_s:.3g} to {fed.to_s:.3g} s: energy is fed in "
        "by a drive or a hand, or comes from another motion of the body. Record a swing that is let go "
        "and left alone, about one axis."
    )


def _drift_in_words(problem: SwingProblem) -> str:
    """How much the frequency of a swing changes over its record; empty when no swing shows it surely."""

    def of_third(part: Swing) -> tuple[SwingProblem, tuple[Option, ...]]:
        third = make_problem((part,), math.nan, problem.noise, problem.is_linear)
        return third, _frictions(third)[:1]

    for swing in problem.swings:
        drift = frequency_drift(swing, problem.noise, of_third)
        if drift is not None and drift.is_sure:
            return (
                f"The frequency changes by {drift.ratio:+.1%} from the first to the last third of the swing, "
                "beyond what its amplitude does: length, load or stiffness change meanwhile, or the clock "
                "drifts. Let it warm up, fasten the load, or record a shorter swing."
            )
    return ""


def _in_range(swing: Swing, notes: list[str]) -> Swing:
    """Without samples at the end of the sensor's range."""
    out = clipped(swing.angle_rad)
    if not np.any(out):
        return swing
    limit = float(np.max(np.abs(swing.angle_rad[out])))
    notes.append(
        f"{int(np.sum(out))} of {len(out)} samples left out: the angle is cut off at {limit:.4g}, several "
        "equal extremes one after the other. A sensor of a larger range tells more"
    )
    return swing._replace(time_s=swing.time_s[~out], angle_rad=swing.angle_rad[~out])


def _used(swing: Swing) -> str:
    """Which stretch of the record is used, and why."""
    until_s = swing.since_s + float(swing.time_s[-1])
    return f"used: {swing.since_s:.4g} to {until_s:.4g} s of the record; {swing.end}"


def _frictions(problem: SwingProblem) -> tuple[Option, ...]:
    """Viscous and dry friction."""
    return tuple(option for option in problem.options if option.key.startswith("passive_"))


def _is_on_a_spring(problem: SwingProblem, as_pendulum: float) -> bool:
    """Whether a linear restoring force leaves clearly less than gravity's mean square, frictions apart."""
    on_spring = fit(replace(problem, is_linear=True), _frictions(problem), {}).mean_square
    return on_spring < SPRING_RATIO * as_pendulum


def _plots(
    problem: SwingProblem, base: Mapping[str, float], best: Mapping[str, float]
) -> dict[str, Any]:
    plots: dict[str, Any] = {}
    pairs = zip(problem.swings, problem.simulate([base]), problem.simulate([best]), strict=True)
    for k, (swing, (ideal,), (explained,)) in enumerate(pairs):
        plots[f"swing_{k}"] = {
            "x": swing.time_s.tolist(),
            "x_unit": "s",
            "measured": swing.angle_rad.tolist(),
            "ideal": ideal.tolist(),
            "explained": explained.tolist(),
            "unit": "rad",
        }
    return plots


_LONGER: Final = (
    "a free swing from the largest safe angle until rest: viscous friction decays by a ratio a period, "
    "Coulomb by a constant angle, air drag fast at first and slowly later"
)
_SEPARATING: Final[Mapping[frozenset[str], str]] = {
    frozenset(("passive_viscous_friction", "passive_coulomb_friction")): _LONGER,
    frozenset(("passive_viscous_friction", "air_drag")): _LONGER,
    frozenset(("passive_coulomb_friction", "air_drag")): _LONGER,
    frozenset(("gripper_length", "hose_stiffness")): (
        "a swing with another load or another length: a spring's share of the stiffness does not scale with "
        "gravity; on one body the two are the same"
    ),
}
