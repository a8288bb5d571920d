"""Which column of a table tells the time: by its name, by its numbers, from two columns or from frames.

Frame numbers of a film need the frames a second; what was assumed is noted.
"""

from typing import Final

import numpy as np

from diagnosis.alone.reading.layout import RefusedTableError
from diagnosis.alone.reading.tables import Table
from machine.conventions import Array

TIME_WORDS: Final = (
    *("time", "t", "timestamp", "stamp", "seconds", "sec", "secs", "epoch", "clock", "datetime"),
    *("date", "millis", "micros", "elapsed", "zeit", "zeitstempel", "temps", "tiempo", "tempo"),
)
FRAME_WORDS: Final = ("frame", "frames", "framenumber", "image", "bild")
_SECONDS: Final = ("sec", "secs", "seconds")
_NANOSECONDS: Final = ("nsec", "nsecs", "nanosec", "nanosecs", "nanoseconds")
STEADY_RATIO: Final = 0.98
"""A column of which as many steps go up, and as much as its median step within a factor of 3, is a clock."""


def time_of(table: Table, given: str | None, fps: float | None = None) -> str:
    """The column of times.

    Args:
        table: of anybody's.
        given: its name, if the user gave one.
        fps: frames a second of the film; the column, or the rows, then count frames.

    Raises:
        RefusedTableError: no column is a clock, or it counts frames whose rate is not known.
    """
    if fps is not None:
        return _frames(table, given, fps)
    if given is not None:
        name = table.column(given)
        if _counts_frames(table, name):
            raise _frames_error(table, name)
        return name
    if (pair := _two_parts(table)) is not None:
        return pair
    found = [n for n in table.columns if any(w in TIME_WORDS for w in table.words(n))]
    found = [n for n in found if not _counts_frames(table, n)]
    if not found:
        return _steady(table)
    if len(found) > 1:
        exact = [n for n in found if n.strip().lower() in TIME_WORDS]
        first = [n for n in found if table.words(n)[0] in TIME_WORDS]
        found = exact if len(exact) == 1 else first if len(first) == 1 else found
    if len(found) > 1 and all(table.labels(n) == table.labels(found[0]) for n in found[1:]):
        found = found[:1]  # the same times twice
    if len(found) > 1:
        raise RefusedTableError(
            f"which column of {table.path.name} is the time? It has {', '.join(table.columns)} "
            f"({' and '.join(found)} would fit); give --time COLUMN"
        )
    table.notes.append(f"column {found[0]!r} taken as the time")
    return found[0]


def _counts_frames(table: Table, name: str) -> bool:
    return any(word in FRAME_WORDS for word in table.words(name))


def _frames_error(table: Table, name: str) -> RefusedTableError:
    return RefusedTableError(
        f"column {name!r} of {table.path.name} counts frames: how many a second decides how fast "
        "things fall. Give --fps (24, 30, 60, 240...: the rate at which the film was taken)"
    )


def _frames(table: Table, given: str | None, fps: float) -> str:
    """A column of times made of frame numbers; of the rows, when no column counts frames."""
    named = [name for name in table.columns if _counts_frames(table, name)]
    source = given or (named[0] if len(named) == 1 else None)
    numbers = np.arange(table.row_count) if source is None else table.numbers(source)
    what = "rows" if source is None else f"{source!r}"
    table.notes.append(f"{what} taken as frames at {fps:g} a second")
    table.derived["time of frames, s"] = numbers / fps
    return "time of frames, s"


def _two_parts(table: Table) -> str | None:
    """Seconds and nanoseconds in two columns, as robots log them, made one; None without them."""
    whole = [n for n in table.columns if table.words(n)[-1:] and table.words(n)[-1] in _SECONDS]
    parts = [n for n in table.columns if table.words(n)[-1:] and table.words(n)[-1] in _NANOSECONDS]
    if len(whole) != 1 or len(parts) != 1:
        return None
    seconds = table.numbers(whole[0])
    table.derived["time, s"] = seconds - seconds[0] + 1e-9 * table.numbers(parts[0])
    table.notes.append(f"columns {whole[0]!r} and {parts[0]!r} taken together as the time")
    return "time, s"


def _steady(table: Table) -> str:
    """The only column whose numbers go up steadily."""
    frames = [name for name in table.columns if _counts_frames(table, name)]
    if len(frames) == 1:
        raise _frames_error(table, frames[0])
    found = [name for name in table.columns if table.is_numeric(name) and _is_steady(table, name)]
    if len(found) != 1:
        seen = "none goes up steadily" if not found else f"{' and '.join(found)} go up steadily"
        raise RefusedTableError(
            f"which column of {table.path.name} is the time? It has {', '.join(table.columns)} ({seen}); "
            "give --time COLUMN, or --fps if each row is a frame of a film"
        )
    table.notes.append(f"column {found[0]!r} taken as the time: its numbers go up steadily")
    return found[0]


def _is_steady(table: Table, name: str) -> bool:
    values = table.numbers(name)
    if np.mean(np.isfinite(values)) < STEADY_RATIO:
        return False
    steps: Array = np.diff(values)
    typical = float(np.nanmedian(steps))
    good = (steps > 0.3 * typical) & (steps < 3.0 * typical)
    return typical > 0.0 and float(np.mean(good)) > STEADY_RATIO
