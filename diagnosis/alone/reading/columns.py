"""Which columns hold what, and in which unit: times, commands, angles, positions, labels.

A column is guessed only when one alone fits, and every guess is noted.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Final, Literal

import numpy as np

from diagnosis.alone.reading.layout import RefusedTableError
from diagnosis.alone.reading.tables import Table, has_degrees, name_words
from machine.conventions import Array

AngleUnit = Literal["auto", "rad", "deg"]
LENGTHS_M: Final[Mapping[str, float]] = {
    "m": 1.0,
    "cm": 0.01,
    "mm": 0.001,
    "ft": 0.3048,
    "in": 0.0254,
}
TIME_WORDS: Final = ("time", "t", "timestamp", "stamp", "seconds", "sec")
COMMAND_WORDS: Final = (
    *("command", "cmd", "joystick", "joy", "lever", "valve", "input", "u", "control", "setpoint"),
)
POSITION_WORDS: Final = ("position", "pos", "angle", "q", "theta", "extension", "encoder")
VELOCITY_WORDS: Final = ("velocity", "vel", "speed", "omega", "qd", "rate", "gyro")
ANGLE_WORDS: Final = ("angle", "theta", "swing", "pitch", "phi", "position", "pos", "encoder", "q")
HEIGHT_WORDS: Final = ("z", "height", "altitude", "alt", "h")
RUN_WORDS: Final = (
    *(
        "run",
        "trial",
        "test",
        "throw",
        "drop",
        "flight",
        "swing",
        "rep",
        "repetition",
        "take",
        "track",
    ),
    *("ball", "object", "id", "experiment", "group", "label", "set", "episode", "name"),
)
"""What a column of whole numbers that tells runs apart is called."""
_UNIT_WORDS: Final = frozenset(["rad", "deg", "m", "mm", "cm", "pct", "percent", "ratio", "norm"])


def listed(names: str | None) -> list[str]:
    """Column names between commas."""
    return [] if names is None else [name.strip() for name in names.split(",") if name.strip()]


def group_labels(table: Table, group: str | None) -> list[str]:
    """(rows,) what tells runs apart; without a group every row is of one."""
    if group is None:
        return [""] * table.row_count
    columns = [table.labels(name) for name in listed(group)]
    return [", ".join(texts) for texts in zip(*columns, strict=True)]


def found_groups(table: Table, used: Sequence[str]) -> tuple[str | None, str | None]:
    """Columns that look like a label of the body, and like the number of a run; noted.

    Raises:
        RefusedTableError: several columns of labels.
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
    """Whole numbers, few of them, each in one piece or nearly, and called like a run."""
    if not any(word.rstrip("s") in RUN_WORDS for word in name_words(name)):
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


def outputs_of(table: Table) -> tuple[list[str], bool]:
    """The position column, or failing that the velocity column, and whether it is a velocity."""
    try:
        return [table.guess("position", "--position or --velocity", POSITION_WORDS)], False
    except RefusedTableError as error:
        try:
            return [table.guess("velocity", "--velocity", VELOCITY_WORDS)], True
        except RefusedTableError:
            raise error from None


def axes_of(table: Table) -> list[str]:
    """x, y, z by name, or x and y of a film (y is up), or a height; failing that speeds along them."""
    by_name: dict[str, str] = {}
    for name in table.columns:
        words = name_words(name)
        first = next((w for w in words if w not in ("pos", "position", "ball", "com")), "")
        if not is_velocity(table, name):
            by_name.setdefault(first, name)
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
        if not is_velocity(table, name) and any(w in HEIGHT_WORDS for w in name_words(name))
    ]
    if len(heights) == 1:
        table.notes.append(f"column {heights[0]!r} taken as the height")
        return heights
    return [table.guess("height", "--z", HEIGHT_WORDS)]


def pairs_of(table: Table) -> tuple[list[str], list[str]]:
    """Commands and positions of several joints, paired by the joint in their names; empty if not so.

    ``boom_cmd, arm_cmd, boom_pos, arm_pos`` and ``u1, q1, u2, q2`` pair up.
    """
    commands = _stems(table, COMMAND_WORDS)
    positions = _stems(table, POSITION_WORDS)
    if len(commands) < 2 or set(commands) != set(positions):
        return [], []
    chosen = [commands[stem] for stem in commands], [positions[stem] for stem in commands]
    pairs = ", ".join(f"{c} with {p}" for c, p in zip(*chosen, strict=True))
    table.notes.append(f"joints by their names: {pairs}")
    return chosen


def _stems(table: Table, words: Sequence[str]) -> dict[str, str]:
    """Columns of a kind by what is left of their names without kind and unit."""
    found: dict[str, str] = {}
    for name in table.columns:
        parts = [w for part in name_words(name) for w in _letters_and_digits(part)]
        if any(part in words for part in parts):
            stem = " ".join(w for w in parts if w not in words and w not in _UNIT_WORDS)
            if stem in found:
                return {}
            found[stem] = name
    return found


def _letters_and_digits(word: str) -> list[str]:
    digits = word.lstrip("abcdefghijklmnopqrstuvwxyz")
    return [w for w in (word[: len(word) - len(digits)], digits) if w]


def angle_of(table: Table) -> str:
    """The angle column, or failing that a rate of turn."""
    try:
        return table.guess("angle", "--angle", ANGLE_WORDS)
    except RefusedTableError:
        rates = [name for name in table.columns if is_turn_rate(table, name)]
        if len(rates) == 1:
            return rates[0]
        raise


def is_turn_rate(table: Table, name: str) -> bool:
    """Whether a column's name or unit says that it is an angular velocity."""
    words = table.words(name)
    units = (["rad", "per", "s"], ["deg", "per", "s"])
    return (
        any(word in ("omega", "gyro", "rate", "velocity", "vel", "qd", "dps") for word in words)
        or words[-2:] in (["rad", "s"], ["deg", "s"])
        or words[-3:] in units
    )


def is_velocity(table: Table, name: str) -> bool:
    """Whether a column's name or unit says that it is a speed."""
    words = table.words(name)
    text = "".join(words)
    return (
        any(word in ("velocity", "vel", "speed", "vx", "vy", "vz") for word in words)
        or words[-3:] in (["m", "per", "s"], ["mm", "per", "s"], ["cm", "per", "s"])
        or (len(words) > 2 and words[-2:] in (["m", "s"], ["cm", "s"], ["mm", "s"]))
        or text.endswith(("mps", "ms1"))
    )


def metres(table: Table, name: str, unit: str) -> float:
    """Metres in a column's unit."""
    if unit != "auto":
        return LENGTHS_M[unit]
    words = table.words(name)
    named = [word for word in words[1:] if word in LENGTHS_M]
    if any(word in ("px", "pixel", "pixels") for word in words):
        raise RefusedTableError(
            f"column {name!r} is in pixels: the scale decides how fast things fall. Convert it to metres "
            "with a known length in the plane of flight"
        )
    if named and named[-1] != "m":
        table.notes.append(f"{name!r} converted from {named[-1]} to m")
    return LENGTHS_M[named[-1]] if named else 1.0


def in_radians(table: Table, name: str, values: Array, unit: AngleUnit) -> Array:
    """An angle column in rad; without a unit in its name, more than one turn means degrees."""
    degrees = has_degrees(table.words(name)) if unit == "auto" else unit == "deg"
    if degrees is None:
        degrees = bool(np.nanmax(np.abs(values)) > 2.0 * math.pi + 0.1)
        seen = "degrees: it exceeds 2 pi" if degrees else "rad"
        table.notes.append(f"{name!r} taken as {seen}; --angle-unit says otherwise")
    return np.radians(values) if degrees else values


def integrated(time_s: Array, speed: Array) -> Array:
    """What a speed moves since its first row, (rows,), by trapezoids."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time_s))])
