"""Diagnose the actuation of one joint from its commands and its record, without a machine model.

The ideal joint moves at a speed proportional to its command. Deviations are explained by the effects of
`joint_response`, or reported as unknown. Sensor latency is not reported: one sensor cannot separate it from
dead time.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, Final, Literal

import numpy as np

from diagnosis.loading.clock_audit import ClockAudit
from diagnosis.single_stage.actuation_problem import (
    MIN_SPEED_NOISES,
    ActuationProblem,
    find_sine_period,
    make_actuation_problem,
    measure_steps,
)
from diagnosis.single_stage.command_kind import (
    FittedKind,
    fit_likely_kind,
    refuse_leading_motion,
)
from diagnosis.single_stage.stage_result import StageLabels, build_diagnosis
from diagnosis.single_stage.structure_selection import Selection, select_structure
from diagnosis.tables.cells import RefusedTableError
from diagnosis.tables.joint_record import CommandScale, JointRecord, read_command_scale
from diagnosis.tables.step_responses import (
    DirectionReading,
    StepResponse,
    find_late_onset,
    find_step_responses,
    read_directions,
    shows_lost_travel,
    tabulate,
)
from diagnosis.verdict import (
    Ambiguity,
    Diagnosis,
    FittedEffect,
    FittedParameter,
    Stage,
    VerdictKind,
)
from machine.conventions import Array

CommandKind = Literal["auto", "speed", "position"]
MIN_SPAN_S: Final = 2.0
"""Shortest record, s."""
RELEVANT_RATIO: Final = 0.015
"""Share of the motion that an effect must explain to be named; covers errors of simulation and sampling."""
MIN_EXPLAINED_RATIO: Final = 0.1
"""Smallest explained share of the variance; noise alone can give about 0.02 in a short record."""
MIN_UNEXPLAINED_RATIO: Final = 0.1
"""Unexplained share of the motion below which clocks are not checked."""
MAX_SPAN_S: Final = 150.0
"""Longest part of a record that is used, s; the tick is then 30 ms."""
MAX_ONSET_PERIODS: Final = 3.0
"""Difference of measured and explained onset, in sample periods, up to which they agree."""
MAX_ONSET_S: Final = 0.1
"""Smallest difference of the onsets, s, that counts."""
LATE_ONSET_PROBABILITY: Final = 0.95
"""Probability of "unknown" if the effects move the joint at another time than it moved."""
BACKLASH_NEEDS: Final = (
    "backlash: it shows where some steps from rest reverse the joint and come later, by a travel, than those "
    "that go on in the same direction"
)
NOT_SEPARABLE: Final = [
    "dead time of the valve and latency of the joint's sensor: with one sensor they are one number",
    "load, pump flow and temperature: they need a machine model or other channels",
]


def diagnose_actuation(
    record: JointRecord,
    audit: ClockAudit,
    joint: str | None = None,
    kind: CommandKind = "auto",
    progress: Callable[[str], None] | None = None,
    command_words: tuple[str, ...] = (),
) -> Diagnosis:
    """Diagnose one joint.

    Args:
        record: the joint's record.
        audit: audit of its clock.
        joint: its name in the result.
        kind: whether a constant command means a speed or a position; auto tries both.
        progress: called with a line of text at each level of the search.
        command_words: words of the command column's name and unit.

    Raises:
        RefusedTableError: the record is too short, does not follow its command, or leads it.
    """
    span_s = float(record.time_s[-1] - record.time_s[0])
    if span_s < MIN_SPAN_S:
        raise RefusedTableError(
            f"the record lasts {span_s:.2f} s, at least {MIN_SPAN_S:g} s are needed; record several steps"
        )
    period_s = 1.0 / audit.rate_hz
    scale = read_command_scale(record, command_words, period_s)
    notes = [*scale.notes]
    all_steps = measure_steps(record, scale, period_s)
    if span_s > MAX_SPAN_S:
        record = select_busiest_part(record, scale.rest)
        first = float(record.time_s[0])
        notes.append(
            f"of {span_s:.0f} s the {MAX_SPAN_S:g} s with the most commands in both directions are used, "
            f"from {first:.0f} s on"
        )
    problem, selection = _fit_kind(record, scale, kind, period_s, progress)
    if kind == "auto" and problem.kind == "position":
        notes.append("the position follows the command: taken as a position command")
    notes.extend(problem.notes)
    unit = record.unit if problem.kind == "position" else f"{record.unit}/s"
    _refuse_unrelated_motion(problem, selection, unit)
    base, best = selection.base.fit.as_mapping(), selection.best.fit.as_mapping()
    steps = all_steps if problem.kind == "speed" else ()
    readings = read_directions(steps)
    late = _late_onset(problem, best, period_s)
    if late:
        selection = replace(selection, unknown_probability=LATE_ONSET_PROBABILITY)
    evidence: dict[str, Any] = {
        "rate_hz": audit.rate_hz,
        "clock": audit.as_json(),
        "samples": len(record.time_s),
        "span_s": span_s,
        "command_kind": problem.kind,
        "command_rest": scale.rest,
        "command_full": scale.full,
        "gain_per_full_command": {"value": best["speed_per_command"], "unit": unit},
        "window_s": len(problem.window) * problem.step_s,
        "noise": {"value": problem.noise, "unit": unit},
        "steps": tabulate(steps, unit),
        "directions": [{**reading._asdict(), "speed_unit": unit} for reading in readings],
        "not_separable": [
            *NOT_SEPARABLE,
            *([] if any(o.effect == "backlash" for o in problem.options) else [BACKLASH_NEEDS]),
        ],
        "notes": notes,
    }
    found = build_diagnosis(
        problem,
        selection,
        problem.noise,
        StageLabels(Stage.ACTUATION, joint, unit, SEPARATING_RECORDS),
        evidence,
        _plots(problem, base, best, unit),
    )
    found = _with_steps(found, late, readings, unit)
    is_sine = find_sine_period(problem.command, problem.step_s) is not None
    return _without_separation(found, joint) if is_sine else found


def find_steps(problem: ActuationProblem, speed: Array) -> tuple[StepResponse, ...]:
    """Responses of a speed (ticks,) to the steps of the command; none for a position command."""
    if problem.kind == "position":
        return ()
    return find_step_responses(
        problem.command, speed, problem.step_s, MIN_SPEED_NOISES * problem.noise
    )


def _late_onset(problem: ActuationProblem, best: Mapping[str, float], period_s: float) -> str:
    """Where the best effects move the joint at another time than its steps show; empty if nowhere."""
    tolerance_s = max(MAX_ONSET_PERIODS * period_s, MAX_ONSET_S)
    measured = find_steps(problem, problem.measured_ticks())
    return find_late_onset(measured, find_steps(problem, problem.simulate(best)), tolerance_s)


def _with_steps(
    found: Diagnosis, late: str, readings: tuple[DirectionReading, ...], unit: str
) -> Diagnosis:
    """The result with what the steps say against it or, where the cause is unknown, beside it."""
    sentence = f"{found.sentence} Yet {late}." if late else found.sentence
    if found.verdict is VerdictKind.UNKNOWN and readings:
        words = "; ".join(_describe_direction(reading, unit) for reading in readings)
        sentence += f" Its steps show: {words}."
    return found.model_copy(update={"sentence": sentence})


def _describe_direction(reading: DirectionReading, unit: str) -> str:
    """Dead time, dead band and saturation of one direction, as the steps show them."""
    words = f"{reading.direction}, dead time {reading.dead_time_s:.2f} s"
    if reading.dead_band_ratio is not None:
        words += f", dead band {reading.dead_band_ratio:.0%} of full command"
    if reading.saturation_ratio is not None:
        words += f", no faster above {reading.saturation_ratio:.0%}"
    return f"{words}, up to {reading.top_speed:.2g} {unit}, {reading.steps_count} steps"


def _without_separation(found: Diagnosis, joint: str | None) -> Diagnosis:
    """The result for one sine, whose phase is one number: dead time and lag cannot be separated.

    An ambiguity of other effects, or with none, stays.
    """
    pair = ("valve_dead_time", "valve_lag")
    delays = [
        p
        for effect in found.causes[0].effects
        for name, p in effect.parameters.items()
        if name in ("extra_dead_time_s", "extra_lag_s")
    ]
    is_of_delays = found.ambiguity is not None and set(found.ambiguity.members) == set(pair)
    if not delays or not (found.verdict is VerdictKind.EXPLAINED or is_of_delays):
        return found
    total = FittedParameter(
        value=sum(p.value for p in delays),
        ci90=(sum(p.ci90[0] for p in delays), sum(p.ci90[1] for p in delays)),
        unit="s",
    )
    why = (
        f"the command is one sine, so that delay and lag cannot be separated; together they are about "
        f"{total.value:.2g} s"
    )
    ambiguity = Ambiguity(
        members=pair,
        effects=tuple(
            (FittedEffect(effect=effect, joint=joint, parameters={parameter: total}),)
            for effect, parameter in zip(pair, ("extra_dead_time_s", "extra_lag_s"), strict=True)
        ),
        separating_motion={
            "kind": Stage.ACTUATION.value,
            "joint": joint,
            "words": SEPARATING_RECORDS[frozenset(pair)],
        },
        why=why,
    )
    sentence = f"{found.sentence} {why.capitalize()}."
    return found.model_copy(
        update={"verdict": VerdictKind.AMBIGUOUS, "ambiguity": ambiguity, "sentence": sentence}
    )


def _fit_kind(
    record: JointRecord,
    scale: CommandScale,
    kind: CommandKind,
    period_s: float,
    progress: Callable[[str], None] | None,
) -> FittedKind:
    """Fit the command as one of `kind`; auto takes the kind that explains more.

    Raises:
        RefusedTableError: the motion leads its command.
    """
    select = partial(_select_structure, progress=progress)
    drive = make_actuation_problem(record, scale, "speed", period_s)
    if not shows_lost_travel(find_steps(drive, drive.measured_ticks())):
        # Without such starts a dead band or dead time that differs by level looks the same.
        drive = replace(drive, options=tuple(o for o in drive.options if o.effect != "backlash"))
    if kind == "auto" and not record.is_speed:
        found = fit_likely_kind(
            drive, make_actuation_problem(record, scale, "position", period_s), select
        )
    else:
        problem = (
            make_actuation_problem(record, scale, "position", period_s)
            if kind == "position"
            else drive
        )
        found = FittedKind(problem, select(problem))
    if found.selection.unexplained_ratio > MIN_UNEXPLAINED_RATIO:
        refuse_leading_motion(drive, period_s)
    return found


def _select_structure(
    problem: ActuationProblem, progress: Callable[[str], None] | None
) -> Selection:
    is_servo = problem.kind == "position"
    signal = float(np.std(problem.measured) if is_servo else np.sqrt(np.mean(problem.measured**2)))
    return select_structure(problem, signal, problem.noise, progress, relevant_ratio=RELEVANT_RATIO)


def _refuse_unrelated_motion(problem: ActuationProblem, selection: Selection, unit: str) -> None:
    """Refuse a motion that no response to the command explains.

    Raises:
        RefusedTableError: the explained share is too small.
    """
    variance = float(np.var(problem.measured))
    explained_ratio = 1.0 - selection.best.fit.mean_square / max(variance, 1e-300)
    if explained_ratio >= MIN_EXPLAINED_RATIO:
        return
    what = "position" if problem.kind == "position" else "speed"
    raise RefusedTableError(
        f"the command explains {max(explained_ratio, 0.0):.0%} of how the {what} varies (standard deviation "
        f"{math.sqrt(variance):.3g} {unit}, of which noise {problem.noise:.3g}): the joint does not "
        "follow it. Choose the columns of one joint, check sensor and valve, or record larger steps"
    )


def select_busiest_part(record: JointRecord, rest: float) -> JointRecord:
    """The part of `MAX_SPAN_S` with the most command changes, in the direction that has fewer of them.

    Args:
        record: the joint's record.
        rest: command at which the joint rests.
    """
    end = np.searchsorted(record.time_s, record.time_s + MAX_SPAN_S) - 1
    whole = record.time_s + MAX_SPAN_S <= record.time_s[-1]
    changes: list[Array] = []
    for way in (1.0, -1.0):
        one = np.maximum(way * (record.command - rest), 0.0)
        total = np.cumsum(np.concatenate([[0.0], np.abs(np.diff(one))]))
        if total[-1] > 0.0:
            changes.append(total[end] - total)
    start = int(np.argmax(np.where(whole, np.min(changes, axis=0), -1.0)))
    part = slice(start, int(end[start]) + 1)
    return record._replace(
        time_s=record.time_s[part],
        command=record.command[part],
        output=record.output[part],
        run=record.run[part],
    )


def _plots(
    problem: ActuationProblem, base: Mapping[str, float], best: Mapping[str, float], unit: str
) -> dict[str, Any]:
    """Measured, ideal and explained motion, at most 800 points."""
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


SEPARATING_RECORDS: Final[Mapping[frozenset[str], str]] = {
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
