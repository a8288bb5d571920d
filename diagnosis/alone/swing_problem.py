"""Free swings of one hanging body as a problem to fit: the ideal body swings without loss."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from diagnosis.alone.held_out import every_third, spread_blocks
from diagnosis.alone.physics.free_motion import Pull, move
from diagnosis.alone.problem import FreeParameter, Option
from diagnosis.alone.reading.decay import frictions_of_decay
from diagnosis.alone.reading.free_swings import Swing, swing_period
from diagnosis.alone.reading.layout import RefusedTableError
from machine.conventions import GRAVITY_M_PER_S2, Array, BoolArray, IntArray

STEPS_PER_PERIOD: Final = 40
"""The Runge-Kutta method takes (2 pi / n)^5 / 144 of the amplitude a radian, here 1e-6; 24 steps
took 0.6 % of a weak friction at 50 degrees."""
WIDE_RAD: Final = 1.0
"""From which angle on a swing is fitted piece by piece, in steps half as long: from 120 degrees on the search
over all of it ended with 2 to 20 % of the motion left; from 150, 40 steps a period were 0.01 rad off."""
HORIZON_RATIOS: Final = (0.125, 0.25, 0.5)
MIN_SAMPLES_PER_PERIOD: Final = 6.0


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

    @property
    def horizons(self) -> tuple[Array, ...]:
        """An eighth, a quarter and half of a wide swing: its period tells how far it swings."""
        if not _is_wide(self.swings, self.is_linear):
            return ()
        share = np.concatenate([swing.time_s / swing.time_s[-1] for swing in self.swings])
        return tuple((share <= part).astype(np.float64) for part in HORIZON_RATIOS)

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
        step_s=period_s / STEPS_PER_PERIOD / (2.0 if _is_wide(swings, is_length) else 1.0),
        noise=noise,
        is_linear=is_length,
    )


def _is_wide(swings: Sequence[Swing], is_linear: bool) -> bool:
    """Whether a pendulum swings so far that its period shows how far."""
    return not is_linear and max(float(np.max(np.abs(s.angle_rad))) for s in swings) > WIDE_RAD


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
