"""Joints that stick: static friction of seals between a drive and its joint, for N machines at once.

While a joint stands, its valve opens and the oil behind it comes under pressure as if it moved. So there is
hardly anything left to wait for when it breaks loose: on the spring of its oil it soon is as fast as a joint
that never stuck. How it rings about that for a tenth of a second is the pressures' doing: the twin has none.
"""

import math

import numpy as np

from machine.conventions import CONTROL_PERIOD_S, Array, BoolArray

STOP_SHARE_RATIO = 0.1
"""A joint slower than this share of its breakaway speed, with too small a command, has stopped."""
STANDING_RAD_M_PER_S = 0.005
"""A joint that is measured to be slower over a tenth of a second stands: twice what sensors scatter then."""
VALVE_SHARE_RATIO = 0.8
"""Of the response's mean lag 2 z / w, the valve's. Oil behind a load rings at 0.1 to 0.3 of critical damping
and some 2 to 10 Hz, so that its own mean lag is short beside a valve's of 0.05 to 0.25 s."""
UNSURE_RATIO = 0.15
"""Static friction is not the same each time (it grows with the time at rest and falls with the speed of
loading, by tens of per cent). So near to the breakaway speed a measured joint says whether it is loose."""
GATHERING_S = 0.01
"""Time constant with which a loose joint gathers its speed: machines of this size ring at 5 to 30 Hz."""
LOOSE_RATIO = 0.5
"""Of the speed that it would have: a joint that is measured to be faster is loose."""


class Stiction:
    """Which joints stick; arrays (N, 4)."""

    def __init__(self, breakaway_rad_m_per_s: Array) -> None:
        self._breakaway = breakaway_rad_m_per_s
        shape = breakaway_rad_m_per_s.shape
        self._rests = np.ones(shape, dtype=np.bool_)
        self._missing_ratio = np.zeros(shape)
        self._push, self._seen_before = np.zeros(shape), np.zeros(shape)

    def reset(self) -> None:
        """All joints stand."""
        self._rests[:] = True
        self._missing_ratio[:] = 0.0
        self._push[:] = 0.0
        self._seen_before[:] = 0.0

    def on_velocity(
        self, target: Array, before: Array, velocity: Array, lag_s: Array, seen: Array | None
    ) -> Array:
        """Velocities (N, 4) of joints that stick.

        Args:
            target: steady speed of the command.
            before: velocity of a joint that never sticks, a tick ago.
            velocity: and now.
            lag_s: mean lag of the response.
            seen: measured velocity, which then says when a joint comes to rest, and when it breaks loose
                where the command leaves that open.
        """
        self._rests = self._rest(target, before, velocity, lag_s, seen)
        missing = self._missing_ratio * math.exp(-CONTROL_PERIOD_S / GATHERING_S)
        self._missing_ratio = np.where(self._rests, 1.0, missing)
        return velocity * (1.0 - self._missing_ratio)

    def _rest(
        self, target: Array, before: Array, velocity: Array, lag_s: Array, seen: Array | None
    ) -> BoolArray:
        # What pushes follows the command as late as the valve does.
        late_s = np.maximum(VALVE_SHARE_RATIO * lag_s, 1e-6)
        self._push = target + np.exp(-CONTROL_PERIOD_S / late_s) * (self._push - target)
        if seen is None:
            slow = np.abs(velocity) < STOP_SHARE_RATIO * self._breakaway
            stops, least = slow | (before * velocity <= 0.0), self._breakaway
        else:
            stops = (np.abs(seen) < STANDING_RAD_M_PER_S) | (self._seen_before * seen <= 0.0)
            self._seen_before = seen
            speed = np.maximum(LOOSE_RATIO * np.abs(velocity), STANDING_RAD_M_PER_S)
            is_loose = self._rests & (np.sign(velocity) * seen > speed)
            least = self._breakaway * np.where(is_loose, 1.0 - UNSURE_RATIO, 1.0 + UNSURE_RATIO)
        small = (self._breakaway > 0.0) & (np.abs(self._push) <= least)
        return small & (self._rests | stops)
