"""Whether a joint's command means a speed or a position, by lines through the delayed command.

Both kinds predict the same measured speed: a speed command directly, a position command by its slope. Each
line has a delay, a first-order lag, a gain and an offset.
"""

import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np
from scipy.signal import lfilter

from diagnosis.single_stage.actuation_problem import ActuationProblem
from diagnosis.single_stage.structure_selection import UNKNOWN_RATIO, Selection
from diagnosis.tables.cells import RefusedTableError
from machine.conventions import Array

MAX_SHIFT_S: Final = 2.0
"""Longest delay or lead of a line, s."""
SHIFTS_COUNT: Final = 100
"""Delays tried, and leads tried."""
LAGS_S: Final = (0.0, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6)
"""Lags tried, s."""
EQUAL_LINES_RATIO: Final = 0.01
"""Difference of unexplained shares up to which two lines are equally good."""


MAX_LINE_UNEXPLAINED_RATIO: Final = 0.1
"""Unexplained share of the variance below which a line explains the motion."""
LIKELY_RATIO: Final = 0.5
"""Unexplained share of one kind's line, relative to the other's, below which only that kind is fitted."""
CLEARLY_LESS_RATIO: Final = 0.7
"""Held-out error of the less likely kind, relative to the other's, from which it is taken."""
MIN_LEAD_PERIODS: Final = 3.0
"""Shortest lead that is refused, in sample periods."""
LEAD_RATIO: Final = 0.8
"""Largest unexplained variance with a lead, relative to that with the best delay.

Periodic commands also fit with a lead.
"""


class Line(NamedTuple):
    """The best line through the delayed command."""

    unexplained_ratio: float
    """Share of the variance of the measured speed that it leaves, noise included."""
    delay_s: float
    """Delay and lag together; negative if the motion leads."""


class CommandLines(NamedTuple):
    """Lines of one kind of command."""

    delayed: Line
    leading: Line


def fit_lines(problem: ActuationProblem, is_servo: bool) -> CommandLines:
    """Fit lines with delays and with leads between a command and a speed.

    Args:
        problem: the joint with its command taken as one for speed.
        is_servo: whether the line is for a position command.
    """
    command, speed, step_s = problem.command, problem.measured, problem.step_s
    most = max(min(round(MAX_SHIFT_S / step_s), len(command) // 4), 1)
    delays = np.unique(np.round(np.linspace(0, most, SHIFTS_COUNT + 1)).astype(np.int64))
    centred = speed - np.mean(speed)
    power = max(float(centred @ centred), 1e-300)
    delayed: list[Line] = []
    leading: list[Line] = []
    for lag_s in LAGS_S:
        signal = _predict(command, lag_s, problem.window, step_s, is_servo)
        for shifts, lines in ((delays, delayed), (-delays[1:], leading)):
            place = np.clip(problem.sample - shifts[:, None], 0, len(signal) - 1)
            x = signal[place]
            x -= np.mean(x, axis=1, keepdims=True)
            explained = (x @ centred) ** 2 / np.maximum(np.sum(x**2, axis=1), 1e-300) / power
            lines.extend(
                Line(1.0 - float(share), float(shift) * step_s + lag_s)
                for share, shift in zip(explained, shifts, strict=True)
            )
    return CommandLines(
        _shortest(delayed), _shortest([line for line in leading if line.delay_s < 0.0])
    )


def _predict(command: Array, lag_s: float, window: Array, step_s: float, is_servo: bool) -> Array:
    """(ticks,) speed at gain 1 without delay, after the differentiator."""
    lagged = command
    if lag_s > 0.0:
        a = math.exp(-step_s / lag_s)
        lagged = np.asarray(lfilter([1.0 - a], [1.0, -a], command, zi=[a * command[0]])[0])
    if window.size == 0:
        return lagged
    position = lagged if is_servo else np.cumsum(lagged) * step_s
    return np.convolve(np.pad(position, len(window) // 2, "edge"), window, "valid")


def _shortest(lines: Sequence[Line]) -> Line:
    """Of the equally good lines, as of a periodic command, the one with the shortest delay."""
    least = min((line.unexplained_ratio for line in lines), default=1.0) + EQUAL_LINES_RATIO
    good = [line for line in lines if line.unexplained_ratio <= least]
    return min(good, key=lambda line: abs(line.delay_s), default=Line(1.0, 0.0))


class FittedKind(NamedTuple):
    """A joint with its command taken as one kind, and the structures fitted to it."""

    problem: ActuationProblem
    selection: Selection


def fit_likely_kind(
    drive: ActuationProblem,
    servo: ActuationProblem,
    select: Callable[[ActuationProblem], Selection],
) -> FittedKind:
    """Fit the command as one for speed, for position, or both; take the kind with the smaller held-out error.

    If a line explains both, as for a sine, the kind with the shorter delay is taken: the other one needs a
    quarter of a period more.

    Args:
        drive: the joint with its command taken as one for speed.
        servo: with its command taken as one for position.
        select: fits the structures.
    """
    line, servo_line = fit_lines(drive, False).delayed, fit_lines(drive, True).delayed
    unexplained, servo_unexplained = line.unexplained_ratio, servo_line.unexplained_ratio
    if max(unexplained, servo_unexplained) < MAX_LINE_UNEXPLAINED_RATIO:
        shorter = servo if servo_line.delay_s < line.delay_s else drive
        return FittedKind(shorter, select(shorter))
    first, other = (servo, drive) if servo_unexplained < unexplained else (drive, servo)
    found = FittedKind(first, select(first))
    is_likely = min(unexplained, servo_unexplained) < LIKELY_RATIO * max(
        unexplained, servo_unexplained
    )
    if is_likely and found.selection.unexplained_ratio < UNKNOWN_RATIO:
        return found
    rival = FittedKind(other, select(other))
    limit = CLEARLY_LESS_RATIO * _estimate_held_out_speed_error(found, drive)
    return rival if _estimate_held_out_speed_error(rival, drive) < limit else found


def _estimate_held_out_speed_error(fitted: FittedKind, drive: ActuationProblem) -> float:
    """Root mean square of the measured speed less the simulated one, scaled from fit to held-out pieces."""
    best = fitted.selection.best
    simulated = fitted.problem.simulate(best.fit.as_mapping())
    if fitted.problem.kind == "position":
        simulated = np.convolve(
            np.pad(simulated, len(drive.window) // 2, "edge"), drive.window, "valid"
        )
    error = float(np.mean((drive.measured - simulated[drive.sample]) ** 2))
    return math.sqrt(error * best.held_out / max(best.fit.mean_square, 1e-300))


def refuse_leading_motion(drive: ActuationProblem, period_s: float) -> None:
    """Refuse a motion that precedes its command.

    Args:
        drive: the joint with its command taken as one for speed.
        period_s: median sample period.

    Raises:
        RefusedTableError: an earlier command explains the motion clearly better than any delay.
    """
    lines = fit_lines(drive, False)
    least = lines.delayed.unexplained_ratio
    if drive.window.size > 0:
        least = min(least, fit_lines(drive, True).delayed.unexplained_ratio)
    lead_s, left = -lines.leading.delay_s, lines.leading.unexplained_ratio
    min_lead_s = max(MIN_LEAD_PERIODS * period_s, 2.0 * drive.command_period_s)
    if lead_s < min_lead_s or left > LEAD_RATIO * least:
        return
    raise RefusedTableError(
        f"the motion leads the command by {lead_s:.2g} s or more: with the command that much earlier "
        f"a line leaves {left:.0%} of the motion's variance, without or with a delay at least {least:.0%}. "
        "The clocks of the two columns differ, or the command was logged late: shift one column and run "
        "this again"
    )
