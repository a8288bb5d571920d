"""Which columns hold what: commands, angles, positions, speeds, labels of bodies and runs.

A column is guessed only when one alone fits, and every guess is noted.
"""

from collections.abc import Collection, Sequence
from typing import Final

import numpy as np

from diagnosis.alone.reading.layout import RefusedTableError
from diagnosis.alone.reading.tables import Table, has_degrees, name_words
from diagnosis.alone.reading.units import LENGTHS_M
from machine.conventions import Array

COMMAND_WORDS: Final = (
    *("command", "cmd", "joystick", "joy", "lever", "valve", "input", "u", "control", "setpoint"),
    *("pwm", "duty", "throttle", "js", "ansteuerung", "hebel", "ventil", "stellgröße"),
)
REFERENCE_WORDS: Final = (
    "reference",
    "ref",
    "desired",
    "target",
    "demand",
    "request",
    "goal",
    "soll",
)
"""A wanted position or speed: the command of a servo, when no lever or valve was logged."""
WEAK_COMMAND_WORDS: Final = ("current", "voltage", "signal", "spannung", "strom")
POSITION_WORDS: Final = (
    *("position", "pos", "angle", "q", "theta", "extension", "encoder", "stroke", "winkel", "weg"),
    *("displacement", "counts", "hub"),
)
VELOCITY_WORDS: Final = (
    *("velocity", "vel", "speed", "omega", "qd", "rate", "gyro", "rpm", "dps", "drehzahl"),
)
AXIS_WORDS: Final = {
    **dict.fromkeys(("x", "px", "posx", "xpos", "east", "downrange", "carry"), "x"),
    **dict.fromkeys(("y", "py", "posy", "ypos", "north", "side", "lateral"), "y"),
    **dict.fromkeys(("z", "pz", "posz", "zpos", "up", "height", "altitude", "alt"), "z"),
}
NO_POSITION_WORDS: Final = (
    *("acc", "accel", "acceleration", "force", "rotation", "rot", "euler", "gyro", "dot"),
    *("error", "err", "std", "sd", "confidence", "spin"),
)
HEIGHT_WORDS: Final = ("z", "height", "altitude", "alt", "h", "höhe")
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
    *(
        "ball",
        "object",
        "id",
        "experiment",
        "shot",
        "rally",
        "group",
        "label",
        "set",
        "episode",
        "name",
    ),
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


def command_of(table: Table, time: str, output: str | None) -> str:
    """The column of commands: a lever or valve, else a wanted position, else a current or voltage."""
    without = {time, *([] if output is None else [output])}
    for words in (COMMAND_WORDS, REFERENCE_WORDS, WEAK_COMMAND_WORDS):
        if any(w in words for n in table.columns if n not in without for w in name_words(n)):
            return table.guess("command", "--command", words, without)
    return table.guess("command", "--command", COMMAND_WORDS, without)


def outputs_of(table: Table, used: Collection[str]) -> tuple[list[str], bool]:
    """The position column, or failing that the velocity column, and whether it is a velocity.

    Without a telling name: the only other column with a unit of motion, or the only other one that shares a
    word with the command.
    """
    words = {*COMMAND_WORDS, *REFERENCE_WORDS}
    commands = [n for n in table.columns if any(w in words for w in name_words(n))]
    without = {*used, *commands}
    try:
        return [table.guess("position", "--position or --velocity", POSITION_WORDS, without)], False
    except RefusedTableError as error:
        try:
            return [table.guess("velocity", "--velocity", VELOCITY_WORDS, without)], True
        except RefusedTableError:
            others = [n for n in table.columns if n not in without and table.is_numeric(n)]
            moving = [n for n in others if _has_motion_unit(table, n)]
            places = [n for n in moving if not _is_speed(table, n)]
            mine = {w for n in used for w in name_words(n)} - words
            alike = [n for n in others if mine & set(name_words(n))]
            for found in (others, moving, places, alike):
                if len(found) == 1:
                    what = "velocity" if _is_speed(table, found[0]) else "position"
                    table.notes.append(f"column {found[0]!r} taken as the {what}: no other fits")
                    return found, what == "velocity"
            raise error from None


def _is_speed(table: Table, name: str) -> bool:
    return is_velocity(table, name) or is_turn_rate(table, name)


def _has_motion_unit(table: Table, name: str) -> bool:
    words = table.words(name)
    return has_degrees(words) is not None or any(word in LENGTHS_M for word in words[1:])


def axes_of(table: Table) -> list[str]:
    """x, y, z by name, or x and y of a film (y is up), or a height; failing that speeds along them."""
    by_name: dict[str, str] = {}
    for name in table.columns:
        words = name_words(name)
        letter = next((AXIS_WORDS[w] for w in words if w in AXIS_WORDS), "")
        if not is_velocity(table, name) and not any(w in NO_POSITION_WORDS for w in words):
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


def is_turn_rate(table: Table, name: str) -> bool:
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
    """Whether a column's name or unit says that it is a speed."""
    words = table.words(name)
    text = "".join(words)
    return (
        any(word in ("velocity", "vel", "speed", "vx", "vy", "vz", "rpm") for word in words)
        or words[-3:] in (["m", "per", "s"], ["mm", "per", "s"], ["cm", "per", "s"])
        or (len(words) > 2 and words[-2:] in (["m", "s"], ["cm", "s"], ["mm", "s"]))
        or text.endswith(("mps", "ms1"))
    )


def integrated(time_s: Array, speed: Array) -> Array:
    """What a speed moves since its first row, (rows,), by trapezoids."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time_s))])
