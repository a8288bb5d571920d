"""What the logs hold of one driven joint: commanded steady speed and measured speed, one long record.

Logs are put one after the other with rests between, so that one filter runs over all of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.loading.throw_data import ThrowData
from machine.calibration import actuator_ratio_magnitude
from machine.conventions import CONTROL_PERIOD_S, Array, BoolArray, IntArray
from machine.spec import MachineSpec

GAP_TICKS = 150
"""Between two logs: longer than the rest of a response that logs end with."""
MOVED_RATIO = 0.08
MOVED_TICKS = 8
"""A direction was used in a log when its command was above this share of the joint's limit for 80 ms."""
LONGEST_BLOCK_S = 4.0
"""Logs of more than twice this are cut into pieces of about this length."""


@dataclass(frozen=True, slots=True)
class DriveRecord:
    """One joint over all logs; T ticks of 10 ms, rad and m."""

    steady: Array
    """(T,) joint speed that the valve tables give for the command at the joint's pose, or the reference."""
    measured: Array
    """(T,) joint speed, moved onto the tick at which it was sampled."""
    valve_ratio: Array
    """(T,)"""
    actuator_ratio: Array
    """(T,) actuator speed a joint speed."""
    used: BoolArray
    """(T,) inside a log, not in the rests between."""
    block: IntArray
    """(T,) piece that a tick belongs to, -1 in rests; pieces are what is drawn again in a bootstrap."""
    block_count: int


def drive_record(
    throws: Sequence[ThrowData],
    spec: MachineSpec,
    joint: int,
    references: Sequence[Array] | None = None,
) -> DriveRecord:
    """Everything about one driven joint, log after log; logs in which it was not used are left out.

    Args:
        throws: the logs.
        spec: machine type.
        joint: which one.
        references: (T, 4) a log, what the controller was told, instead of what the valves were told.
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
        told = speed / ratio if references is None else references[number][:, joint]
        if np.count_nonzero(np.abs(told) > MOVED_RATIO * limit) < MOVED_TICKS:
            continue
        seen = np.interp(throw.t_s, throw.sensor_t_s, throw.sensor_velocity_rad_m_per_s[:, joint])
        rest = np.zeros(GAP_TICKS)
        for column, values in zip(columns, (told, seen, valve, ratio), strict=True):
            column += [values, rest]
        ticks = throw.t_s.size
        seconds = ticks * CONTROL_PERIOD_S
        pieces = max(1, int(seconds // LONGEST_BLOCK_S)) if seconds > 2.0 * LONGEST_BLOCK_S else 1
        own = count + np.minimum(np.arange(ticks) * pieces // ticks, pieces - 1)
        block += [own.astype(np.int64), np.full(GAP_TICKS, -1)]
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
    """(blocks,) whether a direction was used."""
    high = (sign * record.steady > MOVED_RATIO * limit_rad_m_per_s) & record.used
    return np.bincount(record.block[high], minlength=record.block_count) >= MOVED_TICKS
