"""Input and output of one driven joint over all logs: commanded steady speed and measured speed.

The logs are joined into one record with rests between them, so that one filter runs over all of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.loading.throw_data import ThrowData
from machine.calibration import actuator_ratio_magnitude
from machine.conventions import CONTROL_PERIOD_S, Array, BoolArray, IntArray
from machine.spec import MachineSpec

GAP_TICKS = 150
"""Rest between two logs, ticks; longer than the response that a log ends with."""
MOVED_RATIO = 0.08
MOVED_TICKS = 8
"""A log uses a direction when its command exceeds `MOVED_RATIO` of the joint's limit for this many ticks."""
LONGEST_BLOCK_S = 4.0
"""Logs longer than twice this are cut into blocks of about this length, s."""


@dataclass(frozen=True, slots=True)
class DriveRecord:
    """One joint over all logs; T ticks of 10 ms, rad and m."""

    steady: Array
    """(T,) joint speed that the valve tables give for the command at the joint's pose, or the velocity
    reference."""
    measured: Array
    """(T,) joint speed, moved onto the tick at which it was sampled."""
    valve_ratio: Array
    """(T,)"""
    actuator_ratio: Array
    """(T,) actuator speed over joint speed."""
    used: BoolArray
    """(T,) true inside a log, false in the rests."""
    block: IntArray
    """(T,) block of a tick, -1 in rests; blocks are the units that the bootstrap resamples."""
    block_count: int


def drive_record(
    throws: Sequence[ThrowData],
    spec: MachineSpec,
    joint: int,
    references: Sequence[Array] | None = None,
) -> DriveRecord:
    """The record of one driven joint; logs that do not move it are left out.

    Args:
        throws: the logs.
        spec: machine type.
        joint: index of the driven joint.
        references: (T, 4) per log, velocity references of the controller, used in place of the valve
            commands.
    """
    limit = spec.limits.speed_positive_rad_m_per_s[joint]
    columns: list[list[Array]] = [[], [], [], []]
    used: list[BoolArray] = []
    block: list[IntArray] = []
    count = 0
    for number, throw in enumerate(throws):
        ratio = actuator_ratio_magnitude(spec, throw.sensor_position_rad_m)[:, joint]
        table = throw.calibration.tables[joint]
        valve = throw.valve_ratio[:, joint]
        speed = np.interp(valve, table.valve_ratio, table.actuator_speed_rad_m_per_s)
        # Tables hold two points just off zero, so that they can be inverted.
        speed = np.where(np.abs(valve) < 1e-6, 0.0, speed)
        command = speed / ratio if references is None else references[number][:, joint]
        if np.count_nonzero(np.abs(command) > MOVED_RATIO * limit) < MOVED_TICKS:
            continue
        seen = np.interp(throw.t_s, throw.sensor_t_s, throw.sensor_velocity_rad_m_per_s[:, joint])
        rest = np.zeros(GAP_TICKS)
        for column, values in zip(columns, (command, seen, valve, ratio), strict=True):
            column += [values, rest]
        ticks = throw.t_s.size
        seconds = ticks * CONTROL_PERIOD_S
        pieces = max(1, int(seconds // LONGEST_BLOCK_S)) if seconds > 2.0 * LONGEST_BLOCK_S else 1
        piece = count + np.minimum(np.arange(ticks) * pieces // ticks, pieces - 1)
        block += [piece.astype(np.int64), np.full(GAP_TICKS, -1)]
        used += [np.ones(ticks, np.bool_), np.zeros(GAP_TICKS, np.bool_)]
        count += pieces
    if not used:
        nothing = np.zeros(GAP_TICKS)
        rest = np.zeros(GAP_TICKS, np.bool_)
        return DriveRecord(
            nothing, nothing, nothing, nothing + 1.0, rest, rest.astype(np.int64) - 1, 0
        )
    steady, measured, valve, ratio = (np.concatenate(column) for column in columns)
    return DriveRecord(
        steady, measured, valve, ratio, np.concatenate(used), np.concatenate(block), count
    )


def moved_blocks(record: DriveRecord, sign: float, limit_rad_m_per_s: float) -> BoolArray:
    """(blocks,) whether a block uses this direction."""
    high = (sign * record.steady > MOVED_RATIO * limit_rad_m_per_s) & record.used
    return np.bincount(record.block[high], minlength=record.block_count) >= MOVED_TICKS
