"""One joint's record as residuals on an even grid: what the search for its effects is given.

Samples in holes of the record and at end stops are left out; nothing else is.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import numpy as np

from diagnosis.alone.held_out import every_third, spread_blocks
from diagnosis.alone.physics.response import (
    actuation_options,
    play,
    simulate_position,
    simulate_speed,
)
from diagnosis.alone.problem import FreeParameter, Option
from diagnosis.alone.reading.commands import Command
from diagnosis.alone.reading.end_stops import find_end_stops
from diagnosis.alone.reading.layout import RefusedTableError
from diagnosis.alone.reading.motion import Motion
from diagnosis.alone.reading.slopes import sample_noise, speed_window
from machine.conventions import Array, BoolArray, IntArray

Kind = Literal["speed", "position"]
MAX_TICKS: Final = 5_000
MAX_SAMPLES: Final = 2_000
FINEST_TICK_S: Final = 0.005
COARSEST_TICK_S: Final = 0.02
BLOCKS_COUNT: Final = 15
MIN_SAMPLES: Final = 30
SMOOTH_PERIODS: Final = 5
"""Sample periods over which a median takes the noise off a position at an end stop."""


@dataclass(frozen=True, slots=True)
class ActuationProblem:
    """Residuals of a joint's speed on an even grid; see `fit.Problem`."""

    command: Array
    """(ticks,) -1..1, rest at 0."""
    measured: Array
    """(samples,) speed seen through the window, or position for a position command."""
    sample: IntArray
    """(samples,) the tick of each residual."""
    window: Array
    """Kernel that turns positions into speeds; empty when the output is used as it is."""
    step_s: float
    kind: Kind
    nuisance: tuple[FreeParameter, ...]
    options: tuple[Option, ...]
    block: IntArray
    noise: float
    command_period_s: float
    """A command changed at some time within as much before it was logged."""
    notes: tuple[str, ...]
    """What was left out."""

    @property
    def rich(self) -> tuple[str, ...]:
        """What every hydraulic joint has some of."""
        return (
            "valve_dead_time",
            "valve_lag_two_sided",
            "valve_dead_band_even",
            "speed_limit",
            "acceleration_limit",
        )

    @property
    def held(self) -> BoolArray:
        """Every third piece of the record."""
        return every_third(self.block)

    @property
    def timing_s(self) -> float:
        """A command changed within half a period of its log about the mean; no average helps."""
        return 0.5 * self.command_period_s

    @property
    def accuracy_ratio(self) -> float:
        """Of ticks and of a command known to half a period: what plants without noise came back to."""
        return 0.01

    @property
    def local(self) -> frozenset[str]:
        """None: the record is one run."""
        return frozenset()

    @property
    def horizons(self) -> tuple[Array, ...]:
        """None: no motion runs away from its guess."""
        return ()

    def guess(self, names: Sequence[str]) -> Mapping[str, float]:
        """None: the starts are enough."""
        return {}

    def residuals(self, values: Sequence[Mapping[str, float]]) -> Array:
        """(sets, samples) measured minus simulated."""
        return np.stack([self.measured - self.simulate(one)[self.sample] for one in values])

    def simulate(self, values: Mapping[str, float]) -> Array:
        """(ticks,) the output as the same window would see it."""
        gap = values.get("backlash.gap_rad_m", 0.0)
        if self.kind == "position" or self.window.size == 0:
            output = simulate_speed(self.command, self.step_s, values) + values["offset"]
            return play(output, 0.5 * gap) if gap > 0.0 else output
        position = simulate_position(self.command, self.step_s, values)
        if gap > 0.0:
            position = play(position, 0.5 * gap)
        return np.convolve(np.pad(position, len(self.window) // 2, "edge"), self.window, "valid")


def make_problem(motion: Motion, read: Command, kind: Kind, period_s: float) -> ActuationProblem:
    """Put a joint's record on an even grid."""
    time_s = motion.time_s - motion.time_s[0]
    span_s = float(time_s[-1])
    step_s = period_s / max(1, math.ceil(period_s / COARSEST_TICK_S))
    step_s = max(step_s, FINEST_TICK_S, span_s / MAX_TICKS)
    grid_s = np.arange(0.0, span_s, step_s)
    command = read.on_grid(motion, grid_s)
    output = np.interp(grid_s, time_s, motion.output)
    use_window = kind == "speed" and not motion.is_speed
    window = np.array([])
    raw_noise = sample_noise(motion.output)
    noise = raw_noise
    measured = output
    if use_window:
        window, noise = speed_window(output, raw_noise, step_s, period_s)
        measured = np.convolve(np.pad(output, len(window) // 2, "edge"), window, "valid")
    edge = len(window) // 2 + 1
    stride = max(1, round(max(period_s, len(grid_s) * step_s / MAX_SAMPLES) / step_s))
    sample = np.arange(edge, len(grid_s) - edge, stride)
    sample = sample[_is_seen(time_s, grid_s, max(5.0 * period_s, 0.1), len(window) // 2)[sample]]
    notes: tuple[str, ...] = ()
    if use_window:
        smooth_ticks = round(SMOOTH_PERIODS * period_s / step_s)
        free = _FreeMotion(command, output, measured, raw_noise, step_s, smooth_ticks)
        sample, notes = _without_stops(free, sample, len(window) // 2, motion.unit)
    if sample.size < MIN_SAMPLES:
        raise RefusedTableError(
            f"{sample.size} usable samples are left, at least {MIN_SAMPLES} are needed"
            + "".join(f" ({note})" for note in notes)
        )
    top = float(np.quantile(np.abs(measured[sample]), 0.99))
    blocks = max(span_s / BLOCKS_COUNT, 1.0)
    run = np.zeros(len(sample), dtype=np.int64)
    centre = float(np.median(measured[sample])) if kind == "position" else 0.0
    slack = float(np.ptp(motion.output)) if kind == "position" else 0.1 * top
    gain = _first_gain(command, measured - centre, sample, top)
    return ActuationProblem(
        command=command,
        measured=measured[sample],
        sample=sample,
        window=window,
        step_s=step_s,
        kind=kind,
        nuisance=(
            FreeParameter("speed_per_command", motion.unit, -20.0 * top, 20.0 * top, (gain,)),
            FreeParameter("offset", motion.unit, centre - slack, centre + slack, (centre,)),
        ),
        options=actuation_options(
            period_s,
            span_s,
            top,
            0.0 if motion.is_speed else float(np.ptp(motion.output)),
            motion.unit,
            not motion.is_speed,
            is_speed=kind == "speed",
        ),
        block=spread_blocks(grid_s[sample], blocks, run),
        noise=noise,
        command_period_s=read.period_s,
        notes=notes,
    )


class _FreeMotion(NamedTuple):
    """A joint on the grid, (ticks,) each, as end stops are looked for."""

    command: Array
    position: Array
    speed: Array
    noise: float
    """Of one position."""
    step_s: float
    smooth_ticks: int


def _without_stops(
    free: _FreeMotion, sample: IntArray, margin: int, unit: str
) -> tuple[IntArray, tuple[str, ...]]:
    """Samples at which the joint sits at no end stop, `margin` ticks to either side, and a note."""
    top = float(np.quantile(np.abs(free.speed), 0.99))
    push = math.copysign(1.0, _first_gain(free.command, free.speed, sample, top)) * free.command
    stops = find_end_stops(
        free.position, free.speed, push, free.noise, free.step_s, free.smooth_ticks
    )
    near = np.convolve(stops.is_held, np.ones(2 * margin + 1), "same") > 0.5
    kept = sample[~near[sample]]
    if kept.size == sample.size:
        return sample, ()
    places = " and ".join(f"{place:.3g}" for place in stops.places)
    left = sample.size - kept.size
    return kept, (
        f"{left} of {sample.size} samples ({left / sample.size:.0%}) left out: the position sits at an end "
        f"of its range ({places} {unit}) while commanded further, as at an end stop",
    )


def _is_seen(time_s: Array, grid_s: Array, longest_s: float, margin: int) -> BoolArray:
    """(ticks,) whether a grid point, and `margin` ticks to either side, lie in no hole of the record."""
    after = np.clip(np.searchsorted(time_s, grid_s), 1, len(time_s) - 1)
    hole = (time_s[after] - time_s[after - 1] >= longest_s).astype(np.int64)
    return np.convolve(hole, np.ones(2 * margin + 1, dtype=np.int64), "same") == 0


def _first_gain(command: Array, measured: Array, sample: IntArray, top: float) -> float:
    """Least-squares gain with the best of a few delays, so that the sign is right from the start."""
    best, best_gain = 0.0, top
    for ticks in np.unique(np.geomspace(1, max(len(command) // 10, 2), 12).astype(int)):
        u = np.concatenate([np.full(ticks, command[0]), command[:-ticks]])[sample]
        product, power = float(np.dot(u, measured[sample])), float(np.dot(u, u))
        if power > 0.0 and product**2 / power > best:
            best, best_gain = product**2 / power, product / power
    return best_gain
