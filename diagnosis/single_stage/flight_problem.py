"""Flights of one tracked ball as a fit problem: simulation and parameters.

The ideal ball falls freely. Gravity, drag, wind and lift act on it. Axes are x, y, z (z up) or fewer. A
tilted vertical and a wrong length scale are part of the simulation.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from diagnosis.single_stage.fit_problem import EffectOption, FreeParameter, mask_every_third_block
from diagnosis.tables.tracks import (
    SCALE_TOLERANCE_RATIO,
    FlightRecord,
    estimate_initial_state,
    estimate_top_speed,
    estimate_track_noise,
)
from machine.conventions import GRAVITY_M_PER_S2, Array, BoolArray, IntArray

MAX_DRAG_COEFFICIENT: Final = 1.6
"""Largest drag coefficient; an open hemisphere has 1.42 (Hoerner, Fluid-Dynamic Drag, 1965)."""
AIR_DENSITY_KG_PER_M3: Final = 1.204
"""At 20 C and sea level."""
MAX_TILT_RAD: Final = 0.02
"""Largest tilt of the camera's vertical, rad; about 1.1 degrees."""
MAX_STEPS_COUNT: Final = 200
"""Integration steps of the longest flight."""
MIN_STEP_S: Final = 0.002
"""Shortest integration step, s."""
BLOCKS_PER_FLIGHT: Final = 5
"""Blocks per flight."""
CRISIS_WIDTH_M_PER_S: Final = 1.5
"""Width of the transition; a sphere's drag falls within a sixth of its critical speed (Achenbach 1972)."""
MAX_CHANGE_PER_STEP: Final = 0.5
"""Largest relative change of the velocity per step by drag or lift; keeps the integration stable in a fit."""


class BallProperties(NamedTuple):
    """Mass and diameter of the ball; nan where unknown."""

    mass_kg: float = math.nan
    diameter_m: float = math.nan

    @property
    def drag_per_m(self) -> float:
        """Deceleration over speed squared at a drag coefficient of 1, 1/m."""
        area = 0.25 * math.pi * self.diameter_m**2
        return 0.5 * AIR_DENSITY_KG_PER_M3 * area / self.mass_kg


@dataclass(frozen=True, slots=True)
class FlightProblem:
    """Residuals of all flights of one ball; see `FitProblem`."""

    flights: tuple[FlightRecord, ...]
    nuisance: tuple[FreeParameter, ...]
    options: tuple[EffectOption, ...]
    block: IntArray
    noise: float
    """Standard deviation of one coordinate, m."""
    drag_per_m: float
    """Deceleration over speed squared at a drag coefficient of 1, 1/m; 1 if the ball is unknown."""

    @property
    def full_structure(self) -> tuple[str, ...]:
        """Empty: the beam search suffices."""
        return ()

    @property
    def held_out_mask(self) -> BoolArray:
        """Every second flight; every third block of a single flight."""
        if len(self.flights) == 1:
            return mask_every_third_block(self.block)
        return (self.block // BLOCKS_PER_FLIGHT) % 2 == 1

    @property
    def timestamp_error_s(self) -> float:
        """0: there is no command."""
        return 0.0

    @property
    def simulation_error_ratio(self) -> float:
        """Error of Heun steps and interpolated positions."""
        return 0.001

    @property
    def run_nuisance(self) -> frozenset[str]:
        """Initial position and velocity of each flight."""
        return frozenset(p.name for p in self.nuisance if "." in p.name)

    @property
    def prefix_weights(self) -> tuple[Array, ...]:
        """Empty: the simulated motion does not diverge."""
        return ()

    def initial_guess(self, names: Sequence[str]) -> Mapping[str, float]:
        """Empty: the start values suffice."""
        return {}

    def residuals(self, values: Sequence[Mapping[str, float]]) -> Array:
        """(sets, samples) measured minus simulated, flights and axes one after the other, m."""
        measured = np.concatenate([flight.position_m.ravel(order="F") for flight in self.flights])
        tracks = self.simulate(values)
        return measured - np.concatenate(
            [track.transpose(0, 2, 1).reshape(len(values), -1) for track in tracks], axis=1
        )

    def simulate(self, values: Sequence[Mapping[str, float]]) -> list[Array]:
        """Positions at each flight's sample times, (sets, rows, axes) per flight."""
        axes = self.flights[0].position_m.shape[1]
        count, sets = len(self.flights), len(values)

        def initial_values(letter: str) -> Array:
            return np.array(
                [
                    [[one[f"{letter}{axis}.{k}"] for axis in range(axes)] for k in range(count)]
                    for one in values
                ]
            )

        last = max(float(flight.time_s[-1]) for flight in self.flights)
        step_s = max(last / MAX_STEPS_COUNT, MIN_STEP_S)
        grid_s = np.arange(0.0, last + 2.0 * step_s, step_s)
        # (steps, sets * flights, axes): each flight of each parameter set is one particle.
        path = integrate_path(
            initial_values("p").reshape(-1, axes),
            initial_values("v").reshape(-1, axes),
            grid_s,
            {name: np.repeat([one[name] for one in values], count)[:, None] for name in values[0]},
            self.drag_per_m,
        ).reshape(len(grid_s), sets, count, axes)
        delay_s = np.array([one.get("release_delay.extra_delay_s", 0.0) for one in values])
        return [
            interpolate_path(
                path[:, :, k], grid_s[1], np.maximum(flight.time_s - delay_s[:, None], 0.0)
            )
            for k, flight in enumerate(self.flights)
        ]


def make_flight_problem(
    flights: tuple[FlightRecord, ...],
    ball: BallProperties,
    scale_tolerance_ratio: float = SCALE_TOLERANCE_RATIO,
) -> FlightProblem:
    """Parameters and blocks of one ball's flights.

    Args:
        flights: the flights.
        ball: mass and diameter.
        scale_tolerance_ratio: allowed error of the length scale.
    """
    axes = flights[0].position_m.shape[1]
    gravity_tolerance = scale_tolerance_ratio * GRAVITY_M_PER_S2
    nuisance = [
        FreeParameter(
            "gravity",
            "m/s2",
            GRAVITY_M_PER_S2 - gravity_tolerance,
            GRAVITY_M_PER_S2 + gravity_tolerance,
            (GRAVITY_M_PER_S2,),
            prior_sd=gravity_tolerance / math.sqrt(3.0),
        )
    ]
    nuisance += [
        FreeParameter(
            f"lean{axis}",
            "rad",
            -MAX_TILT_RAD,
            MAX_TILT_RAD,
            (0.0,),
            prior_sd=MAX_TILT_RAD / math.sqrt(3.0),
        )
        for axis in range(axes - 1)
    ]
    top = 0.0
    for k, flight in enumerate(flights):
        speed, first = estimate_initial_state(flight)
        top = max(top, estimate_top_speed(flight))
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
        options=_list_options(axes, top, period_s, known),
        block=np.concatenate(blocks),
        noise=estimate_track_noise(flights),
        drag_per_m=ball.drag_per_m if known else 1.0,
    )


def _list_options(
    axes: int, top: float, period_s: float, ball_known: bool
) -> tuple[EffectOption, ...]:
    """Effect options that tracks with this number of axes can show."""
    drag = (
        FreeParameter(
            "extra_drag_coefficient_ratio", "1", 0.02, MAX_DRAG_COEFFICIENT, (0.1, 0.5, 1.2)
        )
        if ball_known
        else FreeParameter("drag_per_m", "1/m", 2e-4, 20.0, (0.002, 0.02, 0.1, 1.0))
    )
    options = [
        EffectOption("air_drag", "air_drag", (drag,)),
        EffectOption(
            "drag_crisis",
            "drag_crisis",
            (
                FreeParameter(
                    "critical_speed_m_per_s",
                    "m/s",
                    0.3 * top,
                    0.95 * top,
                    (0.6 * top, 0.8 * top),
                    is_absent_at_low=False,
                ),
                FreeParameter(
                    "above_ratio",
                    "1",
                    0.05,
                    1.0,
                    (0.4, 0.7),
                    is_absent_at_high=True,
                    is_absent_at_low=False,
                ),
            ),
        ),
        EffectOption(
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
        options.append(EffectOption("wind", "wind", tuple(winds)))
        options.append(EffectOption("release_spin", "release_spin", tuple(spins)))
    return tuple(options)


def interpolate_path(path: Array, step_s: float, time_s: Array) -> Array:
    """Linear interpolation of paths (steps, sets, axes) at times (sets, rows); (sets, rows, axes)."""
    index = np.minimum((time_s / step_s).astype(np.int64), len(path) - 2)
    share = (time_s / step_s - index)[..., None]
    sets = np.arange(path.shape[1])[:, None]
    return path[index, sets] * (1.0 - share) + path[index + 1, sets] * share


def integrate_path(
    start: Array, speed: Array, grid_s: Array, values: Mapping[str, Array], drag_per_m: float
) -> Array:
    """Paths of particles, (steps, particles, axes), by Heun's method; `values` are (particles, 1)."""
    axes = start.shape[1]
    step_s = float(grid_s[1])
    accelerate = _make_acceleration(speed, values, drag_per_m, MAX_CHANGE_PER_STEP / step_s)
    path = np.empty((len(grid_s), axes, len(start)))
    p, v = start.T.copy(), speed.T.copy()
    for index in range(len(grid_s)):
        path[index] = p
        a = accelerate(v)
        ahead = v + step_s * a
        p = p + 0.5 * step_s * (v + ahead)
        v = v + 0.5 * step_s * (a + accelerate(ahead))
    return path.transpose(0, 2, 1)


def _make_acceleration(
    speed: Array, values: Mapping[str, Array], drag_per_m: float, max_change_per_s: float
) -> Callable[[Array], Array]:
    """Acceleration as a function of velocity, both (axes, particles).

    Args:
        speed: (particles, axes) initial velocity, which gives the axis of the spin.
        values: parameters by name, (particles, 1) each.
        drag_per_m: deceleration over speed squared at a drag coefficient of 1.
        max_change_per_s: limit of the relative change of the velocity by drag or lift.
    """
    count, axes = speed.shape

    def value(name: str) -> Array | None:
        return values[name][:, 0] if name in values else None

    # A wrong length scale s appears as gravity s g; the true motion is 1 / s of the measured one.
    fall = values["gravity"][:, 0]
    scale = fall / GRAVITY_M_PER_S2
    gravity = np.stack(
        [*(fall * values[f"lean{axis}"][:, 0] for axis in range(axes - 1)), -np.ones(count) * fall]
    )
    k = value("air_drag.extra_drag_coefficient_ratio")
    k = value("air_drag.drag_per_m") if k is None else k
    k = None if k is None else k * drag_per_m / scale
    wind = None
    if (wind_along_x := value("wind.x_m_per_s")) is not None:
        wind = np.zeros((axes, count))
        wind[0] = scale * wind_along_x
        if axes == 3:
            wind[1] = scale * values["wind.y_m_per_s"][:, 0]
    critical = value("drag_crisis.critical_speed_m_per_s")
    above = values["drag_crisis.above_ratio"][:, 0] if critical is not None else None
    spin, max_lift_speed = None, np.zeros(count)
    if (backspin := value("release_spin.backspin_lift_per_m")) is not None:
        sidespin = (
            values["release_spin.sidespin_lift_per_m"][:, 0] if axes == 3 else np.zeros(count)
        )
        spin = _spin_axes(speed, (backspin / scale)[:, None], (sidespin / scale)[:, None]).T
        max_lift_speed = max_change_per_s / np.maximum(np.hypot(backspin, sidespin) / scale, 1e-9)

    def accelerate(v: Array) -> Array:
        a = gravity
        if k is not None:
            relative = v if wind is None else v - wind
            magnitude = np.sqrt(np.einsum("ij,ij->j", relative, relative))
            drag = k * magnitude
            if critical is not None and above is not None:
                low_speed_share = 0.5 - 0.5 * np.tanh(
                    0.5 * (magnitude - critical) / CRISIS_WIDTH_M_PER_S
                )
                drag = drag * (above + (1.0 - above) * low_speed_share)
            a = a - np.minimum(drag, max_change_per_s) * relative
        if spin is None:
            return a
        # Lift depends on the ground speed: otherwise wind without drag could act through the spin.
        magnitude = np.sqrt(np.einsum("ij,ij->j", v, v))
        return a + np.minimum(magnitude, max_lift_speed) * _lift_direction(spin, v)

    return accelerate


def _spin_axes(speed: Array, backspin: Array, sidespin: Array) -> Array:
    """Spin axis times lift per metre, (flights, 3): backspin lifts, sidespin turns to the left."""
    count, axes = speed.shape
    full = np.zeros((count, 3))
    full[:, 0] = speed[:, 0]
    if axes == 3:
        full[:, 1] = speed[:, 1]
    ahead = full / np.maximum(np.linalg.norm(full, axis=1, keepdims=True), 1e-9)
    # axis x forward = up, with x forward and z up, for an axis wind_along_x -y: (y, -x, 0) of the heading.
    right = np.stack([ahead[:, 1], -ahead[:, 0], np.zeros(count)], axis=1)
    return backspin * right + sidespin * np.array([0.0, 0.0, 1.0])


def _lift_direction(axis: Array, v: Array) -> Array:
    """Magnus direction, spin axis x velocity, per unit of speed; (axes, particles)."""
    if len(v) == 2:
        return np.stack([axis[1] * v[1], -axis[1] * v[0]])
    x, y, z = v
    return np.stack(
        [axis[1] * z - axis[2] * y, axis[2] * x - axis[0] * z, axis[0] * y - axis[1] * x]
    )
