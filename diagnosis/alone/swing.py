"""Diagnoses the free swing of a hanging body from its angle alone: which friction, length, stiffness.

The ideal body swings without loss. With one angle sensor its latency shifts the whole record and cannot be
told; with no reference length the frequency gives the length and is no effect.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from diagnosis.alone.fit import FreeParameter, Option, fit
from diagnosis.alone.frequency_drift import frequency_drift
from diagnosis.alone.physics.free_motion import Pull, move
from diagnosis.alone.reading.consistency import clipped, refuse_changed_clock
from diagnosis.alone.reading.decay import frictions_of_decay
from diagnosis.alone.reading.free_swings import (
    MIN_PERIODS,
    Swing,
    free_part,
    swing_noise,
    swing_period,
)
from diagnosis.alone.reading.layout import RefusedTableError
from diagnosis.alone.selection import (
    CLEAN_NOISES,
    RELEVANT_RATIO,
    every_third,
    select,
    spread_blocks,
)
from diagnosis.alone.verdict import StageNames, diagnosis_of
from diagnosis.verdict import Diagnosis, Stage
from machine.conventions import GRAVITY_M_PER_S2, Array, BoolArray, IntArray

STEPS_PER_PERIOD: Final = 40
"""The Runge-Kutta method takes (2 pi / n)^5 / 144 of the amplitude a radian, here 1e-6; 24 steps
took 0.6 % of a weak friction at 50 degrees."""
UNKNOWN_RATIO: Final = 0.3
STRANGE_UNKNOWN: Final = 0.95
"""Probability that something else acts on a swing that grows, or whose frequency drifts."""
MIN_SAMPLES_PER_PERIOD: Final = 6.0
SPRING_RATIO: Final = 0.5
"""Mean square left on a spring over that left as a pendulum: below this it is a spring."""
_NOT_SEPARABLE: Final = [
    "latency of the angle sensor or IMU: it shifts the whole record; it needs a second sensor",
    "length and stiffness: both change the frequency alone",
    "mass: a free pendulum's swing does not depend on it",
]


@dataclass(frozen=True, slots=True)
class SwingProblem:
    """Residuals of all swings; see `fit.Problem`."""

    swings: tuple[Swing, ...]
    nuisance: tuple[FreeParameter, ...]
    options: tuple[Option, ...]
    block: IntArray
    step_s: float
    noise: float
    """rad, or m on a spring."""
    is_linear: bool = False
    """Whether what pulls back is in proportion to the deflection: a spring, a wire; no pendulum."""

    @property
    def rich(self) -> tuple[str, ...]:
        """The search from nothing is enough."""
        return ()

    @property
    def held(self) -> BoolArray:
        """Every third piece."""
        return every_third(self.block)

    @property
    def timing_s(self) -> float:
        """None: nothing is commanded."""
        return 0.0

    @property
    def accuracy_ratio(self) -> float:
        """Of the integration at large angles."""
        return 0.001

    @property
    def local(self) -> frozenset[str]:
        """None: a swing's start is known from any piece of it."""
        return frozenset()

    def guess(self, names: Sequence[str]) -> Mapping[str, float]:
        """The frictions as the amplitudes fall."""
        first = self.nuisance[0].starts[0]
        return frictions_of_decay(self.swings, self.noise, first, names)

    def residuals(self, values: Sequence[Mapping[str, float]]) -> Array:
        """(sets, samples) measured minus simulated, rad."""
        measured = np.concatenate([swing.angle_rad for swing in self.swings])
        return measured - np.concatenate(self.simulate(values), axis=1)

    def simulate(self, values: Sequence[Mapping[str, float]]) -> list[Array]:
        """Angles at each swing's own sample times, (sets, rows) a swing."""
        count, sets = len(self.swings), len(values)
        last = max(float(swing.time_s[-1]) for swing in self.swings)
        grid_s = np.arange(0.0, last + 2.0 * self.step_s, self.step_s)
        start = np.array([[one[f"angle.{k}"] for k in range(count)] for one in values]).ravel()
        rate = np.array([[one[f"rate.{k}"] for k in range(count)] for one in values]).ravel()
        shared = {name: np.repeat([one[name] for one in values], count) for name in values[0]}
        angle, speed = move(_pull(shared, self.is_linear), start, rate, grid_s)
        shape = (len(grid_s), sets, count)
        angle, speed = angle.reshape(shape), speed.reshape(shape) * grid_s[1]
        return [
            _sampled(angle[:, :, k], speed[:, :, k], swing.time_s / grid_s[1])
            for k, swing in enumerate(self.swings)
        ]


def _sampled(angle: Array, change: Array, place: Array) -> Array:
    """Cubic Hermite interpolation at fractional steps (rows,); `change` is the slope a step; (sets, rows)."""
    index = np.minimum(place.astype(np.int64), len(angle) - 2)
    s = (place - index)[:, None]
    a0, a1, d0, d1 = angle[index], angle[index + 1], change[index], change[index + 1]
    rise = a1 - a0
    return (a0 + s * d0 + s * s * (3.0 * rise - 2.0 * d0 - d1) + s**3 * (d0 + d1 - 2.0 * rise)).T


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
    swings = _checked(swings, length_m, notes)
    noise = swing_noise(swings)
    usable = tuple(s for s in (free_part(swing, noise) for swing in swings) if s is not None)
    if not usable:
        raise RefusedTableError(
            f"fewer than {MIN_PERIODS:g} periods of free swing above the noise ({noise:.2g}"
            f"{'' if is_length else ' rad'}): record from the release until the swing has died down"
        )
    problem = make_problem(usable, length_m, noise, is_length)
    notes += [_used(swing) for swing in usable]
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


def make_problem(
    swings: tuple[Swing, ...], length_m: float, noise: float, is_length: bool = False
) -> SwingProblem:
    """Parameters and blocks of the free swings.

    Raises:
        RefusedTableError: too few samples a period.
    """
    period_s = float(np.median([swing_period(swing, noise) for swing in swings]))
    sampled_s = float(np.median([np.median(np.diff(swing.time_s)) for swing in swings]))
    if period_s < MIN_SAMPLES_PER_PERIOD * sampled_s:
        raise RefusedTableError(
            f"{period_s / sampled_s:.2g} samples a period of {period_s:.2g} s, at least "
            f"{MIN_SAMPLES_PER_PERIOD:g} are needed: record faster"
        )
    frequency = 2.0 * math.pi / period_s
    reference = math.sqrt(GRAVITY_M_PER_S2 / length_m) if math.isfinite(length_m) else math.nan
    # A reference length says what the frequency would be; what differs from it is length or stiffness.
    slack, first = (1e-5, reference) if math.isfinite(reference) else (0.3, frequency)
    nuisance = [
        FreeParameter(
            "frequency_rad_per_s", "rad/s", first * (1 - slack), first * (1 + slack), (first,)
        )
    ]
    for k, swing in enumerate(swings):
        size = float(np.max(np.abs(swing.angle_rad)))
        a0, r0 = float(swing.angle_rad[0]), 0.0
        nuisance.append(FreeParameter(f"angle.{k}", "rad", -1.5 * size, 1.5 * size, (a0,)))
        limit = 2.0 * frequency * size
        nuisance.append(FreeParameter(f"rate.{k}", "rad/s", -limit, limit, (r0,)))
    rest = 0.2 * max(float(np.max(np.abs(swing.angle_rad))) for swing in swings)
    nuisance.append(FreeParameter("rest_rad", "rad", -rest, rest, (0.0,)))
    run = np.concatenate([np.full(len(s.time_s), k) for k, s in enumerate(swings)])
    time_s = np.concatenate([swing.time_s for swing in swings])
    seconds = max(period_s, float(np.max(time_s)) / 12.0)
    size = max(float(np.max(np.abs(swing.angle_rad))) for swing in swings)
    return SwingProblem(
        swings=swings,
        nuisance=tuple(nuisance),
        options=_options(frequency, reference, size, "m" if is_length else "rad"),
        block=spread_blocks(time_s, seconds, run.astype(np.int64)),
        step_s=period_s / STEPS_PER_PERIOD,
        noise=noise,
        is_linear=is_length,
    )


def _options(frequency: float, reference: float, size: float, unit: str) -> tuple[Option, ...]:
    """Viscous: c theta'; Coulomb: f sign(theta'); air: q |theta'| theta'; the library's first two names."""
    decay = frequency / (2.0 * math.pi)
    strong = frequency**2 * size
    options = [
        Option(
            "passive_viscous_friction",
            "passive_viscous_friction",
            (
                FreeParameter(
                    "extra_viscous_per_s",
                    "1/s",
                    1e-4 * decay,
                    5.0 * decay,
                    (0.01 * decay, 0.2 * decay),
                ),
            ),
        ),
        Option(
            "passive_coulomb_friction",
            "passive_coulomb_friction",
            (
                FreeParameter(
                    "extra_coulomb_rad_per_s2",
                    f"{unit}/s2",
                    1e-5 * strong,
                    0.3 * strong,
                    (1e-3 * strong, 0.02 * strong),
                ),
            ),
        ),
        Option(
            "air_drag",
            "air_drag",
            (FreeParameter("quadratic_per_rad", f"1/{unit}", 1e-4, 3.0 / size, (0.01, 0.1)),),
        ),
    ]
    if math.isfinite(reference):
        longer = FreeParameter(
            "extra_length_ratio", "1", -0.7, 2.0, ((reference / frequency) ** 2 - 1.0, 0.05)
        )
        options.append(Option("gripper_length", "gripper_length", (longer,)))
        stiff = FreeParameter(
            "stiffness_per_s2",
            "1/s2",
            1e-3 * frequency**2,
            3.0 * frequency**2,
            (0.05 * frequency**2,),
        )
        options.append(Option("hose_stiffness", "hose_stiffness", (stiff,)))
    return tuple(options)


def _pull(values: Mapping[str, Array], is_linear: bool) -> Pull:
    """What acts on each particle, from its parameters by name."""
    square = values["frequency_rad_per_s"] ** 2
    return Pull(
        square / (1.0 + values.get("gripper_length.extra_length_ratio", np.zeros_like(square))),
        values["rest_rad"],
        values.get("hose_stiffness.stiffness_per_s2"),
        values.get("passive_viscous_friction.extra_viscous_per_s"),
        values.get("passive_coulomb_friction.extra_coulomb_rad_per_s2"),
        values.get("air_drag.quadratic_per_rad"),
        is_linear,
    )


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
