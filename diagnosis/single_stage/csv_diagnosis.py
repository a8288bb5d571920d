"""Diagnose single stages from CSV files: find columns, convert units, split runs, group bodies.

Data that cannot be used give the verdict ``bad_data`` with the reason. Every assumption is noted.
"""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from scipy.integrate import cumulative_trapezoid

from diagnosis.loading.clock_audit import audit_clock
from diagnosis.single_stage.actuation_diagnosis import CommandKind, diagnose_actuation
from diagnosis.single_stage.flight_diagnosis import diagnose_flight
from diagnosis.single_stage.flight_problem import BallProperties
from diagnosis.single_stage.stage_result import bad_data_diagnosis, combine_diagnoses
from diagnosis.single_stage.swing_diagnosis import diagnose_swing
from diagnosis.tables.cells import RefusedTableError
from diagnosis.tables.column_units import AngleUnit, are_pixels, metres_per_unit, remove_outliers
from diagnosis.tables.columns import (
    find_axis_columns,
    find_command_column,
    find_group_columns,
    find_output_columns,
    find_time_column,
    group_labels,
    is_velocity,
    pair_joint_columns,
    split_list,
)
from diagnosis.tables.free_swings import SwingRecord, swing_from_rate
from diagnosis.tables.joint_record import read_joint_record
from diagnosis.tables.layouts import MIN_ROWS
from diagnosis.tables.repairs import find_lost_detections, find_repeated_frames
from diagnosis.tables.swing_column import find_swing_column
from diagnosis.tables.table import DEFAULT_OPTIONS, ReadOptions, Table, read_table
from diagnosis.tables.time_series import check_rate, clean_series, split_runs, time_in_seconds
from diagnosis.tables.tracks import RETIMED_TOLERANCE_RATIO, FlightRecord, TrackScale
from diagnosis.verdict import Diagnosis
from machine.conventions import Array, BoolArray, IntArray
from machine.errors import UsageError

Progress = Callable[[str], None]
MAX_BALLS_COUNT: Final = 40
"""Most labels of balls; a column with more holds another quantity."""


def diagnose_actuation_csv(
    path: Path,
    time: str | None = None,
    command: str | None = None,
    position: str | None = None,
    velocity: str | None = None,
    group: str | None = None,
    kind: CommandKind = "auto",
    progress: Progress | None = None,
    options: ReadOptions = DEFAULT_OPTIONS,
) -> Diagnosis:
    """Diagnose the joints of a CSV file; several columns are separated by commas.

    Args:
        path: CSV file.
        time: column of times.
        command: columns of commands.
        position: columns of positions.
        velocity: columns of velocities, instead of positions.
        group: column that labels runs; a restart of time also begins a run.
        kind: whether a constant command means a speed or a position; auto tries both.
        progress: called with a line of text at each level of the search.
        options: what the user says about the cells.

    Raises:
        UsageError: commands and outputs do not pair up.
    """
    if position is not None and velocity is not None:
        raise UsageError(
            "give --position or --velocity, not both; the position tells more if it is there"
        )
    try:
        table = read_table(path, options)
        time = find_time_column(table, time)
        is_speed = velocity is not None
        commands = split_list(command, table)
        outputs = split_list(velocity if is_speed else position, table)
        if not commands and not outputs:
            commands, outputs = pair_joint_columns(table)
        commands = commands or [find_command_column(table, time, next(iter(outputs), None))]
        if not outputs:
            outputs, is_speed = find_output_columns(table, [time, *commands])
        if group is None:
            owner, run = find_group_columns(table, [time, *commands, *outputs])
            group = ",".join(name for name in (owner, run) if name is not None) or None
        labels = group_labels(table, group)
    except RefusedTableError as error:
        return bad_data_diagnosis(str(error))
    if len(commands) != len(outputs):
        raise UsageError(
            f"{len(commands)} commands ({', '.join(commands)}) and {len(outputs)} outputs "
            f"({', '.join(outputs)}): give one command for each joint, in the same order"
        )
    parts: dict[str, Diagnosis] = {}
    for command_column, output in zip(commands, outputs, strict=True):
        name = output if len(outputs) > 1 else None
        table.notes = table.notes[:] if not parts else []
        try:
            record, audit = read_joint_record(table, time, command_column, output, is_speed, labels)
            found = diagnose_actuation(
                record, audit, name, kind, progress, tuple(table.words(command_column))
            )
        except RefusedTableError as error:
            parts[output] = bad_data_diagnosis(str(error), {"notes": table.notes})
            continue
        parts[output] = _add_notes(found, table.notes)
    return combine_diagnoses(parts)


def diagnose_swing_csv(
    path: Path,
    time: str | None = None,
    angle: str | None = None,
    group: str | None = None,
    length_m: float | None = None,
    angle_unit: AngleUnit = "auto",
    fps: float | None = None,
    counts_per_turn: float | None = None,
    progress: Progress | None = None,
    options: ReadOptions = DEFAULT_OPTIONS,
) -> Diagnosis:
    """Diagnose the free swings of one body.

    Args:
        path: CSV file.
        time: column of times; of frame numbers with `fps`.
        angle: column of angles, angular rates, or displacements of a mass on a spring.
        group: column that labels swings; a pause or a restart of time also begins a swing.
        length_m: length of the ideal pendulum.
        angle_unit: of the angle.
        fps: frames per second of a video.
        counts_per_turn: of an encoder.
        progress: called with a line of text at each level of the search.
        options: what the user says about the cells.
    """
    try:
        table = read_table(path, options)
        time = find_time_column(table, time, fps)
        column = find_swing_column(table, time, angle, angle_unit, counts_per_turn)
        if group is None:
            owner, run = find_group_columns(table, [time, *column.name.split(", ")])
            group = ",".join(name for name in (owner, run) if name is not None) or None
        runs = _split_into_runs(
            table, time, group_labels(table, group), [column.values], column.name
        )
        if column.is_rate:
            table.notes.append(
                f"{column.name!r} is a rate: integrated to an angle, its bias taken off"
            )
            swings = [swing_from_rate(t, rate) for t, (rate,) in runs]
        else:
            swings = [SwingRecord(t, a) for t, (a,) in runs]
        reference = math.nan if length_m is None else length_m
        found = diagnose_swing(swings, reference, None, progress, is_length=column.is_length)
    except RefusedTableError as error:
        return bad_data_diagnosis(str(error))
    return _add_notes(found, table.notes)


def diagnose_flight_csv(
    path: Path,
    time: str | None = None,
    axes: Sequence[str] = (),
    group: str | None = None,
    ball: BallProperties | None = None,
    length_unit: str = "auto",
    fps: float | None = None,
    progress: Progress | None = None,
    options: ReadOptions = DEFAULT_OPTIONS,
) -> Diagnosis:
    """Diagnose tracked balls.

    Args:
        path: CSV file.
        time: column of times; of frame numbers with `fps`.
        axes: columns of the position, the last one up; found by name if left out.
        group: columns, separated by commas; the first labels balls, all together label flights.
        ball: mass and diameter, the same for all.
        length_unit: m, cm, mm, ft, in, yd, px, or auto: by the columns' names, else m.
        fps: frames per second of a video.
        progress: called with a line of text at each level of the search.
        options: what the user says about the cells.
    """
    try:
        table = read_table(path, options)
        time = find_time_column(table, time, fps)
        names = list(axes) or find_axis_columns(table)
        columns, is_retimed = _read_track(table, names, length_unit)
        scale = TrackScale(
            are_pixels(table, names, length_unit), not axes, length_unit == "auto", is_retimed
        )
        owner, run = find_group_columns(table, [time, *names]) if group is None else (None, None)
        owner = next(iter(split_list(group, table)), owner)
        group = group or ",".join(name for name in (owner, run) if name is not None) or None
        labels = group_labels(table, group)
        balls = table.labels(owner) if owner else ["ball"] * table.row_count
        if len(set(balls)) > MAX_BALLS_COUNT:
            raise RefusedTableError(
                f"column {owner!r} has {len(set(balls))} different values, at most {MAX_BALLS_COUNT} balls "
                "are diagnosed at once: choose the column that tells balls apart"
            )
    except RefusedTableError as error:
        return bad_data_diagnosis(str(error))
    parts: dict[str, Diagnosis] = {}
    speeds = [is_velocity(table, name) for name in names]
    if any(speeds):
        table.notes.append(f"{', '.join(names)} are speeds: integrated to positions")
    for name in dict.fromkeys(balls):
        of_ball = np.array(balls) == name
        try:
            ball_columns = [
                _remove_ball_outliers(table, *pair, of_ball)
                for pair in zip(names, columns, strict=True)
            ]
            runs = _split_into_runs(table, time, labels, ball_columns, " and ".join(names), of_ball)
            flights = [FlightRecord(t, _make_positions(t, p, speeds)) for t, p in runs]
            found = diagnose_flight(
                flights,
                ball or BallProperties(),
                name if owner else None,
                progress,
                is_mixed_refused=not owner,
                scale=scale,
            )
        except RefusedTableError as error:
            parts[name] = bad_data_diagnosis(str(error))
            continue
        parts[name] = _add_notes(found, table.notes)
        if progress is not None:
            progress(f"{name}: {found.verdict.value}")
    return combine_diagnoses(parts)


def _read_track(table: Table, names: Sequence[str], length_unit: str) -> tuple[list[Array], bool]:
    """Columns of positions in m, or pixels, and whether frames are repeated.

    They are nan where the tracker lost the body or repeated a frame.
    """
    raw = [table.numbers(table.column(name)) for name in names]
    lost, place = find_lost_detections(raw)
    repeated = find_repeated_frames(raw)
    if np.any(lost):
        table.note(
            f"{int(np.sum(lost))} rows hold {place:g} in all of {', '.join(names)}: taken as lost, left out"
        )
    if np.any(repeated):
        table.note(
            f"{int(np.sum(repeated))} rows repeat the place of the row before: frames that are there several "
            f"times, kept once; the frame rate is doubtful ({RETIMED_TOLERANCE_RATIO:.0%} of gravity are "
            "allowed for)"
        )
    no_value = lost | repeated
    columns = [
        np.where(no_value, np.nan, column) * metres_per_unit(table, name, length_unit)
        for name, column in zip(names, raw, strict=True)
    ]
    return columns, bool(np.any(repeated))


def _remove_ball_outliers(table: Table, name: str, column: Array, of_ball: BoolArray) -> Array:
    """A column without the outliers among one ball's rows."""
    out = column.copy()
    out[of_ball] = remove_outliers(table, name, column[of_ball])
    return out


def _make_positions(time_s: Array, columns: Sequence[Array], are_speeds: Sequence[bool]) -> Array:
    """(rows, axes) positions; velocities are integrated from 0."""
    return np.stack(
        [
            cumulative_trapezoid(column, time_s, initial=0.0) if is_speed else column
            for column, is_speed in zip(columns, are_speeds, strict=True)
        ],
        axis=1,
    )


def _split_into_runs(
    table: Table,
    time: str,
    labels: Sequence[str],
    columns: Sequence[Array],
    what: str,
    of_ball: BoolArray | None = None,
) -> list[tuple[Array, list[Array]]]:
    """Times from zero and values of each run; runs that are too short are left out and noted."""
    time_s = time_in_seconds(table, time)
    keep = np.isfinite(time_s)
    if of_ball is not None:
        keep &= of_ball
    rows = np.flatnonzero(keep)
    names = np.array(labels)[rows]
    changed = np.concatenate([[0], np.cumsum(names[1:] != names[:-1])])
    found: list[tuple[Array, list[Array]]] = []
    short = 0
    for label in np.unique(changed):
        inside = rows[changed == label]
        for run in _split_at_pauses(time_s[inside]):
            part = inside[run]
            merged = np.sum([column[part] for column in columns], axis=0)
            if int(np.sum(np.isfinite(merged))) < MIN_ROWS // 2:
                short += 1
                continue
            t, _ = clean_series(time_s[part], merged, what, table.notes, MIN_ROWS // 2)
            place = np.searchsorted(time_s[part], t)
            check_rate(audit_clock(t), table.path.name)
            found.append((t - t[0], [column[part][place] for column in columns]))
    if short:
        table.notes.append(f"{short} runs of fewer than {MIN_ROWS // 2} rows left out")
    if not found:
        raise RefusedTableError(f"{table.path.name} has no run of {MIN_ROWS // 2} rows with {what}")
    return found


def _split_at_pauses(time_s: Array) -> list[IntArray]:
    runs = split_runs(time_s)
    return [np.flatnonzero(runs == number) for number in np.unique(runs)]


def _add_notes(found: Diagnosis, notes: Sequence[str]) -> Diagnosis:
    earlier_notes = list(found.evidence.get("notes", []))
    unique = list(dict.fromkeys([*earlier_notes, *notes]))
    return found.model_copy(update={"evidence": {**found.evidence, "notes": unique}})
