"""The three stages alone, from a CSV file to the result: columns, units, runs and groups.

What a file cannot give is refused with the reason as verdict ``bad_data``; nothing is guessed in silence.
"""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, Literal

import numpy as np

from diagnosis.alone.actuation import diagnose_joint
from diagnosis.alone.flight import diagnose_ball
from diagnosis.alone.flight_problem import Ball
from diagnosis.alone.reading.clocks import time_of
from diagnosis.alone.reading.columns import (
    axes_of,
    command_of,
    found_groups,
    group_labels,
    integrated,
    is_velocity,
    listed,
    outputs_of,
    pairs_of,
)
from diagnosis.alone.reading.free_swings import Swing, swing_of_rate
from diagnosis.alone.reading.layout import MIN_ROWS, RefusedTableError
from diagnosis.alone.reading.motion import read_motion
from diagnosis.alone.reading.runs import check_rate, clean_series, split_runs, time_seconds
from diagnosis.alone.reading.swings import swing_column
from diagnosis.alone.reading.tables import Table, read_table
from diagnosis.alone.reading.tracks import Flight, Scale
from diagnosis.alone.reading.units import AngleUnit, are_pixels, metres, without_spikes
from diagnosis.alone.several import combined, refused
from diagnosis.alone.swing import diagnose_swing
from diagnosis.loading.clock_audit import audit_clock
from diagnosis.verdict import Diagnosis
from machine.conventions import Array, BoolArray, IntArray
from machine.errors import UsageError

Tell = Callable[[str], None]
Kind = Literal["auto", "speed", "position"]
MAX_BODIES_COUNT: Final = 40
"""More different labels are no bodies but another quantity."""


def actuation_from_csv(
    path: Path,
    time: str | None = None,
    command: str | None = None,
    position: str | None = None,
    velocity: str | None = None,
    group: str | None = None,
    kind: Kind = "auto",
    tell: Tell | None = None,
) -> Diagnosis:
    """Diagnose the joints of a table; several columns are separated by commas.

    Raises:
        UsageError: commands and outputs do not pair up.
    """
    if position is not None and velocity is not None:
        raise UsageError(
            "give --position or --velocity, not both; the position tells more if it is there"
        )
    try:
        table = read_table(path)
        time = time_of(table, time)
        is_speed = velocity is not None
        commands, outputs = listed(command), listed(velocity if is_speed else position)
        if not commands and not outputs:
            commands, outputs = pairs_of(table)
        commands = commands or [command_of(table, time, next(iter(outputs), None))]
        if not outputs:
            outputs, is_speed = outputs_of(table, [time, *commands])
        if group is None:
            owner, run = found_groups(table, [time, *commands, *outputs])
            group = ",".join(name for name in (owner, run) if name is not None) or None
        labels = group_labels(table, group)
    except RefusedTableError as error:
        return refused(str(error))
    if len(commands) != len(outputs):
        raise UsageError(
            f"{len(commands)} commands ({', '.join(commands)}) and {len(outputs)} outputs "
            f"({', '.join(outputs)}): give one command for each joint, in the same order"
        )
    parts: dict[str, Diagnosis] = {}
    for one, output in zip(commands, outputs, strict=True):
        name = output if len(outputs) > 1 else None
        table.notes = table.notes[:] if not parts else []
        try:
            motion, audit = read_motion(table, time, one, output, is_speed, labels)
            found = diagnose_joint(motion, audit, name, kind, tell, tuple(table.words(one)))
        except RefusedTableError as error:
            parts[output] = refused(str(error), {"notes": table.notes})
            continue
        parts[output] = _noted(found, table.notes)
    return combined(parts)


def swing_from_csv(
    path: Path,
    time: str | None = None,
    angle: str | None = None,
    group: str | None = None,
    length_m: float | None = None,
    angle_unit: AngleUnit = "auto",
    fps: float | None = None,
    counts_per_turn: float | None = None,
    tell: Tell | None = None,
) -> Diagnosis:
    """Diagnose the free swings of one body.

    Args:
        path: CSV file.
        time: column of times; frame numbers with `fps`.
        angle: column of angles, rates of turn, or ways of a mass on a spring.
        group: column that tells swings apart; a pause or a new start of time does it as well.
        length_m: of the ideal pendulum.
        angle_unit: of the angle.
        fps: frames a second of a film.
        counts_per_turn: of an encoder.
        tell: told what is being done.
    """
    try:
        table = read_table(path)
        time = time_of(table, time, fps)
        column = swing_column(table, time, angle, angle_unit, counts_per_turn)
        if group is None:
            owner, run = found_groups(table, [time, *column.name.split(", ")])
            group = ",".join(name for name in (owner, run) if name is not None) or None
        runs = _runs(table, time, group_labels(table, group), [column.values], column.name)
        if column.is_rate:
            table.notes.append(
                f"{column.name!r} is a rate: integrated to an angle, its bias taken off"
            )
            swings = [swing_of_rate(t, rate) for t, (rate,) in runs]
        else:
            swings = [Swing(t, a) for t, (a,) in runs]
        reference = math.nan if length_m is None else length_m
        found = diagnose_swing(swings, reference, None, tell, is_length=column.is_length)
    except RefusedTableError as error:
        return refused(str(error))
    return _noted(found, table.notes)


def flight_from_csv(
    path: Path,
    time: str | None = None,
    axes: Sequence[str] = (),
    group: str | None = None,
    ball: Ball | None = None,
    length_unit: str = "auto",
    fps: float | None = None,
    tell: Tell | None = None,
) -> Diagnosis:
    """Diagnose tracked balls.

    Args:
        path: CSV file.
        time: its time column.
        axes: columns of the position; the last one is up. Found by name if left out.
        group: columns (by commas); the first tells balls apart, all of them tell flights apart.
        ball: mass and diameter, the same for all.
        length_unit: m, cm, mm, ft, in, yd, px, or auto: by the columns' names, else m.
        fps: frames a second of a film.
        tell: told what is being done.
    """
    try:
        table = read_table(path)
        time = time_of(table, time, fps)
        names = list(axes) or axes_of(table)
        columns = [table.numbers(name) * metres(table, name, length_unit) for name in names]
        scale = Scale(are_pixels(table, names, length_unit), not axes, length_unit == "auto")
        owner, run = found_groups(table, [time, *names]) if group is None else (None, None)
        owner = next(iter(listed(group)), owner)
        group = group or ",".join(name for name in (owner, run) if name is not None) or None
        labels = group_labels(table, group)
        balls = table.labels(owner) if owner else ["ball"] * table.row_count
        if len(set(balls)) > MAX_BODIES_COUNT:
            raise RefusedTableError(
                f"column {owner!r} has {len(set(balls))} different values, at most {MAX_BODIES_COUNT} balls "
                "are diagnosed at once: choose the column that tells balls apart"
            )
    except RefusedTableError as error:
        return refused(str(error))
    parts: dict[str, Diagnosis] = {}
    speeds = [is_velocity(table, name) for name in names]
    if any(speeds):
        table.notes.append(f"{', '.join(names)} are speeds: integrated to positions")
    for name in dict.fromkeys(balls):
        mine = np.array(balls) == name
        try:
            own = [_despiked(table, *pair, mine) for pair in zip(names, columns, strict=True)]
            runs = _runs(table, time, labels, own, " and ".join(names), mine)
            flights = [Flight(t, _placed(t, p, speeds)) for t, p in runs]
            found = diagnose_ball(
                flights,
                ball or Ball(),
                name if owner else None,
                tell,
                is_mixed_refused=not owner,
                scale=scale,
            )
        except RefusedTableError as error:
            parts[name] = refused(str(error))
            continue
        parts[name] = _noted(found, table.notes)
        if tell is not None:
            tell(f"{name}: {found.verdict.value}")
    return combined(parts)


def _despiked(table: Table, name: str, column: Array, mine: BoolArray) -> Array:
    """A column without the stray values among one ball's rows."""
    out = column.copy()
    out[mine] = without_spikes(table, name, column[mine])
    return out


def _placed(time_s: Array, columns: Sequence[Array], are_speeds: Sequence[bool]) -> Array:
    """(rows, axes) positions; speeds are integrated from 0."""
    return np.stack(
        [
            integrated(time_s, column) if is_speed else column
            for column, is_speed in zip(columns, are_speeds, strict=True)
        ],
        axis=1,
    )


def _runs(
    table: Table,
    time: str,
    labels: Sequence[str],
    columns: Sequence[Array],
    what: str,
    mine: BoolArray | None = None,
) -> list[tuple[Array, list[Array]]]:
    """Times from zero and values of each run; short ones are left out and noted."""
    time_s = time_seconds(table, time)
    keep = np.isfinite(time_s)
    if mine is not None:
        keep &= mine
    rows = np.flatnonzero(keep)
    names = np.array(labels)[rows]
    changed = np.concatenate([[0], np.cumsum(names[1:] != names[:-1])])
    found: list[tuple[Array, list[Array]]] = []
    short = 0
    for label in np.unique(changed):
        inside = rows[changed == label]
        for run in _split(time_s[inside]):
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


def _split(time_s: Array) -> list[IntArray]:
    runs = split_runs(time_s)
    return [np.flatnonzero(runs == number) for number in np.unique(runs)]


def _noted(found: Diagnosis, notes: Sequence[str]) -> Diagnosis:
    own = list(found.evidence.get("notes", []))
    unique = list(dict.fromkeys([*own, *notes]))
    return found.model_copy(update={"evidence": {**found.evidence, "notes": unique}})
