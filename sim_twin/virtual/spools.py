"""Valves of the virtual machine, from command to orifice opening: dead time, hysteresis, lag, dead band."""

import numpy as np

from machine.conventions import ACTIVE_COUNT, Array
from sim_twin.virtual.units import MachineUnit, ThrowConditions

FULL_STROKE_S = 0.10
"""Fastest full stroke of a spool (servo-piloted main stage, assumed)."""
MAX_DEAD_TIME_S = 0.30
SHORTEST_LAG_S = 0.01
"""Lower bound of the lag."""


class Spools:
    """Four spools on each of N machines; arrays (N, 4), joint order, -1..1, positive moves positively."""

    def __init__(self, unit: MachineUnit, count: int, step_s: float) -> None:
        self._step_s = step_s
        self._shape = (count, ACTIVE_COUNT)
        self._allocate_ring(MAX_DEAD_TIME_S)
        self._cells = np.arange(count * ACTIVE_COUNT).reshape(self._shape)
        self._dead_time_s = np.asarray(unit.dead_time_s)
        self._play = np.asarray(unit.hysteresis_ratio)
        band = np.stack([unit.dead_band_positive_ratio, unit.dead_band_negative_ratio])[:, None, :]
        self._band = band
        self._stretch = 1.0 / (1.0 - band)
        curve = np.asarray(unit.metering_curve_ratio)
        self._curve_linear, self._curve_square = 1.0 - curve, curve
        self._stage = np.zeros(self._shape)
        self.position_ratio = np.zeros(self._shape)
        self.opening_ratio = np.zeros((2, *self._shape))
        """(2, N, 4) open share of the metering edges that move the joint positively [0], negatively [1]."""
        self._delayed = np.zeros(self._shape)
        self._work = np.zeros(self._shape)
        self._low, self._high = np.zeros(self._shape), np.zeros(self._shape)
        self._square = np.zeros_like(self.opening_ratio)
        self._head = 0
        self._back = np.zeros(self._shape, dtype=np.int64)
        self._cells_now = np.zeros(self._shape, dtype=np.int64)
        self._gain = np.zeros(self._shape)
        self._lag_s = np.asarray(unit.spool_lag_s)
        self._max_move = step_s / FULL_STROKE_S

    def _allocate_ring(self, max_dead_time_s: float) -> None:
        self._depth = int(np.ceil(max_dead_time_s / self._step_s)) + 2
        self._ring = np.zeros((self._depth, *self._shape))
        self._ring_flat = self._ring.reshape(-1)

    def wear(
        self,
        dead_time_s: Array,
        lag_s: Array,
        band_ratio: Array,
        play_ratio: Array,
    ) -> None:
        """Add dead times, lags, hysteresis (N, 4) and overlaps (2, N, 4).

        Additional overlap is not compensated by a steeper opening curve.
        """
        self._dead_time_s = self._dead_time_s + dead_time_s
        self._allocate_ring(max(MAX_DEAD_TIME_S, float(self._dead_time_s.max()) + 0.01))
        self._lag_s = np.maximum(self._lag_s + lag_s, SHORTEST_LAG_S)
        self._band = self._band + band_ratio
        self._play = self._play + play_ratio

    def reset(self, conditions: ThrowConditions) -> None:
        """Centre all spools, discard delayed commands and set the throw's conditions."""
        self._ring[:] = 0.0
        self._stage[:] = 0.0
        self.position_ratio[:] = 0.0
        dead_s = np.maximum(self._dead_time_s + conditions.dead_time_offset_s, 0.0)
        dead = np.minimum(np.rint(dead_s / self._step_s).astype(np.int64), self._depth - 1)
        # Flat index of the cell written `dead` steps ago, relative to the head's row.
        self._back = self._cells - dead * self._cells.size
        self._gain = 1.0 - np.exp(-self._step_s / (self._lag_s * conditions.lag_ratio))

    def step(self, command_ratio: Array) -> Array:
        """Advance the spools one step with commands (N, 4); return the openings (2, N, 4)."""
        self._head = (self._head + 1) % self._depth
        self._ring[self._head] = command_ratio
        work, delayed = self._work, self._delayed
        np.add(self._back, self._head * self._cells.size, out=self._cells_now)
        self._ring_flat.take(self._cells_now, out=delayed, mode="wrap")
        # Hysteresis of width 2h (play operator).
        np.subtract(delayed, self._play, out=self._low)
        np.add(delayed, self._play, out=self._high)
        np.maximum(self._stage, self._low, out=self._stage)
        np.minimum(self._stage, self._high, out=self._stage)
        np.subtract(self._stage, self.position_ratio, out=work)
        np.multiply(work, self._gain, out=work)
        np.minimum(work, self._max_move, out=work)
        np.maximum(work, -self._max_move, out=work)
        np.add(self.position_ratio, work, out=self.position_ratio)
        opening = self.opening_ratio
        opening[0] = self.position_ratio
        np.negative(self.position_ratio, out=opening[1])
        np.subtract(opening, self._band, out=opening)
        np.maximum(opening, 0.0, out=opening)
        np.multiply(opening, self._stretch, out=opening)
        np.multiply(opening, self._curve_square, out=self._square)
        np.add(self._square, self._curve_linear, out=self._square)
        np.multiply(opening, self._square, out=opening)
        return opening
