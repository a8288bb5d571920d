"""What a person reads off a plot of a joint: when and how fast it moves after each step from rest."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np

from machine.conventions import Array, BoolArray

SAME_COMMAND_RATIO: Final = 0.01
"""Change of the command, as a share of full, below which it is held."""
REST_RATIO: Final = 0.02
"""Largest command at rest, as a share of full."""
MIN_LEVEL_RATIO: Final = 0.05
"""Smallest step, as a share of full."""
MIN_REST_S: Final = 0.3
"""Shortest rest before a step, s."""
MIN_HOLD_S: Final = 0.6
"""Shortest step, s."""
MAX_EDGE_TICKS: Final = 3
"""Longest edge of a step, ticks."""
RESTING_S: Final = 0.1
"""Time before a step over which the joint's mean speed tells whether it rests, s: within some ticks a coarse
encoder may show one of its steps."""
RESTING_SPEED_RATIO: Final = 0.1
"""Speed before a step, as a share of that after it, below which the joint rests."""
MIN_STARTS_COUNT: Final = 2
"""Fewest starts with and without a reversal that show lost travel."""
NEARLY_TOP_RATIO: Final = 0.93
"""Share of the largest steady speed from which a level is as fast as any: at one command it varies by some
percent with place and load."""
SATURATED_SPAN_RATIO: Final = 1.2
"""Ratio of the largest level to the smallest such one from which the joint is saturated: the speeds of
proportional ones would differ by more than twice what `NEARLY_TOP_RATIO` lets pass."""
LOST_TRAVEL_SIGNIFICANCE: Final = 3.0
"""Lost travel, in its standard errors, from which it shows."""


class StepResponse(NamedTuple):
    """One step from rest; nan where the joint did not move."""

    tick: int
    level: float
    """Command, as a share of full."""
    onset_s: float
    """From the step to where the tangent through 20 and 60 % of the steady speed meets zero, at most three
    ticks before the joint is seen to move."""
    rise_s: float
    """From there to 63 % of the steady speed."""
    steady_speed: float
    """Median over the travel of the last two thirds of the step, unit/s; a stay at an end counts little."""
    is_reversal: bool
    """Whether the joint moved the other way before."""


def find_step_responses(
    command: Array, speed: Array, step_s: float, least_speed: float
) -> tuple[StepResponse, ...]:
    """Find steps from rest and measure the response to each.

    Args:
        command: (ticks,) rest at 0, full at 1.
        speed: (ticks,) nan where it is not known; a step counts up to there, as up to an end stop.
        step_s: tick.
        least_speed: speed below which the joint does not move.
    """
    edges = np.flatnonzero(np.abs(np.diff(command)) > SAME_COMMAND_RATIO) + 1
    bounds = np.concatenate([[0], edges, [len(command)]])
    held = [(int(a), int(b)) for a, b in pairwise(bounds) if b - a > MAX_EDGE_TICKS]
    found: list[StepResponse] = []
    way = 0.0
    for (rest, start), (begin, end) in pairwise(held):
        after = _until_unknown(speed[start:end])
        steady = _median_over_travel(after[len(after) // 3 :]) if len(after) else math.nan
        is_step = (
            begin - start <= MAX_EDGE_TICKS
            and (start - rest) * step_s >= MIN_REST_S
            and len(after) * step_s >= MIN_HOLD_S
            and abs(command[rest]) <= REST_RATIO
            and abs(command[begin]) >= MIN_LEVEL_RATIO
        )
        if is_step:
            resting = max(round(RESTING_S / step_s), MAX_EDGE_TICKS)
            before = abs(float(np.mean(speed[start - resting : start])))
            if before <= max(RESTING_SPEED_RATIO * abs(steady), least_speed):
                is_reversal = way * steady < 0.0
                found.append(
                    _measure(
                        start, float(command[begin]), after, steady, step_s, least_speed
                    )._replace(is_reversal=is_reversal)
                )
        if abs(command[begin]) > REST_RATIO and abs(steady) > least_speed:
            way = math.copysign(1.0, steady)
    return tuple(found)


def _until_unknown(speed: Array) -> Array:
    """The beginning of a speed (ticks,), up to where it is not known."""
    is_known = np.isfinite(speed)
    return speed if is_known.all() else speed[: int(np.argmin(is_known))]


def _median_over_travel(speed: Array) -> float:
    """Speed (ticks,) above and below which the joint travels equally far."""
    order = np.argsort(speed)
    travel = np.cumsum(np.abs(speed[order]))
    return float(speed[order][int(np.searchsorted(travel, 0.5 * travel[-1]))])


def _measure(
    tick: int, level: float, after: Array, steady: float, step_s: float, least_speed: float
) -> StepResponse:
    if abs(steady) <= least_speed:
        return StepResponse(tick, level, math.nan, math.nan, steady, False)
    share = after / steady
    middle, high = (int(np.argmax(share >= one)) for one in (0.6, 0.63))
    # From the middle back: a coarse encoder may show one of its steps before the joint moves.
    low = _end_of(share[:middle] < 0.2)
    is_moving = after * math.copysign(1.0, steady) > least_speed
    moves = _end_of(~is_moving[:low]) - MAX_EDGE_TICKS
    onset_s = max(low - 0.5 * (middle - low), moves, 0.0) * step_s
    high_s = high * step_s
    return StepResponse(tick, level, onset_s, high_s - onset_s, steady, False)


def _end_of(is_true: BoolArray) -> int:
    """Index behind the last true value; 0 without one."""
    return int(is_true.size - np.argmax(is_true[::-1])) if is_true.any() else 0


def tabulate(steps: Sequence[StepResponse], unit: str) -> list[dict[str, Any]]:
    """Medians by direction and level to a tenth of full, as JSON; ``null`` where the joint did not move."""
    keys = sorted({(step.level > 0.0, round(abs(step.level), 1)) for step in steps})
    rows: list[dict[str, Any]] = []
    for is_positive, level in keys:
        group = [
            s for s in steps if (s.level > 0.0, round(abs(s.level), 1)) == (is_positive, level)
        ]
        moving = [step for step in group if math.isfinite(step.onset_s)]
        rows.append(
            {
                "direction": "positive" if is_positive else "negative",
                "level_ratio": level,
                "onset_s": float(np.median([s.onset_s for s in moving])) if moving else None,
                "rise_s": float(np.median([s.rise_s for s in moving])) if moving else None,
                "steady_speed": float(np.median([s.steady_speed for s in group])),
                "speed_unit": unit,
                "steps": len(group),
            }
        )
    return rows


class DirectionReading(NamedTuple):
    """What the steps of one direction show; None where they do not show it."""

    direction: str
    dead_time_s: float
    """Median onset."""
    dead_band_ratio: float | None
    """Command, as a share of full, at which a line through the two smallest moving levels has no speed."""
    saturation_ratio: float | None
    """Smallest of several levels whose speed is nearly the largest one."""
    top_speed: float
    """Largest steady speed, unit/s."""
    steps_count: int


def read_directions(steps: Sequence[StepResponse]) -> tuple[DirectionReading, ...]:
    """What a person reads off the steps, for each direction with at least two that moved the joint."""
    found: list[DirectionReading] = []
    for name, way in (("positive", 1.0), ("negative", -1.0)):
        ours = [step for step in steps if step.level * way > 0.0]
        moving = [step for step in ours if math.isfinite(step.onset_s)]
        if len(moving) < MIN_STARTS_COUNT:
            continue
        levels = sorted({round(abs(step.level), 2) for step in moving})
        speeds = [
            abs(float(np.median([s.steady_speed for s in moving if round(abs(s.level), 2) == one])))
            for one in levels
        ]
        resting = [abs(s.level) for s in ours if not math.isfinite(s.onset_s)]
        found.append(
            DirectionReading(
                name,
                float(np.median([step.onset_s for step in moving])),
                _dead_band(levels, speeds, max(resting, default=0.0)),
                _saturation(levels, speeds),
                max(speeds),
                len(ours),
            )
        )
    return tuple(found)


def _saturation(levels: Sequence[float], speeds: Sequence[float]) -> float | None:
    """Smallest level that is nearly as fast as any, as are most of those above it; some may be slower."""
    least = NEARLY_TOP_RATIO * max(speeds)
    for place, (level, speed) in enumerate(zip(levels, speeds, strict=True)):
        if speed >= least and float(np.median(speeds[place:])) >= least:
            return level if levels[-1] >= SATURATED_SPAN_RATIO * level else None
    return None


def _dead_band(levels: Sequence[float], speeds: Sequence[float], resting: float) -> float | None:
    """Level without speed, between the largest level at rest and the smallest that moves."""
    if len(levels) < 2 or speeds[1] <= speeds[0]:
        return None
    slope = (speeds[1] - speeds[0]) / (levels[1] - levels[0])
    return min(max(levels[0] - speeds[0] / slope, resting), levels[0])


def shows_lost_travel(steps: Sequence[StepResponse]) -> bool:
    """Whether starts after a reversal come later by a travel than starts in the same direction.

    Regression of the onset on a delay for each direction and, for reversals, on the time that a travel takes
    at the steady speed.
    """
    moving = [step for step in steps if math.isfinite(step.onset_s)]
    reversals = sum(step.is_reversal for step in moving)
    if min(reversals, len(moving) - reversals) < MIN_STARTS_COUNT:
        return False
    matrix = np.array(
        [
            [step.level > 0.0, step.level < 0.0, step.is_reversal / abs(step.steady_speed)]
            for step in moving
        ],
        dtype=np.float64,
    )
    onset = np.array([step.onset_s for step in moving])
    solution = np.linalg.lstsq(matrix, onset, rcond=None)[0]
    freedom = len(moving) - np.linalg.matrix_rank(matrix)
    if freedom < 1:
        return False
    variance = float(np.sum((onset - matrix @ solution) ** 2)) / freedom
    error = math.sqrt(variance * float(np.linalg.pinv(matrix.T @ matrix)[2, 2]))
    return bool(solution[2] > LOST_TRAVEL_SIGNIFICANCE * error)


def find_late_onset(
    measured: Sequence[StepResponse], explained: Sequence[StepResponse], tolerance_s: float
) -> str:
    """Where measured and explained motion begin at other times; empty if they agree.

    Args:
        measured: responses of the joint.
        explained: responses of the fitted effects to the same commands.
        tolerance_s: largest difference of the median onset in one direction that counts as equal.
    """
    by_tick = {step.tick: step.onset_s for step in explained}
    words: list[str] = []
    for name, is_positive in (("positive", True), ("negative", False)):
        pairs = [
            (step.onset_s, by_tick[step.tick])
            for step in measured
            if (step.level > 0.0) == is_positive
            and math.isfinite(step.onset_s)
            and math.isfinite(by_tick.get(step.tick, math.nan))
        ]
        if len(pairs) < MIN_STARTS_COUNT:
            continue
        seen, simulated = (float(np.median([pair[k] for pair in pairs])) for k in (0, 1))
        if abs(float(np.median([a - b for a, b in pairs]))) > tolerance_s:
            words.append(
                f"{name} steps begin to move the joint after {seen:.2g} s, by these effects after "
                f"{simulated:.2g} s"
            )
    return "; ".join(words)
