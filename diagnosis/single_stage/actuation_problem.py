"""A joint's record as a fit problem: residuals on an even grid, without gaps and end stops.

A joint is at an end stop while its position is at the end of its range and it is commanded further. A joint
that reverses or rests at the end of its range, or waits within its dead band, is not at a stop.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import numpy as np
from scipy.ndimage import median_filter
from scipy.signal import savgol_coeffs

from diagnosis.single_stage.fit_problem import (
    EffectOption,
    FreeParameter,
    mask_every_third_block,
    number_blocks,
)
from diagnosis.single_stage.joint_response import (
    list_actuation_options,
    simulate_position,
    simulate_speed,
)
from diagnosis.tables.cells import RefusedTableError
from diagnosis.tables.joint_record import CommandScale, JointRecord
from diagnosis.tables.step_responses import StepResponse, find_step_responses
from diagnosis.tables.time_series import estimate_noise
from machine.conventions import Array, BoolArray, IntArray
from sim_twin.recurrences import apply_play

OutputKind = Literal["speed", "position"]
MAX_TICKS: Final = 5_000
"""Most ticks of the simulation."""
MAX_SAMPLES: Final = 2_000
"""Most residuals."""
MIN_TICK_S: Final = 0.005
"""Shortest tick, s."""
MAX_TICK_S: Final = 0.02
"""Longest tick unless the record needs more than `MAX_TICKS`, s."""
SINE_BINS: Final = 3
"""Half width of a windowed sine's line in the spectrum, bins."""
SINE_POWER_RATIO: Final = 0.995
"""Smallest share of a sine's power in its line; a triangle has 0.986."""
NEARLY_BEST_RATIO: Final = 0.9
"""Explained power, relative to the most, from which the shortest such delay gives the first gain."""
RESTING_RATIO: Final = 0.1
"""Share of the top speed, and of full command, below which the joint rests at the start of the record."""
BLOCKS_COUNT: Final = 15
"""Most blocks of a record; a block lasts at least 1 s."""
MIN_SPEED_NOISES: Final = 4.0
"""Speed, in standard deviations of its noise, below which a joint does not move."""
MIN_SAMPLES: Final = 30
"""Fewest residuals."""
STOP_FILTER_PERIODS: Final = 5
"""Sample periods of the median filter applied to a position before end stops are searched."""
SPEED_NOISE_RATIO: Final = 0.03
"""Noise of a differentiated position, as a share of the top speed."""
MAX_WINDOW_S: Final = 0.4
"""Longest window of the differentiator, s, or four sample periods."""
STOP_NOISE_RATIO: Final = 6.0
"""Tolerance of a position at the end of its range, in standard deviations of the noise."""
STOP_SPAN_RATIO: Final = 0.003
"""Smallest such tolerance, as a share of the range."""
STOP_EVIDENCE_RATIO: Final = 5.0
"""Travel commanded beyond an end, in tolerances, from which the end is a stop; a reversal gives 1 to 2."""
STOP_STAY_RATIO: Final = 1.0
"""Travel commanded beyond a known stop, in tolerances, from which a stay is excluded."""
COMMAND_BINS_COUNT: Final = 10
"""Bins of the command from rest to full, each with its median speed away from the ends."""
MIN_BIN_TICKS: Final = 10
"""Fewest ticks of a bin with a typical speed."""


@dataclass(frozen=True, slots=True)
class ActuationProblem:
    """Residuals of a joint's speed or position on an even grid; see `FitProblem`."""

    command: Array
    """(ticks,) -1..1, rest at 0."""
    measured: Array
    """(samples,) speed after the differentiator, or position for a position command."""
    place: Array
    """(ticks,) measured position, -1 and 1 at the ends of its range; a measured speed is integrated."""
    sample: IntArray
    """(samples,) tick of each residual."""
    window: Array
    """Kernel of the differentiator; empty when the output is used as it is."""
    step_s: float
    kind: OutputKind
    nuisance: tuple[FreeParameter, ...]
    options: tuple[EffectOption, ...]
    block: IntArray
    noise: float
    command_period_s: float
    """Sample period of the command, s; it changed at some time within one period before it was logged."""
    starts_at_rest: bool
    """Whether the command was at rest before the record; else its first value is held."""
    notes: tuple[str, ...]
    """What was excluded."""

    @property
    def full_structure(self) -> tuple[str, ...]:
        """Effects that most hydraulic joints have."""
        return (
            "valve_dead_time",
            "valve_lag_two_sided",
            "valve_dead_band_even",
            "speed_limit",
            "acceleration_limit",
        )

    @property
    def held_out_mask(self) -> BoolArray:
        """Every third block."""
        return mask_every_third_block(self.block)

    @property
    def timestamp_error_s(self) -> float:
        """Half a sample period of the command about its mean delay; the error is common to all changes."""
        return 0.5 * self.command_period_s

    @property
    def simulation_error_ratio(self) -> float:
        """Error from ticks and from a command known to half a period."""
        return 0.01

    @property
    def run_nuisance(self) -> frozenset[str]:
        """Empty: the record is one run."""
        return frozenset()

    @property
    def prefix_weights(self) -> tuple[Array, ...]:
        """Empty: the simulated motion does not diverge."""
        return ()

    def initial_guess(self, names: Sequence[str]) -> Mapping[str, float]:
        """Empty: the start values suffice."""
        return {}

    def residuals(self, values: Sequence[Mapping[str, float]]) -> Array:
        """(sets, samples) measured minus simulated."""
        return np.stack([self.measured - self.simulate(one)[self.sample] for one in values])

    def measured_ticks(self) -> Array:
        """(ticks,) measured output; nan where samples are left out."""
        ticks = np.arange(len(self.command))
        stride = int(np.median(np.diff(self.sample)))
        after = np.clip(np.searchsorted(self.sample, ticks), 1, len(self.sample) - 1)
        is_known = self.sample[after] - self.sample[after - 1] <= stride
        inside = (ticks >= self.sample[0]) & (ticks <= self.sample[-1])
        return np.where(is_known & inside, np.interp(ticks, self.sample, self.measured), math.nan)

    def simulate(self, values: Mapping[str, float]) -> Array:
        """(ticks,) output after the same differentiator as the measured one."""
        gap = values.get("backlash.gap_rad_m", 0.0)
        if self.kind == "position" or self.window.size == 0:
            output = simulate_speed(
                self.command, self.step_s, values, self.starts_at_rest, self.place
            )
            output = output + values["offset"]
            return apply_play(output, 0.5 * gap) if gap > 0.0 else output
        position = simulate_position(
            self.command, self.step_s, values, self.starts_at_rest, self.place
        )
        if gap > 0.0:
            position = apply_play(position, 0.5 * gap)
        return np.convolve(np.pad(position, len(self.window) // 2, "edge"), self.window, "valid")


def make_actuation_problem(
    record: JointRecord, scale: CommandScale, kind: OutputKind, period_s: float
) -> ActuationProblem:
    """Resample a joint's record on an even grid and exclude gaps and end stops.

    Args:
        record: the joint's record.
        scale: rest and full scale of its command.
        kind: whether a constant command means a speed or a position.
        period_s: median sample period.

    Raises:
        RefusedTableError: too few samples are left.
    """
    time_s = record.time_s - record.time_s[0]
    span_s = float(time_s[-1])
    step_s = period_s / max(1, math.ceil(period_s / MAX_TICK_S))
    step_s = max(step_s, MIN_TICK_S, span_s / MAX_TICKS)
    use_window = kind == "speed" and not record.is_speed
    grid_s, command, output, measured, window, noise = _grid_record(
        record, scale, period_s, step_s, use_window
    )
    edge = len(window) // 2 + 1
    stride = max(1, round(max(period_s, len(grid_s) * step_s / MAX_SAMPLES) / step_s))
    sample = np.arange(edge, len(grid_s) - edge, stride)
    sample = sample[_mask_gaps(time_s, grid_s, max(5.0 * period_s, 0.1), len(window) // 2)[sample]]
    notes: tuple[str, ...] = ()
    if use_window:
        smooth_ticks = round(STOP_FILTER_PERIODS * period_s / step_s)
        raw_noise = estimate_sample_noise(record.output)
        gridded = _GriddedMotion(command, output, measured, raw_noise, step_s, smooth_ticks)
        sample, notes = _exclude_end_stops(gridded, sample, len(window) // 2, record.unit)
    if sample.size < MIN_SAMPLES:
        raise RefusedTableError(
            f"{sample.size} usable samples are left, at least {MIN_SAMPLES} are needed"
            + "".join(f" ({note})" for note in notes)
        )
    top = float(np.quantile(np.abs(measured[sample]), 0.99))
    # A joint that rests in spite of the first command was not commanded before the record.
    starts_at_rest = kind == "speed" and (
        abs(float(measured[edge])) < RESTING_RATIO * top < top * abs(float(command[0]))
    )
    run = np.zeros(len(sample), dtype=np.int64)
    sine_s = find_sine_period(command, step_s)
    return ActuationProblem(
        command=command,
        measured=measured[sample],
        place=_scale_place(np.cumsum(output) if record.is_speed else output),
        sample=sample,
        window=window,
        step_s=step_s,
        kind=kind,
        nuisance=_list_nuisance(record, command, measured, sample, kind, sine_s is not None),
        options=list_actuation_options(
            period_s,
            span_s,
            top,
            0.0 if record.is_speed else float(np.ptp(record.output)),
            record.unit,
            use_window,
            is_speed=kind == "speed",
            sine_s=sine_s,
        ),
        block=number_blocks(grid_s[sample], max(span_s / BLOCKS_COUNT, 1.0), run),
        noise=noise,
        command_period_s=scale.period_s,
        starts_at_rest=starts_at_rest,
        notes=notes,
    )


def measure_steps(
    record: JointRecord, scale: CommandScale, period_s: float
) -> tuple[StepResponse, ...]:
    """Responses to all steps of a record at its own rate, each up to the next end stop or gap."""
    step_s = max(period_s, MIN_TICK_S)
    grid_s, command, output, speed, window, noise = _grid_record(
        record, scale, period_s, step_s, not record.is_speed
    )
    edge = len(window) // 2 + 1
    sample = np.arange(edge, len(grid_s) - edge)
    time_s = record.time_s - record.time_s[0]
    sample = sample[_mask_gaps(time_s, grid_s, max(5.0 * period_s, 0.1), edge - 1)[sample]]
    if sample.size < MIN_SAMPLES:
        return ()
    if not record.is_speed:
        raw_noise = estimate_sample_noise(record.output)
        gridded = _GriddedMotion(command, output, speed, raw_noise, step_s, STOP_FILTER_PERIODS)
        sample, _ = _exclude_end_stops(gridded, sample, edge - 1, record.unit)
    known = np.full(len(grid_s), math.nan)
    known[sample] = speed[sample]
    return find_step_responses(command, known, step_s, MIN_SPEED_NOISES * noise)


class _GriddedRecord(NamedTuple):
    """A record on an even grid, (ticks,) each."""

    grid_s: Array
    command: Array
    output: Array
    measured: Array
    """The output, or its speed."""
    window: Array
    """Kernel of the differentiator; empty without."""
    noise: float
    """Standard deviation of `measured`."""


def _grid_record(
    record: JointRecord,
    scale: CommandScale,
    period_s: float,
    step_s: float,
    use_window: bool,
) -> _GriddedRecord:
    """A record on a grid of `step_s`, differentiated if asked."""
    time_s = record.time_s - record.time_s[0]
    grid_s = np.arange(0.0, float(time_s[-1]), step_s)
    command = scale.on_grid(record, grid_s)
    output = np.interp(grid_s, time_s, record.output)
    noise = estimate_sample_noise(record.output)
    if not use_window:
        return _GriddedRecord(grid_s, command, output, output, np.array([]), noise)
    window, noise = design_differentiator(output, noise, step_s, period_s)
    measured = np.convolve(np.pad(output, len(window) // 2, "edge"), window, "valid")
    return _GriddedRecord(grid_s, command, output, measured, window, noise)


def _scale_place(position: Array) -> Array:
    """(ticks,) positions from -1 to 1 over their range."""
    low, high = float(np.min(position)), float(np.max(position))
    return (2.0 * position - low - high) / max(high - low, 1e-300)


def _list_nuisance(
    record: JointRecord,
    command: Array,
    measured: Array,
    sample: IntArray,
    kind: OutputKind,
    is_sine: bool,
) -> tuple[FreeParameter, ...]:
    """Gain and offset of the joint."""
    top = float(np.quantile(np.abs(measured[sample]), 0.99))
    centre = float(np.median(measured[sample])) if kind == "position" else 0.0
    slack = float(np.ptp(record.output)) if kind == "position" else 0.1 * top
    gain = _estimate_gain(command, measured - centre, sample, top)
    low, high = -20.0 * top, 20.0 * top
    if is_sine:
        # Half a period more with a gain of the other sign is the same motion.
        low, high = (0.0, high) if gain > 0.0 else (low, 0.0)
    return (
        FreeParameter("speed_per_command", record.unit, low, high, (gain,)),
        FreeParameter("offset", record.unit, centre - slack, centre + slack, (centre,)),
    )


def find_sine_period(command: Array, step_s: float) -> float | None:
    """Period, s, of a command (ticks,) that is one sine: its power is one line of the spectrum; else None."""
    power = np.abs(np.fft.rfft((command - np.mean(command)) * np.hanning(len(command)))) ** 2
    peak = int(np.argmax(power))
    near = power[max(peak - SINE_BINS, 0) : peak + SINE_BINS + 1]
    if peak <= SINE_BINS or float(np.sum(near)) <= SINE_POWER_RATIO * float(np.sum(power)):
        return None
    return len(command) * step_s / peak


class _GriddedMotion(NamedTuple):
    """A joint on the grid, (ticks,) each."""

    command: Array
    position: Array
    speed: Array
    noise: float
    """Standard deviation of one position."""
    step_s: float
    smooth_ticks: int


def _exclude_end_stops(
    gridded: _GriddedMotion, sample: IntArray, margin: int, unit: str
) -> tuple[IntArray, tuple[str, ...]]:
    """Samples that are at least `margin` ticks from an end stop, and a note."""
    top = float(np.quantile(np.abs(gridded.speed), 0.99))
    drive = (
        math.copysign(1.0, _estimate_gain(gridded.command, gridded.speed, sample, top))
        * gridded.command
    )
    stops = find_end_stops(
        gridded.position, gridded.speed, drive, gridded.noise, gridded.step_s, gridded.smooth_ticks
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


def _mask_gaps(time_s: Array, grid_s: Array, max_gap_s: float, margin: int) -> BoolArray:
    """(ticks,) whether a tick is at least `margin` ticks from any gap of `max_gap_s` or longer."""
    after = np.clip(np.searchsorted(time_s, grid_s), 1, len(time_s) - 1)
    hole = (time_s[after] - time_s[after - 1] >= max_gap_s).astype(np.int64)
    return np.convolve(hole, np.ones(2 * margin + 1, dtype=np.int64), "same") == 0


def _estimate_gain(command: Array, measured: Array, sample: IntArray, top: float) -> float:
    """Least-squares gain with the shortest nearly best delay, so that the fit starts with the right sign."""
    found: list[tuple[float, float]] = []
    for ticks in np.unique(np.geomspace(1, max(len(command) // 10, 2), 60).astype(int)):
        u = np.concatenate([np.full(ticks, command[0]), command[:-ticks]])[sample]
        product, power = float(np.dot(u, measured[sample])), float(np.dot(u, u))
        if power > 0.0:
            found.append((product**2 / power, product / power))
    most = max((explained for explained, _ in found), default=0.0)
    return next((gain for explained, gain in found if explained >= NEARLY_BEST_RATIO * most), top)


def estimate_sample_noise(values: Array) -> float:
    """Standard deviation of one sample's noise, with the quantisation of a coarse encoder."""
    noise = estimate_noise([values])
    steps = np.abs(np.diff(values))
    moved = steps[steps > 0.0]
    if moved.size == 0 or moved.size > 0.8 * steps.size:
        return noise
    # The reading of a coarse encoder rarely changes: its noise is that of quantisation.
    return max(noise, float(np.min(moved)) / math.sqrt(12.0))


def design_differentiator(
    output: Array, noise: float, step_s: float, period_s: float
) -> tuple[Array, float]:
    """The shortest slope filter with a noise below 3 % of the top speed, and that noise.

    The slope of a line through n samples over w seconds has variance 12 s^2 / (n w^2).
    """
    coarse = max(3, round(0.3 / step_s) | 1)
    coarse_speed = np.convolve(output, savgol_coeffs(coarse, 1, deriv=1, delta=step_s), "valid")
    top = float(np.quantile(np.abs(coarse_speed), 0.98)) or 1e-9
    seconds = max(3.0 * period_s, 0.04)
    for seconds in np.geomspace(max(3.0 * period_s, 0.04), max(MAX_WINDOW_S, 4.0 * period_s), 12):
        left = noise * math.sqrt(12.0 * period_s / seconds) / seconds
        if left < SPEED_NOISE_RATIO * top:
            break
    size = max(3, round(seconds / step_s) | 1)
    left = noise * math.sqrt(12.0 * period_s / seconds) / seconds
    return savgol_coeffs(size, 1, deriv=1, delta=step_s), float(left)


class EndStops(NamedTuple):
    """Ends of the range at which the joint was held."""

    is_held: BoolArray
    """(ticks,) from the arrival at a stop until the joint has left it."""
    places: tuple[float, ...]
    """Positions of the stops."""


def find_end_stops(
    position: Array, speed: Array, drive: Array, noise: float, step_s: float, smooth_ticks: int
) -> EndStops:
    """Find end stops of a joint whose speed follows its command.

    Args:
        position: (ticks,) as measured.
        speed: (ticks,) from it, unit/s.
        drive: (ticks,) the command, positive where it moves the position up.
        noise: standard deviation of a measured position.
        step_s: tick.
        smooth_ticks: width of the median filter.
    """
    held = np.zeros(len(position), dtype=np.bool_)
    places: list[float] = []
    tolerance = max(STOP_NOISE_RATIO * noise, STOP_SPAN_RATIO * float(np.ptp(position)))
    for side in (-1.0, 1.0):
        outward = side * median_filter(position, max(smooth_ticks | 1, 3), mode="nearest")
        end = float(np.max(outward))
        near = outward >= end - tolerance
        typical = _typical_speed(side * speed, side * drive, near)
        stays = _find_stays(near)
        travels = [float(np.sum(typical[stay])) * step_s / tolerance for stay in stays]
        if max(travels) < STOP_EVIDENCE_RATIO:
            continue
        places.append(side * end)
        stays = [s for s, travel in zip(stays, travels, strict=True) if travel > STOP_STAY_RATIO]
        for stay in stays:
            first = stay.start + int(np.argmax(typical[stay] > 0.0))
            left = np.flatnonzero(outward[stay.stop :] < end - 2.0 * tolerance)
            held[first : stay.stop + (int(left[0]) if left.size else 0)] = True
    return EndStops(held, tuple(places))


def _typical_speed(speed: Array, drive: Array, near: BoolArray) -> Array:
    """(ticks,) median outward speed at a similar command away from the end; 0 for an inward command."""
    top = max(float(np.max(drive)), 1e-12)
    bins = np.clip(np.floor(COMMAND_BINS_COUNT * drive / top), 0, COMMAND_BINS_COUNT - 1).astype(
        np.int64
    )
    typical = np.zeros(COMMAND_BINS_COUNT)
    for number in range(COMMAND_BINS_COUNT):
        elsewhere = speed[(bins == number) & (drive > 0.0) & ~near]
        if elsewhere.size >= MIN_BIN_TICKS:
            typical[number] = max(float(np.median(elsewhere)), 0.0)
    return np.where(drive > 0.0, typical[bins], 0.0)


def _find_stays(near: BoolArray) -> list[slice]:
    """Contiguous stretches of ticks at the end of the range."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], near.astype(np.int64), [0]])))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
