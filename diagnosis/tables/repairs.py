"""Values of a column that mean something else: stand-ins for no value, wrapped integers, repeats of a film.

Every rule asks for a pattern that a motion does not make, and is noted with its count.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from machine.conventions import Array, BoolArray

STAND_INS: Final = (
    *(-99.0, 99.0, -999.0, 999.0, -9999.0, 9999.0, -99999.0, 99999.0, -999999.0, 999999.0),
    *(-32768.0, 32767.0, 65535.0, -2147483648.0, 2147483647.0, 4294967295.0, -1e10, 1e10),
    *(-999.25, -999.99, 999.99, -9999.99, 9999.99, -99.99, 99.99, -88888.0, 88888.0),
)
"""Values that programs write where there is no value."""
ISOLATION_RATIO: Final = 3.0
"""Distance of a stand-in from all other values, in ranges of the others."""
MIN_DISTINCT: Final = 3
"""Fewest other values; a switch has two."""
INTEGER_BITS: Final = (16, 32)
"""Sizes of wrapped integers."""
MIN_WRAPPED_DISTINCT: Final = 5
"""Fewest values at either end of an integer's range; a switch has one."""
REPEATED_RATIO: Final = 0.4
"""Share of rows that repeat the row before from which frames are repeated."""
MIN_PLACES: Final = 5
"""Fewest places of a body that moves."""
LOST_JUMP_RATIO: Final = 5.0
"""Distance of lost detections from the rows beside them, in median steps of the track."""
LOST_PLACES: Final = (0.0, -1.0)
"""Coordinates that trackers write for a body that they do not see."""


def find_stand_ins(values: Array) -> tuple[BoolArray, tuple[float, ...]]:
    """Mask of the rows that hold a stand-in, (rows,), and the stand-ins."""
    found = np.zeros(len(values), dtype=np.bool_)
    used: list[float] = []
    distinct = np.unique(values[np.isfinite(values)])
    for end in (0, -1, 0, -1):
        candidate = float(distinct[end]) if distinct.size > MIN_DISTINCT else 0.0
        others = distinct[1:] if end == 0 else distinct[:-1]
        if candidate not in STAND_INS:
            continue
        distance = float(np.min(np.abs(others - candidate)))
        if distance > ISOLATION_RATIO * float(np.ptp(others)):
            found |= values == candidate
            used.append(candidate)
            distinct = others
    return found, tuple(used)


def restore_sign(values: Array) -> tuple[Array, int] | None:
    """Values of a signed integer that was logged as unsigned, and its bits; None if they are none.

    They jump between the ends of the range and leave its middle half empty.
    """
    known = values[np.isfinite(values)]
    if known.size < 2 or np.min(known) < 0.0 or np.any(known != np.round(known)):
        return None
    for bits in INTEGER_BITS:
        size = 2.0**bits
        is_empty = not np.any((known > 0.25 * size) & (known < 0.75 * size))
        is_high = known >= 0.5 * size
        ends = min(len(np.unique(known[part])) for part in (is_high, ~is_high))
        if np.max(known) < size and is_empty and ends >= MIN_WRAPPED_DISTINCT:
            return np.where(values >= 0.5 * size, values - size, values), bits
    return None


def find_lost_detections(columns: Sequence[Array]) -> tuple[BoolArray, float]:
    """Mask of the rows of a track where the body was lost, (rows,), and the coordinate written there."""
    track = np.stack(columns, axis=1)
    for place in LOST_PLACES:
        lost = np.all(track == place, axis=1)
        seen = track[~lost & np.all(np.isfinite(track), axis=1)]
        if not np.any(lost) or len(seen) < 2:
            continue
        step = float(np.median(np.linalg.norm(np.diff(seen, axis=0), axis=1)))
        edges = np.flatnonzero(lost[1:] != lost[:-1])
        jumps = np.linalg.norm(track[edges + 1] - track[edges], axis=1)
        jumps = jumps[np.isfinite(jumps)]
        if jumps.size and float(np.median(jumps)) > LOST_JUMP_RATIO * step:
            return lost, place
    return np.zeros(len(track), dtype=np.bool_), 0.0


def find_repeated_frames(columns: Sequence[Array]) -> BoolArray:
    """Mask of the rows that repeat the row before, (rows,); all False unless most frames do.

    A body that rests repeats one row often, a repeated film repeats every row a few times.
    """
    track = np.stack(columns, axis=1)
    repeats = np.concatenate([[False], np.all(track[1:] == track[:-1], axis=1)])
    starts = np.flatnonzero(~repeats)
    lengths = np.diff(np.append(starts, len(repeats)))
    is_moving = len(lengths) > MIN_PLACES
    is_film = is_moving and np.mean(repeats) > REPEATED_RATIO and np.median(lengths) >= 2.0
    return repeats if is_film else np.zeros(len(repeats), dtype=np.bool_)
