"""Diagnoses the actuation of one joint from commands and its motion alone, without a machine model.

The ideal joint moves at a speed in proportion to its command. What it does instead is explained by dead time,
lag, dead band and the other effects of response.py, or called unknown. Nothing is said about sensor
latency: with one sensor it is the same as dead time.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from scipy.signal import savgol_coeffs

from diagnosis.alone.fit import FreeParameter, Option
from diagnosis.alone.physics.response import (
    actuation_options,
    play,
    simulate_position,
    simulate_speed,
)
from diagnosis.alone.reading.commands import Command, read_command
from diagnosis.alone.reading.layout import RefusedTableError
from diagnosis.alone.reading.motion import Motion
from diagnosis.alone.selection import Selection, every_third, select, spread_blocks
from diagnosis.alone.verdict import StageNames, diagnosis_of
from diagnosis.loading.clock_audit import ClockAudit
from diagnosis.verdict import Diagnosis, Stage
from machine.conventions import Array, BoolArray, IntArray

Kind = Literal["speed", "position"]
MIN_SPAN_S: Final = 2.0
RELEVANT_RATIO: Final = 0.015
"""Of the motion, by eye: what the stepwise simulation of a joint and its log's ticks leave undecided."""
MAX_TICKS: Final = 5_000
LEAST_EXPLAINED_RATIO: Final = 0.1
"""Of the variance; by eye: five parameters read about 0.02 into noise of the shortest records."""
POSITION_RATIO: Final = 0.25
"""A position that follows its command leaves less than this unexplained; a drifting one does not follow."""
LONGEST_SPAN_S: Final = 150.0
"""A tick is then 30 ms, still less than any lag worth naming; longer records add time and little else."""
MAX_SAMPLES: Final = 2_000
FINEST_TICK_S: Final = 0.005
COARSEST_TICK_S: Final = 0.02
NOISE_RATIO: Final = 0.03
"""Of the top speed: what the window that turns positions into speeds leaves of the sensor's noise."""
LONGEST_WINDOW_S: Final = 0.4
BLOCKS_COUNT: Final = 15
_NOT_SEPARABLE: Final = [
    "dead time of the valve and latency of the joint's sensor: with one sensor they are one number",
    "load, pump flow and temperature: they need a machine model or other channels",
]


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


def diagnose_joint(
    motion: Motion,
    audit: ClockAudit,
    joint: str | None = None,
    kind: Literal["auto", "speed", "position"] = "auto",
    progress: Callable[[str], None] | None = None,
    command_words: tuple[str, ...] = (),
) -> Diagnosis:
    """Diagnose one joint; `command_words` are of the command's name and unit.

    Raises:
        RefusedTableError: too short, or no motion that could tell anything.
    """
    span_s = float(motion.time_s[-1] - motion.time_s[0])
    if span_s < MIN_SPAN_S:
        raise RefusedTableError(
            f"the record lasts {span_s:.2f} s, at least {MIN_SPAN_S:g} s are needed; record several steps"
        )
    period_s = 1.0 / audit.rate_hz
    command = read_command(motion, command_words, period_s)
    notes = [*command.notes]
    if span_s > LONGEST_SPAN_S:
        motion = busiest_part(motion)
        first = float(motion.time_s[0])
        notes.append(
            f"of {span_s:.0f} s the {LONGEST_SPAN_S:g} s with the most commands are used, from "
            f"{first:.0f} s on"
        )
    problem = make_problem(motion, command, "speed" if kind == "auto" else kind, period_s)
    signal = float(np.sqrt(np.mean(problem.measured**2)))
    selection = select(problem, signal, problem.noise, progress, relevant_ratio=RELEVANT_RATIO)
    if kind == "auto" and not motion.is_speed and selection.left_ratio > 0.3:
        other = make_problem(motion, command, "position", period_s)
        spread = float(np.std(other.measured))
        tried = select(other, spread, other.noise, progress, relevant_ratio=RELEVANT_RATIO)
        if tried.left_ratio < min(0.5 * selection.left_ratio, POSITION_RATIO):
            problem, selection, signal = other, tried, spread
            notes.append("the position follows the command: taken as a position command")
    unit = motion.unit if problem.kind == "position" else f"{motion.unit}/s"
    _check_follows(problem, selection, unit)
    base, best = selection.base.fit.as_mapping(), selection.best.fit.as_mapping()
    evidence: dict[str, Any] = {
        "rate_hz": audit.rate_hz,
        "clock": audit.as_json(),
        "samples": len(motion.time_s),
        "span_s": span_s,
        "command_kind": problem.kind,
        "command_rest": command.rest,
        "command_full": command.full,
        "gain_per_full_command": {"value": best["speed_per_command"], "unit": unit},
        "window_s": len(problem.window) * problem.step_s,
        "noise": {"value": problem.noise, "unit": unit},
        "not_separable": _NOT_SEPARABLE,
        "notes": notes,
    }
    return diagnosis_of(
        problem,
        selection,
        problem.noise,
        StageNames(Stage.ACTUATION, joint, unit, _SEPARATING),
        evidence,
        _plots(problem, base, best, unit),
    )


def _check_follows(problem: ActuationProblem, selection: Selection, unit: str) -> None:
    """Refuse a motion that no response to the command explains better than none at all.

    Raises:
        RefusedTableError: it goes on as it likes; an effect would be read into noise.
    """
    varies = float(np.var(problem.measured))
    explained_ratio = 1.0 - selection.best.fit.mean_square / max(varies, 1e-300)
    if explained_ratio >= LEAST_EXPLAINED_RATIO:
        return
    what = "position" if problem.kind == "position" else "speed"
    raise RefusedTableError(
        f"the command explains {max(explained_ratio, 0.0):.0%} of how the {what} varies (standard deviation "
        f"{math.sqrt(varies):.3g} {unit}, of which noise {problem.noise:.3g}): the joint does not "
        "follow it. Choose the columns of one joint, check sensor and valve, or record larger steps"
    )


def busiest_part(motion: Motion) -> Motion:
    """The stretch of `LONGEST_SPAN_S` in which commands change most."""
    change = np.concatenate([[0.0], np.abs(np.diff(motion.command))])
    total = np.cumsum(change)
    end = np.searchsorted(motion.time_s, motion.time_s + LONGEST_SPAN_S) - 1
    whole = motion.time_s + LONGEST_SPAN_S <= motion.time_s[-1]
    start = int(np.argmax(np.where(whole, total[end] - total, -1.0)))
    part = slice(start, int(end[start]) + 1)
    return motion._replace(
        time_s=motion.time_s[part],
        command=motion.command[part],
        output=motion.output[part],
        run=motion.run[part],
    )


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
    raw_noise = _sample_noise(motion.output)
    noise = raw_noise
    measured = output
    if use_window:
        window, noise = _speed_window(output, raw_noise, step_s, period_s)
        measured = np.convolve(np.pad(output, len(window) // 2, "edge"), window, "valid")
    edge = len(window) // 2 + 1
    stride = max(1, round(max(period_s, len(grid_s) * step_s / MAX_SAMPLES) / step_s))
    sample = np.arange(edge, len(grid_s) - edge, stride)
    sample = sample[_is_seen(time_s, grid_s, max(5.0 * period_s, 0.1), len(window) // 2)[sample]]
    if sample.size < 30:
        raise RefusedTableError(f"{sample.size} usable samples are left, at least 30 are needed")
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
        ),
        block=spread_blocks(grid_s[sample], blocks, run),
        noise=noise,
        command_period_s=read.period_s,
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


def _sample_noise(values: Array) -> float:
    """Noise of one sample: third differences cancel smooth motion; their sd is sqrt(20) times it."""
    third = np.diff(values, n=3)
    noise = 1.4826 * float(np.median(np.abs(third - np.median(third)))) / math.sqrt(20.0)
    steps = np.abs(np.diff(values))
    moved = steps[steps > 0.0]
    if moved.size == 0 or moved.size > 0.8 * steps.size:
        return noise
    # A coarse encoder stands still most of the time: its noise is that of rounding.
    return max(noise, float(np.min(moved)) / math.sqrt(12.0))


def _speed_window(
    output: Array, noise: float, step_s: float, period_s: float
) -> tuple[Array, float]:
    """The shortest slope window that brings a speed's noise below 3 % of the top speed.

    The slope of a straight line through n samples over w seconds has variance 12 s^2 / (n w^2).
    """
    coarse = max(3, round(0.3 / step_s) | 1)
    rough = np.convolve(output, savgol_coeffs(coarse, 1, deriv=1, delta=step_s), "valid")
    top = float(np.quantile(np.abs(rough), 0.98)) or 1e-9
    seconds = max(3.0 * period_s, 0.04)
    for seconds in np.geomspace(
        max(3.0 * period_s, 0.04), max(LONGEST_WINDOW_S, 4.0 * period_s), 12
    ):
        left = noise * math.sqrt(12.0 * period_s / seconds) / seconds
        if left < NOISE_RATIO * top:
            break
    size = max(3, round(seconds / step_s) | 1)
    left = noise * math.sqrt(12.0 * period_s / seconds) / seconds
    return savgol_coeffs(size, 1, deriv=1, delta=step_s), float(left)


def _plots(
    problem: ActuationProblem, base: Mapping[str, float], best: Mapping[str, float], unit: str
) -> dict[str, Any]:
    """Measured, ideal and explained speed, at most 800 points."""
    thin = problem.sample[:: max(1, len(problem.sample) // 800)]
    keep = np.isin(problem.sample, thin)
    return {
        "response": {
            "x": (thin * problem.step_s).tolist(),
            "x_unit": "s",
            "measured": problem.measured[keep].tolist(),
            "ideal": problem.simulate(base)[thin].tolist(),
            "explained": problem.simulate(best)[thin].tolist(),
            "command_ratio": problem.command[thin].tolist(),
            "unit": unit,
        }
    }


_SEPARATING: Final[Mapping[frozenset[str], str]] = {
    frozenset(("valve_dead_time", "valve_lag")): (
        "steps of at least three sizes in both directions with 3 s rests, logged at 50 Hz or more: dead time "
        "delays the onset, lag rounds it"
    ),
    frozenset(("valve_dead_band", "valve_dead_time")): (
        "command ramps of three slopes in both directions: the onset's delay over 1/slope has the dead time "
        "as intercept and the dead band as slope"
    ),
    frozenset(("valve_dead_band", "stiction")): (
        "slow ramps up and down through zero in both directions: a dead band is the same up and down, "
        "stiction is not"
    ),
    frozenset(("valve_dead_band", "valve_curve")): (
        "a staircase of small steady commands (2 % apart, 3 s each) around the onset of motion"
    ),
    frozenset(("valve_hysteresis", "valve_dead_band")): (
        "a triangle of commands that reverses at half speed, away from zero"
    ),
    frozenset(("backlash", "valve_dead_time")): (
        "reversals at two speeds: backlash costs a travel, dead time a time"
    ),
    frozenset(("speed_limit", "valve_curve")): "a staircase of large steady commands up to full",
    frozenset(("acceleration_limit", "valve_lag")): (
        "steps of two sizes: a lag takes the same time for both, an acceleration limit takes longer for the "
        "larger one"
    ),
}
