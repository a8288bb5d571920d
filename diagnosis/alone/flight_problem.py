"""Flights of one tracked ball as a problem to fit: the ideal ball falls freely."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from diagnosis.alone.held_out import every_third
from diagnosis.alone.physics.flight_path import integrate, sampled
from diagnosis.alone.problem import FreeParameter, Option
from diagnosis.alone.reading.tracks import (
    SCALE_SLACK_RATIO,
    Flight,
    fastest,
    first_motion,
    track_noise,
)
from machine.conventions import GRAVITY_M_PER_S2, Array, BoolArray, IntArray

AIR_DENSITY_KG_PER_M3: Final = 1.204
"""20 C at sea level."""
LEAN_RAD: Final = 0.02
"""Of the vertical, by eye: a camera on a tripod is set up to half a degree, by hand to one."""
STEPS_COUNT: Final = 200
FINEST_STEP_S: Final = 0.002
BLOCKS_PER_FLIGHT: Final = 5


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

    @property
    def horizons(self) -> tuple[Array, ...]:
        """None: no motion runs away from its guess."""
        return ()

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
