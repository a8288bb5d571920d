"""Diagnose the free swing of a hanging body from its angle: friction, length, stiffness.

The ideal body swings without loss. The latency of a single angle sensor only shifts the record and cannot
be identified. Without a reference length the frequency determines the length.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np

from diagnosis.single_stage.fit import fit_structure
from diagnosis.single_stage.fit_problem import EffectOption, FitProblem
from diagnosis.single_stage.stage_result import StageLabels, build_diagnosis
from diagnosis.single_stage.structure_selection import (
    RELEVANT_RATIO,
    WHITE_RESIDUAL_RATIO,
    select_structure,
)
from diagnosis.single_stage.swing_problem import SwingProblem, make_swing_problem
from diagnosis.single_stage.uncertainty import (
    estimate_correlation_samples,
    estimate_standard_errors,
    interval_half_width_factor,
)
from diagnosis.tables.cells import RefusedTableError
from diagnosis.tables.consistency import find_clipping, refuse_mixed_time_units
from diagnosis.tables.free_swings import (
    MIN_PERIODS,
    SwingRecord,
    estimate_swing_noise,
    extract_free_swing,
    find_half_periods,
)
from diagnosis.verdict import Diagnosis, Stage
from machine.conventions import GRAVITY_M_PER_S2

MIN_DRIFT_RATIO: Final = 0.003
"""Smallest frequency drift worth naming; smaller ones follow from errors of rest angle and amplitude."""
MIN_THIRD_ROWS: Final = 40
"""Fewest rows in a third of a swing."""
MIN_HALF_PERIODS: Final = 8
"""Fewest half periods in a third of a swing."""
DRIFT_HALF_WIDTHS: Final = 3.0
"""Significance of a drift, in half widths of the 90 % intervals of both frequencies."""
FREQUENCY_PARAMETER: Final = "frequency_rad_per_s"
UNMODELLED_PROBABILITY: Final = 0.95
"""Probability of "unknown" for a swing that grows or whose frequency drifts."""
SPRING_RATIO: Final = 0.5
"""Mean square with a linear restoring force, relative to a pendulum's, below which it is a spring."""
NOT_SEPARABLE: Final = [
    "latency of the angle sensor or IMU: it shifts the whole record; it needs a second sensor",
    "length and stiffness: both change the frequency alone",
    "mass: a free pendulum's swing does not depend on it",
]


class FrequencyDrift(NamedTuple):
    """Relative change of the frequency from the first to the last third of a swing."""

    ratio: float
    chance_ratio: float
    """Largest change by chance."""

    @property
    def is_significant(self) -> bool:
        """Whether the change exceeds chance and `MIN_DRIFT_RATIO`."""
        return abs(self.ratio) > max(self.chance_ratio, MIN_DRIFT_RATIO)


def measure_frequency_drift(
    swing: SwingRecord,
    noise: float,
    make_part_problem: Callable[[SwingRecord], tuple[FitProblem, Sequence[EffectOption]]],
) -> FrequencyDrift | None:
    """Frequency drift of a free swing beyond the effect of its amplitude; None if its thirds are too short.

    A moving load, a warming spring or a drifting clock causes it; frictions do not.

    Args:
        swing: its free part.
        noise: standard deviation of one sample, rad or m.
        make_part_problem: fit problem of a third, with free frequency, and its options.
    """
    rows = len(swing.time_s) // 3
    if rows < MIN_THIRD_ROWS:
        return None
    found: list[tuple[float, float]] = []
    for part in (slice(0, rows), slice(-rows, None)):
        time_s, angle = swing.time_s[part], swing.angle_rad[part]
        if len(find_half_periods(angle, noise)) < MIN_HALF_PERIODS:
            return None
        problem, options = make_part_problem(SwingRecord(time_s - time_s[0], angle))
        part_fit = fit_structure(problem, tuple(options), {})
        length = estimate_correlation_samples(part_fit.residual, problem.block)
        error = estimate_standard_errors(problem, part_fit, length) * interval_half_width_factor(
            problem
        )
        k = part_fit.names.index(FREQUENCY_PARAMETER)
        found.append((float(part_fit.values[k]), float(error[k])))
    (first, error), (last, other) = found
    return FrequencyDrift(
        last / first - 1.0, DRIFT_HALF_WIDTHS * float(np.hypot(error, other)) / first
    )


def diagnose_swing(
    swings: Sequence[SwingRecord],
    length_m: float = math.nan,
    joint: str | None = None,
    progress: Callable[[str], None] | None = None,
    is_length: bool = False,
) -> Diagnosis:
    """Diagnose free swings of one hanging body.

    Args:
        swings: each from its release on; rows before the first extreme are dropped.
        length_m: length of the ideal pendulum, pivot to centre of oscillation; nan without a reference.
        joint: its name in the result.
        progress: called with a line of text at each level of the search.
        is_length: whether deflections are in m (mass on a spring).

    Raises:
        RefusedTableError: nothing swings, or there are too few samples per period.
    """
    notes: list[str] = []
    problem = _make_free_problem(
        _remove_clipping(swings, length_m, notes), length_m, is_length, notes
    )
    noise, usable = problem.noise, problem.swings
    friction_mean_square = fit_structure(problem, _friction_options(problem), {}).mean_square
    is_noise_like = math.sqrt(friction_mean_square) < WHITE_RESIDUAL_RATIO * noise
    if not is_length and not is_noise_like and _is_spring(problem, friction_mean_square):
        problem = replace(problem, is_linear=True)
        notes.append(
            "the period does not grow with the angle as a pendulum's: taken as a spring or a torsion wire"
        )
    signal = math.sqrt(float(np.mean(np.concatenate([s.angle_rad for s in usable]) ** 2)))
    # If frictions leave only noise, even small effects are named: no model error can mimic them.
    relevant_ratio = 0.0 if is_noise_like else RELEVANT_RATIO
    selection = select_structure(problem, signal, noise, progress, relevant_ratio)
    words = _describe_energy_input(usable) or (
        "" if is_noise_like else _describe_frequency_drift(problem)
    )
    if words:
        # No effect of the library causes this.
        selection = replace(selection, unknown_probability=UNMODELLED_PROBABILITY)
    unit = "m" if is_length else "rad"
    best = selection.best.fit.as_mapping()
    found = build_diagnosis(
        problem,
        selection,
        noise,
        StageLabels(Stage.SWING, joint, unit, SEPARATING_RECORDS),
        _evidence(problem, best["frequency_rad_per_s"], unit, notes),
        _plots(problem, selection.base.fit.as_mapping(), best),
    )
    return found.model_copy(update={"sentence": f"{words} {found.sentence}".strip()})


def _make_free_problem(
    swings: Sequence[SwingRecord], length_m: float, is_length: bool, notes: list[str]
) -> SwingProblem:
    """The fit problem of the free parts of all swings; notes say which parts are used.

    Raises:
        RefusedTableError: no swing has a free part.
    """
    noise = estimate_swing_noise(swings)
    usable = tuple(
        s for s in (extract_free_swing(swing, noise) for swing in swings) if s is not None
    )
    if not usable:
        raise RefusedTableError(
            f"fewer than {MIN_PERIODS:g} periods of free swing above the noise ({noise:.2g}"
            f"{'' if is_length else ' rad'}): record from the release until the swing has died down"
        )
    notes += [_describe_used_part(swing) for swing in usable]
    return make_swing_problem(usable, length_m, noise, is_length)


def _remove_clipping(
    swings: Sequence[SwingRecord], length_m: float, notes: list[str]
) -> list[SwingRecord]:
    """The swings without clipped samples.

    Raises:
        RefusedTableError: the length is not positive, or units of time are mixed.
    """
    if math.isfinite(length_m) and length_m <= 0.0:
        raise RefusedTableError(
            f"a length of {length_m:g} m from the pivot to the centre of swing: it must be above 0. Give "
            "--length-m in metres, or leave it out"
        )
    refuse_mixed_time_units([swing.time_s for swing in swings])
    return [_drop_clipped(swing, notes) for swing in swings]


def _evidence(
    problem: SwingProblem, frequency: float, unit: str, notes: Sequence[str]
) -> dict[str, Any]:
    """Facts of the record, and what swings cannot separate; `frequency` in rad/s."""
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
        "not_separable": NOT_SEPARABLE,
    }


def _describe_energy_input(swings: Sequence[SwingRecord]) -> str:
    """Sentence on a growing amplitude; empty without one."""
    energy_input = next(
        (swing.energy_input for swing in swings if swing.energy_input is not None), None
    )
    if energy_input is None:
        return ""
    return (
        f"The amplitude grows by {energy_input.share:.0%} from {energy_input.from_s:.3g} to "
        f"{energy_input.to_s:.3g} s: energy is fed in by a drive or a hand, or comes from another motion of "
        "the body. Record a swing that is let go and left alone, about one axis."
    )


def _describe_frequency_drift(problem: SwingProblem) -> str:
    """Sentence on a significant frequency drift; empty without one."""

    def make_part(part: SwingRecord) -> tuple[SwingProblem, tuple[EffectOption, ...]]:
        part_problem = make_swing_problem((part,), math.nan, problem.noise, problem.is_linear)
        return part_problem, _friction_options(part_problem)[:1]

    for swing in problem.swings:
        drift = measure_frequency_drift(swing, problem.noise, make_part)
        if drift is not None and drift.is_significant:
            return (
                f"The frequency changes by {drift.ratio:+.1%} from the first to the last third of the swing, "
                "beyond what its amplitude does: length, load or stiffness change meanwhile, or the clock "
                "drifts. Let it warm up, fasten the load, or record a shorter swing."
            )
    return ""


def _drop_clipped(swing: SwingRecord, notes: list[str]) -> SwingRecord:
    """A swing without clipped samples; a note says how many."""
    out = find_clipping(swing.angle_rad)
    if not np.any(out):
        return swing
    limit = float(np.max(np.abs(swing.angle_rad[out])))
    notes.append(
        f"{int(np.sum(out))} of {len(out)} samples left out: the angle is cut off at {limit:.4g}, several "
        "equal extremes one after the other. A sensor of a larger range tells more"
    )
    return swing._replace(time_s=swing.time_s[~out], angle_rad=swing.angle_rad[~out])


def _describe_used_part(swing: SwingRecord) -> str:
    """Note on the part of the record that is used, and why it ends."""
    until_s = swing.start_s + float(swing.time_s[-1])
    return f"used: {swing.start_s:.4g} to {until_s:.4g} s of the record; {swing.end_reason}"


def _friction_options(problem: SwingProblem) -> tuple[EffectOption, ...]:
    """Viscous and Coulomb friction."""
    return tuple(option for option in problem.options if option.key.startswith("passive_"))


def _is_spring(problem: SwingProblem, as_pendulum: float) -> bool:
    """Whether a linear restoring force fits clearly better than a pendulum's, with frictions in both."""
    on_spring = fit_structure(
        replace(problem, is_linear=True), _friction_options(problem), {}
    ).mean_square
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


LONGER_RECORD: Final = (
    "a free swing from the largest safe angle until rest: viscous friction decays by a ratio a period, "
    "Coulomb by a constant angle, air drag fast at first and slowly later"
)


SEPARATING_RECORDS: Final[Mapping[frozenset[str], str]] = {
    frozenset(("passive_viscous_friction", "passive_coulomb_friction")): LONGER_RECORD,
    frozenset(("passive_viscous_friction", "air_drag")): LONGER_RECORD,
    frozenset(("passive_coulomb_friction", "air_drag")): LONGER_RECORD,
    frozenset(("gripper_length", "hose_stiffness")): (
        "a swing with another load or another length: a spring's share of the stiffness does not scale with "
        "gravity; on one body the two are the same"
    ),
}
