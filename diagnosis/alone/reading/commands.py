"""What a joint's command means: where it rests, what is full, and what it was between two rows of the log.

A lever that moves on is a line between its rows; one that jumps keeps its value until the next row.
"""

from typing import Final, NamedTuple

import numpy as np

from diagnosis.alone.reading.motion import Motion
from diagnosis.alone.reading.runs import moves_on
from machine.conventions import Array

MIN_CHANGES_COUNT: Final = 20
"""Fewer changes of the command do not tell how often it was logged."""
LONGEST_COMMAND_PERIOD_S: Final = 0.2
"""Changes further apart are steps of whoever gave them, and no slow log."""
FULL_SCALES: Final = {
    **dict.fromkeys((1.0, 100.0), 0.7),
    **dict.fromkeys((127.0, 255.0, 1023.0, 1024.0, 32767.0), 0.9),
}
"""Ends of usual levers, bus signals and duty cycles, and the part of them that a record must reach."""
RESTING_RATIO: Final = 0.3
"""Of the top speed: a joint that is faster at the most frequent command does not rest there."""


class Command(NamedTuple):
    """How a column of commands is read."""

    rest: float
    full: float
    """Distance from rest to full command, in the column's unit."""
    is_smooth: bool
    period_s: float
    """How often it was logged."""
    notes: tuple[str, ...]

    def on_grid(self, motion: Motion, grid_s: Array) -> Array:
        """(ticks,) what it was on the average from each tick to the next, rest at 0 and full at 1.

        Between two runs the joint rests: what it did then is not known, and not compared.
        """
        time_s = motion.time_s - motion.time_s[0]
        held = np.clip(np.searchsorted(time_s, grid_s + 1e-9, side="right") - 1, 0, None)
        ahead = np.clip(held + 1, 0, len(time_s) - 1)
        if self.is_smooth:
            values = np.interp(grid_s + 0.5 * float(grid_s[1]), time_s, motion.command)
        else:
            values = _mean_held(time_s, motion.command, grid_s)
        inside = motion.run[held] == motion.run[ahead]
        return np.where(inside, values - self.rest, 0.0) / self.full


def _mean_held(time_s: Array, command: Array, grid_s: Array) -> Array:
    """(ticks,) mean over each tick of a command that keeps its value until its next row."""
    passed = np.concatenate([[0.0], np.cumsum(command[:-1] * np.diff(time_s))])
    ends_s = np.append(grid_s, grid_s[-1] + grid_s[1])
    total = np.interp(ends_s, time_s, passed) + command[-1] * np.maximum(ends_s - time_s[-1], 0.0)
    mean = np.diff(total) / np.diff(ends_s)
    # Where nothing changes within the tick it is that value to the last bit: rest stays rest.
    first = np.clip(np.searchsorted(time_s, grid_s + 1e-9, side="right") - 1, 0, None)
    last = np.clip(np.searchsorted(time_s, ends_s[1:] - 1e-9, side="right") - 1, 0, None)
    changes = np.concatenate([[0], np.cumsum(np.diff(command) != 0.0)])
    return np.where(changes[last] == changes[first], command[first], mean)


def read_command(motion: Motion, words: tuple[str, ...], period_s: float) -> Command:
    """Find a command's rest and scale.

    Args:
        motion: the joint's record.
        words: of the column's name and unit.
        period_s: median sample period.
    """
    rest, note = _rest(motion)
    notes = [note]
    largest = float(np.max(np.abs(motion.command - rest)))
    full = _full(largest, words) if rest == 0.0 else largest
    kind = "the largest of the record" if full == largest else f"the largest here is {largest:.4g}"
    notes.append(f"full command taken as {full:.4g} ({kind}): parts of command are of that")
    is_smooth = moves_on(motion.command)
    return Command(rest, full, is_smooth, _period(motion, period_s), tuple(notes))


def _full(largest: float, words: tuple[str, ...]) -> float:
    """The scale's end if the largest command comes near it, else the largest command."""
    if {"pct", "percent"} & set(words) and largest <= 100.0:
        return 100.0
    for end, ratio in FULL_SCALES.items():
        if ratio * end <= largest <= end:
            return end
    return largest


def _period(motion: Motion, period_s: float) -> float:
    """Shortest usual time between two changes of the logged command, s; at least the sample period."""
    changes = motion.time_s[1:][np.diff(motion.command) != 0.0]
    period_s = max(period_s, motion.told_period_s)
    if changes.size < MIN_CHANGES_COUNT:
        return period_s
    shortest = float(np.quantile(np.diff(changes), 0.1))
    return period_s if shortest > LONGEST_COMMAND_PERIOD_S else max(shortest, period_s)


def _rest(motion: Motion) -> tuple[float, str]:
    """The command at which the joint rests, and why."""
    u = motion.command
    if np.min(u) <= 0.0 <= np.max(u) and (np.min(u) < 0.0 or np.mean(u == 0.0) > 0.02):
        return 0.0, "command 0 taken as rest"
    values, counts = np.unique(np.round(u, 9), return_counts=True)
    common = int(np.argmax(counts))
    if counts[common] > 0.05 * len(u):
        rest = float(values[common])
        if _is_at_rest(motion, rest):
            return rest, f"command {rest:g} taken as rest: its most frequent value"
        turning = _turning_command(motion)
        if turning is not None:
            return turning, f"command {turning:.4g} taken as rest: the joint turns around there"
    if np.min(u) > 0.0 and np.min(u) < 0.1 * np.max(u):
        return 0.0, "command 0 taken as rest"
    middle = 0.5 * float(np.min(u) + np.max(u))
    return middle, f"command {middle:g} taken as rest: the middle of its range"


def _speed(motion: Motion) -> Array:
    """(rows,) speed over about a quarter of a second, rough."""
    if motion.is_speed:
        return motion.output
    period_s = float(np.median(np.diff(motion.time_s)))
    half = max(1, round(0.125 / period_s))
    low = np.clip(np.arange(len(motion.time_s)) - half, 0, None)
    high = np.clip(np.arange(len(motion.time_s)) + half, None, len(motion.time_s) - 1)
    moved = motion.output[high] - motion.output[low]
    return moved / np.maximum(motion.time_s[high] - motion.time_s[low], 1e-9)


def _is_at_rest(motion: Motion, rest: float) -> bool:
    """Whether the joint hardly moves while the command is at `rest`."""
    speed = np.abs(_speed(motion))
    top = float(np.quantile(speed, 0.95))
    return float(np.median(speed[np.abs(motion.command - rest) < 1e-9])) < RESTING_RATIO * top


def _turning_command(motion: Motion) -> float | None:
    """The command at which a line through speed over command crosses zero; None if there is no such line."""
    slope, offset = np.polyfit(motion.command, _speed(motion), 1)
    if slope == 0.0:
        return None
    zero = float(-offset / slope)
    return zero if np.min(motion.command) < zero < np.max(motion.command) else None
