"""The three stages alone, from a CSV file to the result: columns, units, runs and groups.

What a file cannot give is refused with the reason as verdict ``bad_data``; nothing is guessed in silence.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final, Literal

import numpy as np

from diagnosis.alone.actuation import diagnose_joint, read_motion
from diagnosis.alone.flight import Ball, Flight, diagnose_ball
from diagnosis.alone.several import combined, refused
from diagnosis.alone.swing import Swing, diagnose_swing
from diagnosis.alone.tables import (
    MIN_ROWS,
    RefusedTableError,
    Table,
    check_rate,
    clean_series,
    has_degrees,
    read_table,
    split_runs,
    time_seconds,
)
from diagnosis.loading.clock_audit import audit_clock
from diagnosis.verdict import Diagnosis
from machine.conventions import Array, BoolArray, IntArray
from machine.errors import UsageError

Tell = Callable[[str], None]
Kind = Literal["auto", "speed", "position"]
AngleUnit = Literal["auto", "rad", "deg"]
LENGTHS_M: Final[Mapping[str, float]] = {
    "m": 1.0,
    "cm": 0.01,
    "mm": 0.001,
    "ft": 0.3048,
    "in": 0.0254,
}
TIME_WORDS: Final = ("time", "t", "timestamp", "stamp", "seconds", "sec")
COMMAND_WORDS: Final = ("command", "cmd", "joystick", "joy", "valve", "input", "u", "control")
POSITION_WORDS: Final = ("position", "pos", "angle", "q", "theta", "extension", "encoder")
VELOCITY_WORDS: Final = ("velocity", "vel", "speed", "omega", "qd", "rate")
ANGLE_WORDS: Final = ("angle", "theta", "swing", "pitch", "phi", "position", "pos", "encoder", "q")
HEIGHT_WORDS: Final = ("z", "height", "altitude", "alt", "h")


def actuation_from_csv(
    path: Path,
    time: str | None = None,
    command: str | None = None,
    position: str | None = None,
    velocity: str | None = None,
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
        time = time or table.guess("time", "--time", TIME_WORDS)
        commands = _listed(command) or [table.guess("command", "--command", COMMAND_WORDS)]
        is_speed = velocity is not None
        outputs = _listed(velocity if is_speed else position)
        if not outputs:
            outputs, is_speed = _guessed_output(table)
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
            motion, audit = read_motion(table, time, one, output, is_speed)
            found = diagnose_joint(motion, audit, name, kind, tell)
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
    tell: Tell | None = None,
) -> Diagnosis:
    """Diagnose the free swings of one body; a group, a pause or a new start of time begins another swing."""
    try:
        table = read_table(path)
        time = time or table.guess("time", "--time", TIME_WORDS)
        angle = angle or table.guess("angle", "--angle", ANGLE_WORDS)
        values = _in_radians(table, angle, table.numbers(angle), angle_unit)
        swings = [
            Swing(t, np.unwrap(a))
            for t, (a,) in _runs(table, time, _group_labels(table, group), [values], angle)
        ]
        reference = math.nan if length_m is None else length_m
        found = diagnose_swing(swings, reference, None, tell)
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
    tell: Tell | None = None,
) -> Diagnosis:
    """Diagnose tracked balls.

    Args:
        path: CSV file.
        time: its time column.
        axes: columns of the position; the last one is up. Found by name if left out.
        group: columns (by commas); the first tells balls apart, all of them tell flights apart.
        ball: mass and diameter, the same for all.
        length_unit: m, cm, mm, ft, in, or auto: by the columns' names, else m.
        tell: told what is being done.
    """
    try:
        table = read_table(path)
        time = time or table.guess("time", "--time", TIME_WORDS)
        names = list(axes) or _guessed_axes(table)
        columns = [table.numbers(name) * _metres(table, name, length_unit) for name in names]
        owners = _listed(group)[:1]
        parts: dict[str, Diagnosis] = {}
        labels = _group_labels(table, group)
        balls = table.labels(owners[0]) if owners else ["ball"] * table.row_count
    except RefusedTableError as error:
        return refused(str(error))
    for name in dict.fromkeys(balls):
        mine = np.array([label == name for label in balls])
        try:
            runs = _runs(table, time, labels, columns, " and ".join(names), mine)
            flights = [Flight(t, np.stack(p, axis=1)) for t, p in runs]
            found = diagnose_ball(flights, ball or Ball(), name if owners else None, tell)
        except RefusedTableError as error:
            parts[name] = refused(str(error))
            continue
        parts[name] = _noted(found, table.notes)
        if tell is not None:
            tell(f"{name}: {found.verdict.value}")
    return combined(parts)


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


def _listed(names: str | None) -> list[str]:
    return [] if names is None else [name.strip() for name in names.split(",") if name.strip()]


def _group_labels(table: Table, group: str | None) -> list[str]:
    """One label a row from all group columns."""
    columns = [table.labels(name) for name in _listed(group)]
    if not columns:
        return [""] * table.row_count
    return [" ".join(cells) for cells in zip(*columns, strict=True)]


def _guessed_output(table: Table) -> tuple[list[str], bool]:
    """A position column if exactly one fits, else a velocity column."""
    try:
        return [table.guess("position", "--position", POSITION_WORDS)], False
    except RefusedTableError:
        return [
            table.guess("position or velocity", "--position or --velocity", VELOCITY_WORDS)
        ], True


def _guessed_axes(table: Table) -> list[str]:
    """x, y, z by name, or x and y of a film (y is up), or a height."""
    by_name: dict[str, str] = {}
    for name in table.columns:
        first = name.strip().lower().replace("[", "_").replace("(", "_").split("_")[0].strip()
        by_name.setdefault(first, name)
    for wanted in (("x", "y", "z"), ("x", "z"), ("x", "y")):
        if all(letter in by_name for letter in wanted):
            names = [by_name[letter] for letter in wanted]
            table.notes.append(f"columns {', '.join(names)} taken as position, {names[-1]!r} as up")
            return names
    return [table.guess("height", "--z", HEIGHT_WORDS)]


def _metres(table: Table, name: str, unit: str) -> float:
    """Metres in a column's unit."""
    if unit != "auto":
        return LENGTHS_M[unit]
    words = "".join(c.lower() if c.isalnum() else " " for c in name).split()
    named = [word for word in words[1:] if word in LENGTHS_M]
    if named and named[-1] != "m":
        table.notes.append(f"{name!r} converted from {named[-1]} to m")
    return LENGTHS_M[named[-1]] if named else 1.0


def _in_radians(table: Table, name: str, values: Array, unit: AngleUnit) -> Array:
    """An angle column in rad; without a unit in its name, more than one turn means degrees."""
    degrees = has_degrees(name) if unit == "auto" else unit == "deg"
    if degrees is None:
        degrees = bool(np.nanmax(np.abs(values)) > 2.0 * math.pi + 0.1)
        seen = "degrees: it exceeds 2 pi" if degrees else "rad"
        table.notes.append(f"{name!r} taken as {seen}; --angle-unit says otherwise")
    return np.radians(values) if degrees else values


def _noted(found: Diagnosis, notes: Sequence[str]) -> Diagnosis:
    own = list(found.evidence.get("notes", []))
    unique = list(dict.fromkeys([*own, *notes]))
    return found.model_copy(update={"evidence": {**found.evidence, "notes": unique}})
