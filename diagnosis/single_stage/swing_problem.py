"""Free swings of one body as a fit problem: simulation, parameters, and start values of the frictions.

The ideal body swings without loss. Coulomb friction is integrated exactly: a step in which the body comes
to rest is split there. A smoothed sign, or a step across that point, loses up to 3 % of the friction at 24
steps per period.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.optimize import nnls

from diagnosis.single_stage.fit_problem import (
    EffectOption,
    FreeParameter,
    mask_every_third_block,
    number_blocks,
)
from diagnosis.tables.cells import RefusedTableError
from diagnosis.tables.free_swings import SwingRecord, estimate_period, find_half_periods
from machine.conventions import GRAVITY_M_PER_S2, Array, BoolArray, IntArray

Acceleration = Callable[[Array, Array, Array], Array]
"""Acceleration of deflection, rate and direction of friction, (particles,) each."""
STEPS_PER_PERIOD: Final = 40
"""Integration steps per period; the relative error of the amplitude per radian is (2 pi / n)^5 / 144."""
LARGE_AMPLITUDE_RAD: Final = 1.0
"""Amplitude from which steps are half as long and the record is fitted from its start in growing parts."""
HORIZON_RATIOS: Final = (0.125, 0.25, 0.5)
"""Lengths of these parts, as shares of the record."""
MIN_SAMPLES_PER_PERIOD: Final = 6.0
"""Fewest samples per period."""
MIN_AMPLITUDES_COUNT: Final = 4
"""Fewest amplitudes of a swing from which frictions are estimated."""
VISCOUS_PARAMETER: Final = "passive_viscous_friction.extra_viscous_per_s"
COULOMB_PARAMETER: Final = "passive_coulomb_friction.extra_coulomb_rad_per_s2"
AIR_PARAMETER: Final = "air_drag.quadratic_per_rad"


@dataclass(frozen=True, slots=True)
class SwingDynamics:
    """Dynamics of each particle, (particles,) each, or None; deflections in rad, or in m on a spring.

    x'' = -w^2 sin(x - rest) - s (x - rest) - c x' - f sign(x') - q |x'| x'; on a spring the sine is x - rest.
    """

    square_per_s2: Array
    """w^2"""
    rest: Array
    stiffness_per_s2: Array | None
    """s"""
    viscous_per_s: Array | None
    """c"""
    coulomb: Array | None
    """f, unit of the deflection/s^2"""
    quadratic: Array | None
    """q, 1/unit of the deflection"""
    is_linear: bool = False

    def restoring(self, x: Array) -> Array:
        """Acceleration towards rest, without losses."""
        away = x - self.rest
        found = -self.square_per_s2 * (away if self.is_linear else np.sin(away))
        if self.stiffness_per_s2 is not None:
            found -= self.stiffness_per_s2 * away
        return found

    def acceleration(self, x: Array, v: Array, direction: Array) -> Array:
        """Total acceleration; `direction` is 1 or -1, 0 where friction holds."""
        found = self.restoring(x)
        if self.viscous_per_s is not None:
            found -= self.viscous_per_s * v
        if self.coulomb is not None:
            found -= self.coulomb * direction
        if self.quadratic is not None:
            found -= self.quadratic * np.abs(v) * v
        return found

    def direction(self, x: Array, v: Array) -> Array:
        """Direction of motion, or of the restoring force at rest; 0 where friction holds the particle."""
        if np.all(v != 0.0):
            return np.sign(v)
        pull = self.restoring(x)
        held = np.abs(pull) <= (0.0 if self.coulomb is None else self.coulomb)
        return np.where(v != 0.0, np.sign(v), np.where(held, 0.0, np.sign(pull)))

    def subset(self, chosen: BoolArray) -> "SwingDynamics":
        """Dynamics of some of the particles."""
        return SwingDynamics(
            self.square_per_s2[chosen],
            self.rest[chosen],
            *(
                None if part is None else part[chosen]
                for part in (
                    self.stiffness_per_s2,
                    self.viscous_per_s,
                    self.coulomb,
                    self.quadratic,
                )
            ),
            is_linear=self.is_linear,
        )


def simulate_swings(
    dynamics: SwingDynamics, start: Array, rate: Array, grid_s: Array
) -> tuple[Array, Array]:
    """Deflections and rates on an even grid that begins at 0, (steps, particles) each.

    Args:
        dynamics: dynamics of each particle.
        start: (particles,) deflection at 0 s.
        rate: (particles,) its rate there.
        grid_s: (steps,) times.
    """
    xs, vs = np.empty((len(grid_s), len(start))), np.empty((len(grid_s), len(start)))
    x, v, step_s = start, rate, np.full(len(start), grid_s[1])
    has_dry_friction = (
        np.zeros(len(start), bool) if dynamics.coulomb is None else dynamics.coulomb > 0.0
    )
    any_dry_friction = bool(np.any(has_dry_friction))
    accelerate, no_direction = dynamics.acceleration, np.zeros_like(start)
    for index in range(len(grid_s)):
        xs[index], vs[index] = x, v
        direction = dynamics.direction(x, v) if any_dry_friction else no_direction
        moved_x, moved_v = _step(accelerate, x, v, direction, step_s)
        if any_dry_friction:
            turned = has_dry_friction & (direction * moved_v <= 0.0)
            if np.any(turned):
                moved_x[turned], moved_v[turned] = _step_across_rest(
                    dynamics.subset(turned), x[turned], v[turned], direction[turned], step_s[turned]
                )
        x, v = moved_x, moved_v
    return xs, vs


def _step_across_rest(
    dynamics: SwingDynamics, x: Array, v: Array, direction: Array, step_s: Array
) -> tuple[Array, Array]:
    """One step in which each particle comes to rest: until then, and from there on back or held."""
    accelerate = dynamics.acceleration
    until_s = np.clip(_time_to_rest(accelerate, x, v, direction), 0.0, step_s)
    # One Newton iteration for the time at which the rate is 0, where it is nearly linear.
    near_x, near_v = _step(accelerate, x, v, direction, until_s)
    until_s = np.clip(until_s + _time_to_rest(accelerate, near_x, near_v, direction), 0.0, step_s)
    turned_x, _ = _step(accelerate, x, v, direction, until_s)
    nothing = np.zeros_like(x)
    back = dynamics.direction(turned_x, nothing)
    moved_x, moved_v = _step(accelerate, turned_x, nothing, back, step_s - until_s)
    return np.where(back == 0.0, turned_x, moved_x), np.where(back == 0.0, 0.0, moved_v)


def _time_to_rest(accelerate: Acceleration, x: Array, v: Array, direction: Array) -> Array:
    """Time in s until the rate is 0 at constant acceleration; 0 without acceleration."""
    slowed = accelerate(x, v, direction)
    return np.divide(-v, slowed, out=np.zeros_like(v), where=slowed != 0.0)


def _step(
    accelerate: Acceleration, x: Array, v: Array, direction: Array, h: Array
) -> tuple[Array, Array]:
    """One step of the classical Runge-Kutta method, h (particles,) in s."""
    half, sixth = 0.5 * h, h / 6.0
    a1 = accelerate(x, v, direction)
    v2 = v + half * a1
    a2 = accelerate(x + half * v, v2, direction)
    v3 = v + half * a2
    a3 = accelerate(x + half * v2, v3, direction)
    v4 = v + h * a3
    a4 = accelerate(x + h * v3, v4, direction)
    return (
        x + sixth * (v + 2.0 * (v2 + v3) + v4),
        v + sixth * (a1 + 2.0 * (a2 + a3) + a4),
    )


@dataclass(frozen=True, slots=True)
class SwingProblem:
    """Residuals of all swings; see `FitProblem`."""

    swings: tuple[SwingRecord, ...]
    nuisance: tuple[FreeParameter, ...]
    options: tuple[EffectOption, ...]
    block: IntArray
    step_s: float
    noise: float
    """Standard deviation of one sample, rad, or m on a spring."""
    is_linear: bool = False
    """Whether the restoring force is proportional to the deflection (spring, torsion wire)."""

    @property
    def full_structure(self) -> tuple[str, ...]:
        """Empty: the beam search suffices."""
        return ()

    @property
    def held_out_mask(self) -> BoolArray:
        """Every third block."""
        return mask_every_third_block(self.block)

    @property
    def timestamp_error_s(self) -> float:
        """0: there is no command."""
        return 0.0

    @property
    def simulation_error_ratio(self) -> float:
        """Integration error at large amplitudes."""
        return 0.001

    @property
    def run_nuisance(self) -> frozenset[str]:
        """Empty: any block determines the initial state of a swing."""
        return frozenset()

    @property
    def prefix_weights(self) -> tuple[Array, ...]:
        """Growing parts of a swing with a large amplitude, whose period depends on it."""
        if not _is_large_amplitude(self.swings, self.is_linear):
            return ()
        share = np.concatenate([swing.time_s / swing.time_s[-1] for swing in self.swings])
        return tuple((share <= part).astype(np.float64) for part in HORIZON_RATIOS)

    def initial_guess(self, names: Sequence[str]) -> Mapping[str, float]:
        """Frictions from the decay of the amplitude."""
        first = self.nuisance[0].starts[0]
        return estimate_frictions_from_decay(self.swings, self.noise, first, names)

    def residuals(self, values: Sequence[Mapping[str, float]]) -> Array:
        """(sets, samples) measured minus simulated, rad or m."""
        measured = np.concatenate([swing.angle_rad for swing in self.swings])
        return measured - np.concatenate(self.simulate(values), axis=1)

    def simulate(self, values: Sequence[Mapping[str, float]]) -> list[Array]:
        """Angles at each swing's sample times, (sets, rows) per swing."""
        count, sets = len(self.swings), len(values)
        last = max(float(swing.time_s[-1]) for swing in self.swings)
        grid_s = np.arange(0.0, last + 2.0 * self.step_s, self.step_s)
        start = np.array([[one[f"angle.{k}"] for k in range(count)] for one in values]).ravel()
        rate = np.array([[one[f"rate.{k}"] for k in range(count)] for one in values]).ravel()
        shared = {name: np.repeat([one[name] for one in values], count) for name in values[0]}
        angle, speed = simulate_swings(_make_dynamics(shared, self.is_linear), start, rate, grid_s)
        shape = (len(grid_s), sets, count)
        angle, speed = angle.reshape(shape), speed.reshape(shape) * grid_s[1]
        return [
            _interpolate_hermite(angle[:, :, k], speed[:, :, k], swing.time_s / grid_s[1])
            for k, swing in enumerate(self.swings)
        ]


def _interpolate_hermite(angle: Array, change: Array, place: Array) -> Array:
    """Cubic Hermite interpolation at fractional steps `place` (rows,) with slopes `change`; (sets, rows)."""
    index = np.minimum(place.astype(np.int64), len(angle) - 2)
    s = (place - index)[:, None]
    a0, a1, d0, d1 = angle[index], angle[index + 1], change[index], change[index + 1]
    rise = a1 - a0
    return (a0 + s * d0 + s * s * (3.0 * rise - 2.0 * d0 - d1) + s**3 * (d0 + d1 - 2.0 * rise)).T


def make_swing_problem(
    swings: tuple[SwingRecord, ...], length_m: float, noise: float, is_length: bool = False
) -> SwingProblem:
    """Parameters and blocks of free swings.

    Args:
        swings: the swings.
        length_m: length of the ideal pendulum; nan if its frequency is fitted.
        noise: standard deviation of one sample, rad or m.
        is_length: whether deflections are in m (mass on a spring).

    Raises:
        RefusedTableError: too few samples per period.
    """
    period_s = float(np.median([estimate_period(swing, noise) for swing in swings]))
    sampled_s = float(np.median([np.median(np.diff(swing.time_s)) for swing in swings]))
    if period_s < MIN_SAMPLES_PER_PERIOD * sampled_s:
        raise RefusedTableError(
            f"{period_s / sampled_s:.2g} samples a period of {period_s:.2g} s, at least "
            f"{MIN_SAMPLES_PER_PERIOD:g} are needed: record faster"
        )
    frequency = 2.0 * math.pi / period_s
    reference = math.sqrt(GRAVITY_M_PER_S2 / length_m) if math.isfinite(length_m) else math.nan
    # A reference length fixes the ideal frequency; a deviation is due to length or stiffness.
    tolerance, first = (1e-5, reference) if math.isfinite(reference) else (0.3, frequency)
    nuisance = [
        FreeParameter(
            "frequency_rad_per_s",
            "rad/s",
            first * (1 - tolerance),
            first * (1 + tolerance),
            (first,),
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
        options=_list_options(frequency, reference, size, "m" if is_length else "rad"),
        block=number_blocks(time_s, seconds, run.astype(np.int64)),
        step_s=period_s
        / STEPS_PER_PERIOD
        / (2.0 if _is_large_amplitude(swings, is_length) else 1.0),
        noise=noise,
        is_linear=is_length,
    )


def _is_large_amplitude(swings: Sequence[SwingRecord], is_linear: bool) -> bool:
    """Whether a pendulum's amplitude is large enough to change its period noticeably."""
    return (
        not is_linear
        and max(float(np.max(np.abs(s.angle_rad))) for s in swings) > LARGE_AMPLITUDE_RAD
    )


def _list_options(
    frequency: float, reference: float, size: float, unit: str
) -> tuple[EffectOption, ...]:
    """Viscous friction c theta', Coulomb friction f sign(theta'), air drag q |theta'| theta'.

    With a reference length also a longer pendulum and a parallel stiffness.
    """
    decay = frequency / (2.0 * math.pi)
    restoring_per_s2 = frequency**2 * size
    options = [
        EffectOption(
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
        EffectOption(
            "passive_coulomb_friction",
            "passive_coulomb_friction",
            (
                FreeParameter(
                    "extra_coulomb_rad_per_s2",
                    f"{unit}/s2",
                    1e-5 * restoring_per_s2,
                    0.3 * restoring_per_s2,
                    (1e-3 * restoring_per_s2, 0.02 * restoring_per_s2),
                ),
            ),
        ),
        EffectOption(
            "air_drag",
            "air_drag",
            (FreeParameter("quadratic_per_rad", f"1/{unit}", 1e-4, 3.0 / size, (0.01, 0.1)),),
        ),
    ]
    if math.isfinite(reference):
        longer = FreeParameter(
            "extra_length_ratio", "1", -0.7, 2.0, ((reference / frequency) ** 2 - 1.0, 0.05)
        )
        options.append(EffectOption("gripper_length", "gripper_length", (longer,)))
        stiff = FreeParameter(
            "stiffness_per_s2",
            "1/s2",
            1e-3 * frequency**2,
            3.0 * frequency**2,
            (0.05 * frequency**2,),
        )
        options.append(EffectOption("hose_stiffness", "hose_stiffness", (stiff,)))
    return tuple(options)


def _make_dynamics(values: Mapping[str, Array], is_linear: bool) -> SwingDynamics:
    """Dynamics of each particle from its parameters by name."""
    square = values["frequency_rad_per_s"] ** 2
    return SwingDynamics(
        square / (1.0 + values.get("gripper_length.extra_length_ratio", np.zeros_like(square))),
        values["rest_rad"],
        values.get("hose_stiffness.stiffness_per_s2"),
        values.get("passive_viscous_friction.extra_viscous_per_s"),
        values.get("passive_coulomb_friction.extra_coulomb_rad_per_s2"),
        values.get("air_drag.quadratic_per_rad"),
        is_linear,
    )


def estimate_frictions_from_decay(
    swings: Sequence[SwingRecord], noise: float, frequency: float, names: Sequence[str]
) -> Mapping[str, float]:
    """Frictions among `names`, by parameter, from the decay of the amplitude of all swings; may be empty.

    A least-squares fit of the angles does not pass the point where dry friction stops the body, because its
    rest angle jumps there by up to 2 f / w^2. The amplitudes have no such jump, so they give start values.

    Averaged over a period of small swings, A' = -c A / 2 - 2 f / (pi w) - 4 q w A^2 / (3 pi) (Krylov and
    Bogoliubov). Its time integral is linear in c, f and q, which are not negative.

    Args:
        swings: free, about their rest angle.
        noise: standard deviation of one sample, rad or m.
        frequency: w, rad/s.
        names: parameters of a structure.
    """
    fitted_names = [
        name for name in (VISCOUS_PARAMETER, COULOMB_PARAMETER, AIR_PARAMETER) if name in names
    ]
    if not fitted_names:
        return {}
    amplitude_columns: list[Array] = []
    losses: list[Array] = []
    for swing in swings:
        time_s, size = measure_amplitudes(swing, noise)
        if len(size) < MIN_AMPLITUDES_COUNT:
            continue
        columns = {
            VISCOUS_PARAMETER: 0.5 * cumulative_trapezoid(size, time_s, initial=0.0),
            COULOMB_PARAMETER: 2.0 / (math.pi * frequency) * (time_s - time_s[0]),
            AIR_PARAMETER: 4.0
            * frequency
            / (3.0 * math.pi)
            * cumulative_trapezoid(size**2, time_s, initial=0.0),
        }
        losses.append(np.stack([columns[name] for name in fitted_names], axis=1))
        amplitude_columns.append(size)
    if not amplitude_columns:
        return {}
    # The first amplitude of each swing is one more unknown.
    first = [np.zeros((len(size), len(amplitude_columns))) for size in amplitude_columns]
    for k, column in enumerate(first):
        column[:, k] = 1.0
    matrix = np.concatenate([np.hstack([f, -one]) for f, one in zip(first, losses, strict=True)])
    found, _ = nnls(matrix, np.concatenate(amplitude_columns))
    return dict(zip(fitted_names, found[len(amplitude_columns) :].tolist(), strict=True))


def measure_amplitudes(swing: SwingRecord, noise: float) -> tuple[Array, Array]:
    """Middle of each whole period, s, and sqrt(2) times the scatter of the angle in it above the noise."""
    crossed = find_half_periods(swing.angle_rad, noise)
    pairs = list(zip(crossed[:-2], crossed[2:], strict=True))
    square = np.array([np.var(swing.angle_rad[i:j]) for i, j in pairs]) - noise**2
    time_s = np.array([0.5 * (swing.time_s[i] + swing.time_s[j]) for i, j in pairs])
    return time_s, np.sqrt(2.0 * np.maximum(square, 0.0))
