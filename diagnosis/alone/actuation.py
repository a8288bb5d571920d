"""Diagnoses the actuation of one joint from commands and its motion alone, without a machine model.

The ideal joint moves at a speed in proportion to its command. What it does instead is explained by dead time,
lag, dead band and the other effects of response.py, or called unknown. Nothing is said about sensor
latency: with one sensor it is the same as dead time.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any, Final, Literal

import numpy as np

from diagnosis.alone.joint import ActuationProblem, make_problem
from diagnosis.alone.reading.commands import read_command
from diagnosis.alone.reading.layout import RefusedTableError
from diagnosis.alone.reading.motion import Motion
from diagnosis.alone.selection import Selection, select
from diagnosis.alone.verdict import StageNames, diagnosis_of
from diagnosis.loading.clock_audit import ClockAudit
from diagnosis.verdict import Diagnosis, Stage
from machine.conventions import Array

MIN_SPAN_S: Final = 2.0
RELEVANT_RATIO: Final = 0.015
"""Of the motion, by eye: what the stepwise simulation of a joint and its log's ticks leave undecided."""
LEAST_EXPLAINED_RATIO: Final = 0.1
"""Of the variance; by eye: five parameters read about 0.02 into noise of the shortest records."""
POSITION_RATIO: Final = 0.25
"""A position that follows its command leaves less than this unexplained; a drifting one does not follow."""
LEAST_LEFT_RATIO: Final = 0.1
"""Of the motion: when less is left unexplained the clocks agree well enough."""
LONGEST_LEAD_S: Final = 2.0
SHIFTS_COUNT: Final = 80
"""Of the command, to either side, that are tried."""
LEAST_LEAD_PERIODS: Final = 3.0
LEAD_RATIO: Final = 0.8
"""Of the variance that the best delay leaves: commands that repeat may lead by as much as they lag."""
LONGEST_SPAN_S: Final = 150.0
"""A tick is then 30 ms, still less than any lag worth naming; longer records add time and little else."""
_NOT_SEPARABLE: Final = [
    "dead time of the valve and latency of the joint's sensor: with one sensor they are one number",
    "load, pump flow and temperature: they need a machine model or other channels",
]


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
    notes.extend(problem.notes)
    unit = motion.unit if problem.kind == "position" else f"{motion.unit}/s"
    _check_clocks(problem, selection, period_s)
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


def _check_clocks(problem: ActuationProblem, selection: Selection, period_s: float) -> None:
    """Refuse a motion that comes before its command.

    Raises:
        RefusedTableError: it fits a command clearly better that was given later than any before it.
    """
    if selection.left_ratio < LEAST_LEFT_RATIO:
        return
    command, tick_s = problem.command, problem.step_s
    most = min(round(LONGEST_LEAD_S / tick_s), len(command) // 4)
    shifts = np.unique(np.round(np.linspace(-most, most, 2 * SHIFTS_COUNT + 1)).astype(int))
    left = np.array([_left_of_line(problem, np.roll(command, int(-k))) for k in shifts])
    ahead, behind = shifts > 0, shifts <= 0
    best = int(shifts[ahead][np.argmin(left[ahead])])
    least_s = max(LEAST_LEAD_PERIODS * period_s, 2.0 * problem.command_period_s)
    if best * tick_s < least_s or np.min(left[ahead]) > LEAD_RATIO * np.min(left[behind]):
        return
    raise RefusedTableError(
        f"the motion leads the command by {best * tick_s:.2g} s or more: with the command that much earlier "
        f"a line leaves {np.min(left[ahead]):.0%} of the motion's variance, without or with a delay at least "
        f"{np.min(left[behind]):.0%}. The clocks of the two columns differ, or the command was logged late: "
        "shift one column and run this again"
    )


def _left_of_line(problem: ActuationProblem, command: Array) -> float:
    """Share of the variance that a line through the command leaves of what was measured."""
    matrix = np.stack([np.ones(problem.sample.size), command[problem.sample]], axis=1)
    line, *_ = np.linalg.lstsq(matrix, problem.measured, rcond=None)
    left = np.var(problem.measured - matrix @ line)
    return float(left) / max(float(np.var(problem.measured)), 1e-300)


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
