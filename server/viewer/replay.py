"""Playing a throw in the view: what the machine and the load do at a moment, and the clock that moves it.

Pure; the caller passes the time. It draws nothing.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from machine.conventions import Array


@dataclass(frozen=True)
class ThrowMotion:
    """A throw as it is drawn: from a preview, or from a recorded throw."""

    frames_rad_m: Array
    """Joint positions at equal times, shape (T, 6), joint order of machine.conventions."""
    frame_period_s: float
    ball_path_m: Array
    """Path of the load from release to impact at equal times, shape (M, 3), frame `machine`."""
    release_s: float | None = None
    """When the load leaves; None when it never does."""
    flight_s: float = 0.0

    def __post_init__(self) -> None:
        if (
            self.frames_rad_m.ndim != 2
            or self.frames_rad_m.shape[1] != 6
            or self.frame_period_s <= 0
        ):
            raise ValueError(
                f"A motion needs frames of shape (T, 6) and a period above 0, got "
                f"{self.frames_rad_m.shape} and {self.frame_period_s} s."
            )

    @property
    def duration_s(self) -> float:
        """From the first frame to the last frame or the impact, whichever is later."""
        machine = (len(self.frames_rad_m) - 1) * self.frame_period_s
        if self.release_s is None:
            return machine
        return max(machine, self.release_s + self.flight_s)


@dataclass(frozen=True)
class Moment:
    """Machine and load at one time."""

    joints_rad_m: Array
    """Shape (6,)."""
    ball_m: tuple[float, float, float] | None
    """The load once it has left, frame `machine`; None while it is held."""


def moment(motion: ThrowMotion, at_s: float) -> Moment:
    """Interpolate a motion linearly at a time after its start, s; times outside are clamped."""
    frames = motion.frames_rad_m
    position = min(max(at_s, 0.0) / motion.frame_period_s, float(len(frames) - 1))
    index = min(int(position), max(len(frames) - 2, 0))
    u = position - index
    joints = frames[index] + u * (frames[min(index + 1, len(frames) - 1)] - frames[index])
    return Moment(np.asarray(joints, dtype=np.float64), _ball(motion, at_s))


def _ball(motion: ThrowMotion, at_s: float) -> tuple[float, float, float] | None:
    path = motion.ball_path_m
    if motion.release_s is None or at_s < motion.release_s or len(path) == 0:
        return None
    if motion.flight_s <= 0.0 or len(path) == 1:
        x, y, z = path[-1]
        return float(x), float(y), float(z)
    place = min((at_s - motion.release_s) / motion.flight_s, 1.0) * (len(path) - 1)
    index = min(int(place), len(path) - 2)
    x, y, z = path[index] + (place - index) * (path[index + 1] - path[index])
    return float(x), float(y), float(z)


@dataclass
class Playback:
    """A motion with time control. `now_s` is any monotonic clock."""

    motion: ThrowMotion
    is_playing: bool = True
    speed_ratio: float = 1.0
    at_s: float = 0.0
    _last_s: float = field(default=math.nan, repr=False)
    _end_s: float = field(default=math.nan, repr=False)

    def advance(self, now_s: float) -> Moment:
        """Move on to `now_s` and return what is to be drawn; stops at the end."""
        if self.is_playing and math.isfinite(self._last_s):
            self.at_s += (now_s - self._last_s) * self.speed_ratio
            if self.at_s >= self.motion.duration_s:
                self.at_s, self.is_playing = self.motion.duration_s, False
                self._end_s = now_s
        self._last_s = now_s
        return moment(self.motion, self.at_s)

    def ended_for_s(self, now_s: float) -> float:
        """How long ago playing reached the end; negative while it has not."""
        return now_s - self._end_s if math.isfinite(self._end_s) and not self.is_playing else -1.0

    def seek(self, at_s: float) -> None:
        """Jump to a time after the start, clamped to the motion."""
        self.at_s = min(max(at_s, 0.0), self.motion.duration_s)

    def play(self, is_playing: bool, speed_ratio: float = 1.0) -> None:
        """Play or pause; playing on from the end starts over."""
        if is_playing and self.at_s >= self.motion.duration_s:
            self.at_s = 0.0
        self.is_playing = is_playing
        self.speed_ratio = min(max(speed_ratio, 0.05), 8.0)
