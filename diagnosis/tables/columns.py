"""Find the columns of a table: time, commands, positions, velocities, axes, labels of bodies and runs.

A column is guessed by its name or its values only if exactly one fits. Every guess is noted.
"""

from collections.abc import Collection, Sequence
from typing import Final

import numpy as np

from diagnosis.tables.cells import RefusedTableError
from diagnosis.tables.column_units import LENGTHS_M
from diagnosis.tables.table import Table, radians_per_unit, split_name
from machine.conventions import Array

TIME_WORDS: Final = (
    *("time", "t", "timestamp", "stamp", "seconds", "sec", "secs", "epoch", "clock", "datetime"),
    *("date", "millis", "micros", "elapsed", "zeit", "zeitstempel", "datum", "uhrzeit", "temps"),
    *("tiempo", "tempo"),
)
"""Names of time columns."""
FRAME_WORDS: Final = ("frame", "frames", "framenumber", "image", "bild")
"""Names of columns of frame numbers."""
_SECONDS: Final = ("sec", "secs", "seconds")
_NANOSECONDS: Final = ("nsec", "nsecs", "nanosec", "nanosecs", "nanoseconds")
EVEN_STEPS_RATIO: Final = 0.98
"""Share of the steps of a time column that must be within 0.3 to 3 times the median step."""
COMMAND_WORDS: Final = (
    *("command", "cmd", "joystick", "joy", "lever", "valve", "input", "u", "control", "setpoint"),
    *("pwm", "duty", "throttle", "js", "ansteuerung", "hebel", "ventil", "stellgröße", "befehl"),
)
"""Names of lever and valve commands."""
REFERENCE_WORDS: Final = (
    *("reference", "ref", "desired", "target", "demand", "request", "goal", "soll", "sollwert"),
)
"""Names of reference positions or velocities: the command of a servo, if no lever or valve was logged."""
POSITION_WORDS: Final = (
    *("position", "pos", "angle", "q", "theta", "extension", "encoder", "stroke", "winkel"),
    *("weg", "displacement", "counts", "hub", "istwert"),
)
VELOCITY_WORDS: Final = (
    *("velocity", "vel", "speed", "omega", "qd", "rate", "gyro", "rpm", "dps", "drehzahl"),
)
AXIS_WORDS: Final = {
    **dict.fromkeys(("x", "px", "posx", "xpos", "east", "downrange", "carry"), "x"),
    **dict.fromkeys(("y", "py", "posy", "ypos", "north", "side", "lateral"), "y"),
    **dict.fromkeys(("z", "pz", "posz", "zpos", "up", "height", "altitude", "alt"), "z"),
}
"""Axis by column name."""
OTHER_QUANTITY_WORDS: Final = (
    *("acc", "accel", "acceleration", "force", "rotation", "rot", "euler", "gyro", "dot"),
    *("error", "err", "std", "sd", "confidence", "spin"),
)
"""Words of quantities that are not positions."""
HEIGHT_WORDS: Final = ("z", "height", "altitude", "alt", "h", "höhe")
RUN_WORDS: Final = (
    *("run", "trial", "test", "throw", "drop", "flight", "swing", "rep", "repetition", "take"),
    *("track", "ball", "object", "id", "experiment", "shot", "rally", "group", "label", "set"),
    *("episode", "name"),
)
"""Names of columns of whole numbers that label runs."""
_UNIT_WORDS: Final = frozenset(["rad", "deg", "m", "mm", "cm", "pct", "percent", "ratio", "norm"])


def find_time_column(table: Table, given: str | None, fps: float | None = None) -> str:
    """Name of the time column, which may be derived from others.

    Args:
        table: the table.
        given: its name, if the user gave one.
        fps: frames per second; the time column, or the row number, then counts frames.

    Raises:
        RefusedTableError: no column is a clock, several are, or frames are counted at an unknown rate.
    """
    if fps is not None:
        return _make_frame_times(table, given, fps)
    if given is not None:
        name = table.column(given)
        if _is_frame_column(table, name):
            raise _make_frame_rate_error(table, name)
        return name
    if (pair := _combine_seconds_and_nanoseconds(table)) is not None:
        return pair
    found = [n for n in table.columns if any(w in TIME_WORDS for w in table.words(n))]
    found = [n for n in found if not _is_frame_column(table, n)]
    if not found:
        return _find_steady_column(table)
    if len(found) == 2 and (made := table.add_times(*found) or table.add_times(*found[::-1])):
        return made
    if len(found) > 1:
        exact = [n for n in found if n.strip().lower() in TIME_WORDS]
        first = [n for n in found if table.words(n)[0] in TIME_WORDS]
        found = exact if len(exact) == 1 else first if len(first) == 1 else found
    if len(found) > 1 and all(table.labels(n) == table.labels(found[0]) for n in found[1:]):
        found = found[:1]  # duplicate columns
    if len(found) > 1:
        raise RefusedTableError(
            f"which column of {table.path.name} is the time? It has {', '.join(table.columns)} "
            f"({' and '.join(found)} would fit); give --time COLUMN"
        )
    table.notes.append(f"column {found[0]!r} taken as the time")
    return found[0]


def _is_frame_column(table: Table, name: str) -> bool:
    return any(word in FRAME_WORDS for word in table.words(name))


def _make_frame_rate_error(table: Table, name: str) -> RefusedTableError:
    return RefusedTableError(
        f"column {name!r} of {table.path.name} counts frames: how many a second decides how fast "
        "things fall. Give --fps (24, 30, 60, 240...: the rate at which the film was taken)"
    )


def _make_frame_times(table: Table, given: str | None, fps: float) -> str:
    """A derived time column from frame numbers, or from row numbers if no column counts frames."""
    named = [name for name in table.columns if _is_frame_column(table, name)]
    source = given or (named[0] if len(named) == 1 else None)
    numbers = np.arange(table.row_count) if source is None else table.numbers(source)
    what = "rows" if source is None else f"{source!r}"
    table.notes.append(f"{what} taken as frames at {fps:g} a second")
    table.derived["time of frames, s"] = numbers / fps
    return "time of frames, s"


def _combine_seconds_and_nanoseconds(table: Table) -> str | None:
    """A derived time column from one of seconds and one of nanoseconds; None without such a pair."""
    whole = [n for n in table.columns if table.words(n)[-1:] and table.words(n)[-1] in _SECONDS]
    parts = [n for n in table.columns if table.words(n)[-1:] and table.words(n)[-1] in _NANOSECONDS]
    if len(whole) != 1 or len(parts) != 1:
        return None
    seconds = table.numbers(whole[0])
    table.derived["time, s"] = seconds - seconds[0] + 1e-9 * table.numbers(parts[0])
    table.notes.append(f"columns {whole[0]!r} and {parts[0]!r} taken together as the time")
    return "time, s"


def _find_steady_column(table: Table) -> str:
    """The only column whose numbers increase in nearly even steps."""
    frames = [name for name in table.columns if _is_frame_column(table, name)]
    if len(frames) == 1:
        raise _make_frame_rate_error(table, frames[0])
    found = [
        name
        for name in table.columns
        if table.is_numeric(name) and not _is_motion(table, name) and _has_even_steps(table, name)
    ]
    paths = [name for name in table.columns if _is_motion(table, name)]
    if not found and len(paths) > 1:
        raise RefusedTableError(
            f"{table.path.name} has no column of times ({', '.join(table.columns)}): a path alone does not "
            "tell how fast it was. Give --time COLUMN, or --fps if each row is a frame of a film"
        )
    if len(found) != 1:
        seen = "none goes up steadily" if not found else f"{' and '.join(found)} go up steadily"
        raise RefusedTableError(
            f"which column of {table.path.name} is the time? It has {', '.join(table.columns)} ({seen}); "
            "give --time COLUMN, or --fps if each row is a frame of a film"
        )
    table.notes.append(f"column {found[0]!r} taken as the time: its numbers go up steadily")
    return found[0]


def _is_motion(table: Table, name: str) -> bool:
    """Whether a column's name says that it is a place, a velocity or a command."""
    words = split_name(name)
    known = (*AXIS_WORDS, *COMMAND_WORDS, *REFERENCE_WORDS, *POSITION_WORDS, *VELOCITY_WORDS)
    return any(word in known for word in words) or _has_motion_unit(table, name)


def _has_even_steps(table: Table, name: str) -> bool:
    values = table.values_if_numeric(name)
    if values is None or np.mean(np.isfinite(values)) < EVEN_STEPS_RATIO:
        return False
    steps: Array = np.diff(values)
    typical = float(np.nanmedian(steps))
    good = (steps > 0.3 * typical) & (steps < 3.0 * typical)
    return typical > 0.0 and float(np.mean(good)) > EVEN_STEPS_RATIO


def split_list(names: str | None, table: Table | None = None) -> list[str]:
    """Column names from a comma-separated list; commas within a column's own name do not separate."""
    parts = [] if names is None else [name.strip() for name in names.split(",") if name.strip()]
    own = {} if table is None else {_squeeze(name): name for name in table.columns if "," in name}
    found: list[str] = []
    while parts:
        joined = {k: _squeeze(",".join(parts[:k])) for k in range(len(parts), 0, -1)}
        size = next((k for k, text in joined.items() if text in own), 1)
        found.append(own.get(joined[size], parts[0]))
        parts = parts[size:]
    return found


def _squeeze(name: str) -> str:
    return ",".join(part.strip().lower() for part in name.split(","))


def group_labels(table: Table, group: str | None) -> list[str]:
    """Labels of the runs, (rows,); without a group all rows have the same label."""
    if group is None:
        return [""] * table.row_count
    columns = [table.labels(name) for name in split_list(group, table)]
    return [", ".join(texts) for texts in zip(*columns, strict=True)]


def find_group_columns(table: Table, used: Sequence[str]) -> tuple[str | None, str | None]:
    """The column that labels bodies and the column that numbers runs, None where there is none; noted.

    Raises:
        RefusedTableError: several columns hold labels.
    """
    others = [name for name in table.columns if name not in used]
    texts = [name for name in table.text_columns() if name in others]
    if len(texts) > 1:
        raise RefusedTableError(
            f"{table.path.name} has several columns of labels ({', '.join(texts)}): rows of different bodies "
            "would be mixed. Say which tells them apart: --group COLUMN (and more after commas for runs)"
        )
    runs = [name for name in others if name not in texts and _is_run_number(table, name)]
    owner = texts[0] if texts else None
    run = runs[0] if len(runs) == 1 else None
    if owner is not None:
        table.notes.append(f"column {owner!r} taken as what tells bodies apart (--group)")
    if run is not None:
        table.notes.append(f"column {run!r} taken as the number of a run")
    return owner, run


def _is_run_number(table: Table, name: str) -> bool:
    """Whether a column holds few distinct whole numbers in contiguous stretches and is named like a run."""
    if not any(word.rstrip("s") in RUN_WORDS for word in split_name(name)):
        return False
    try:
        values = table.numbers(name)
    except RefusedTableError:
        return False
    if not np.all(np.isfinite(values)) or np.any(values != np.round(values)):
        return False
    different = len(np.unique(values))
    changes = int(np.count_nonzero(np.diff(values)))
    return 1 < different <= len(values) / 10 and changes < len(values) / 10


def find_command_column(table: Table, time: str, output: str | None) -> str:
    """The command column: a lever or valve, else a reference position."""
    without = {time, *([] if output is None else [output])}
    for words in (COMMAND_WORDS, REFERENCE_WORDS):
        if any(w in words for n in table.columns if n not in without for w in split_name(n)):
            return table.guess("command", "--command", words, without)
    return table.guess("command", "--command", COMMAND_WORDS, without)


def find_output_columns(table: Table, used: Collection[str]) -> tuple[list[str], bool]:
    """The position column, else the velocity column, and whether it is a velocity.

    If no name fits: the only other column, or the only one with a unit of motion.
    """
    words = {*COMMAND_WORDS, *REFERENCE_WORDS}
    commands = [n for n in table.columns if any(w in words for w in split_name(n))]
    without = {*used, *commands}
    try:
        return [table.guess("position", "--position or --velocity", POSITION_WORDS, without)], False
    except RefusedTableError as error:
        try:
            return [table.guess("velocity", "--velocity", VELOCITY_WORDS, without)], True
        except RefusedTableError:
            others = [n for n in table.columns if n not in without and table.is_numeric(n)]
            moving = [n for n in others if _has_motion_unit(table, n)]
            places = [n for n in moving if not _is_velocity_or_rate(table, n)]
            for found in (others, moving, places):
                if len(found) == 1:
                    what = "velocity" if _is_velocity_or_rate(table, found[0]) else "position"
                    table.notes.append(f"column {found[0]!r} taken as the {what}: no other fits")
                    return found, what == "velocity"
            raise error from None


def _is_velocity_or_rate(table: Table, name: str) -> bool:
    return is_velocity(table, name) or is_angular_rate(table, name)


def _has_motion_unit(table: Table, name: str) -> bool:
    words = table.words(name)
    return radians_per_unit(words) is not None or any(word in LENGTHS_M for word in words[1:])


def find_axis_columns(table: Table) -> list[str]:
    """Columns x, y, z by name, or x and y of a video (y up), or a height; else the velocities."""
    by_name: dict[str, str] = {}
    for name in table.columns:
        words = split_name(name)
        letter = next((AXIS_WORDS[w] for w in words if w in AXIS_WORDS), "")
        if not is_velocity(table, name) and not any(w in OTHER_QUANTITY_WORDS for w in words):
            by_name.setdefault(letter, name)
    for wanted in (("x", "y", "z"), ("x", "z"), ("x", "y")):
        if all(letter in by_name for letter in wanted):
            names = [by_name[letter] for letter in wanted]
            table.notes.append(f"columns {', '.join(names)} taken as position, {names[-1]!r} as up")
            return names
    speeds = {name.strip().lower()[:2]: name for name in table.columns}
    for wanted in (("vx", "vy", "vz"), ("vx", "vz"), ("vx", "vy"), ("vz",)):
        if all(letter in speeds for letter in wanted):
            return [speeds[letter] for letter in wanted]
    heights = [
        name
        for name in table.columns
        if not is_velocity(table, name) and any(w in HEIGHT_WORDS for w in split_name(name))
    ]
    if len(heights) == 1:
        table.notes.append(f"column {heights[0]!r} taken as the height")
        return heights
    return [table.guess("height", "--z", HEIGHT_WORDS)]


def pair_joint_columns(table: Table) -> tuple[list[str], list[str]]:
    """Commands and positions of several joints, paired by the rest of their names; empty if they do not pair.

    ``boom_cmd, arm_cmd, boom_pos, arm_pos`` and ``u1, q1, u2, q2`` pair up.
    """
    commands = _joint_stems(table, COMMAND_WORDS)
    positions = _joint_stems(table, POSITION_WORDS)
    if len(commands) < 2 or set(commands) != set(positions):
        return [], []
    chosen = [commands[stem] for stem in commands], [positions[stem] for stem in commands]
    pairs = ", ".join(f"{c} with {p}" for c, p in zip(*chosen, strict=True))
    table.notes.append(f"joints by their names: {pairs}")
    return chosen


def _joint_stems(table: Table, words: Sequence[str]) -> dict[str, str]:
    """Columns whose name holds one of `words`, by the rest of the name without its unit."""
    found: dict[str, str] = {}
    for name in table.columns:
        parts = [w for part in split_name(name) for w in _split_digits(part)]
        if any(part in words for part in parts):
            stem = " ".join(w for w in parts if w not in words and w not in _UNIT_WORDS)
            if stem in found:
                return {}
            found[stem] = name
    return found


def _split_digits(word: str) -> list[str]:
    digits = word.lstrip("abcdefghijklmnopqrstuvwxyz")
    return [w for w in (word[: len(word) - len(digits)], digits) if w]


def is_angular_rate(table: Table, name: str) -> bool:
    """Whether a column's name or unit says that it is an angular velocity."""
    words = table.words(name)
    units = (["rad", "per", "s"], ["deg", "per", "s"])
    rates = ("omega", "gyro", "gyroscope", "rate", "velocity", "vel", "qd", "dps", "wx", "wy", "wz")
    return (
        any(word in rates for word in words)
        or words[-2:] in (["rad", "s"], ["deg", "s"])
        or words[-3:] in units
    )


def is_velocity(table: Table, name: str) -> bool:
    """Whether a column's name or unit says that it is a velocity."""
    words = table.words(name)
    text = "".join(words)
    return (
        any(word in ("velocity", "vel", "speed", "vx", "vy", "vz", "rpm") for word in words)
        or words[-3:] in (["m", "per", "s"], ["mm", "per", "s"], ["cm", "per", "s"])
        or (len(words) > 2 and words[-2:] in (["m", "s"], ["cm", "s"], ["mm", "s"]))
        or text.endswith(("mps", "ms1"))
    )
