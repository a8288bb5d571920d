"""A throw prepared for the comparison: its measured motion and the layout of its residual vector."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.loading.measured import (
    MeasuredMotion,
    hung_at_rest,
    measured_motion,
    measured_opening_s,
    replay_input,
)
from diagnosis.loading.throw_data import ThrowData
from diagnosis.loading.velocity_lag import velocity_lag_s
from machine.conventions import ACTIVE_JOINTS, Array, IntArray
from sim_twin.replay.replay import ReplayInput
from sim_twin.twin.profile import TwinProfile

AXES = ("x", "y", "z")
MEAN_OF_COUNT = 2
"""Samples averaged before the comparison: 50 Hz cover the bandwidth of the twin."""
IMU_UNTIL_AFTER_OPENING_S = 0.6
"""The swing is compared up to this time after the opening, s; afterwards the settling controller acts."""


@dataclass(frozen=True, slots=True)
class Block:
    """A channel of one throw: sample times, and the motion levels that scale its discrepancy."""

    name: str
    rows: slice
    """In the throw's residual vector."""
    t_s: Array
    """(n,)"""
    rate: Array
    """(n,) first motion level of the discrepancy: speed."""
    push: Array
    """(n,) second motion level: acceleration."""


@dataclass(frozen=True, slots=True)
class PreparedThrow:
    """A throw, its measured motion, and the layout of its residual vector."""

    throw: ThrowData
    motion: MeasuredMotion
    input: ReplayInput
    blocks: tuple[Block, ...]
    measured: Array
    """(n,) measured values, block after block."""
    joint_at_s: Array
    imu_at_s: Array
    imu_pair: Array
    """(k, K) averages the IMU samples that are compared."""
    joint_pair: Array
    """(j, T) averages the joint samples that are compared."""

    def block(self, name: str) -> Block | None:
        """A block by name; None where the log has no such channel."""
        return next((block for block in self.blocks if block.name == name), None)


def prepare(throws: Sequence[ThrowData], profile: TwinProfile) -> list[PreparedThrow]:
    """Measured motion and residual layout of every throw, in the order in which they were thrown."""
    ordered = sorted(throws, key=lambda throw: (throw.recorded_at_ns, throw.throw_id))
    last = max(len(ordered) - 1, 1)
    lag_s = velocity_lag_s(ordered)
    is_hung = hung_at_rest(ordered)
    return [_prepare(throw, profile, n / last, lag_s, is_hung) for n, throw in enumerate(ordered)]


def _prepare(
    throw: ThrowData, profile: TwinProfile, progress_ratio: float, lag_s: Array, is_hung: bool
) -> PreparedThrow:
    motion = measured_motion(throw, lag_s)
    opening_s = throw.open_command_t_s + profile.release_delay_s
    data = replay_input(throw, motion, progress_ratio, opening_s, is_hung=is_hung)
    end_s = float(motion.t_s[-1])
    joint_at = throw.sensor_t_s
    joint_rows = np.flatnonzero((joint_at >= 0.0) & (joint_at <= end_s))
    joint_pair = _pairs(joint_rows, joint_at.size)
    opening = data.opening_t_s
    imu_at = throw.imu_t_s
    imu_rows = np.flatnonzero(
        (imu_at >= 0.0) & (imu_at <= min(end_s, opening + IMU_UNTIL_AFTER_OPENING_S))
    )
    imu_pair = _pairs(imu_rows, imu_at.size)
    prepared = PreparedThrow(
        throw, motion, data, (), np.zeros(0), joint_at, imu_at, imu_pair, joint_pair
    )
    blocks, measured = _layout(prepared)
    return PreparedThrow(
        throw, motion, data, tuple(blocks), measured, joint_at, imu_at, imu_pair, joint_pair
    )


def _pairs(rows: IntArray, columns: int) -> Array:
    """Matrix that averages neighbouring samples among the chosen rows."""
    groups = [rows[i : i + MEAN_OF_COUNT] for i in range(0, rows.size - 1, MEAN_OF_COUNT)]
    matrix = np.zeros((len(groups), columns))
    for i, group in enumerate(groups):
        matrix[i, group] = 1.0 / group.size
    return matrix


def _layout(prepared: PreparedThrow) -> tuple[list[Block], Array]:
    throw, motion = prepared.throw, prepared.motion
    blocks: list[Block] = []
    values: list[Array] = []

    def add(name: str, t_s: Array, measured: Array, rate: Array, push: Array) -> None:
        first = blocks[-1].rows.stop if blocks else 0
        blocks.append(Block(name, slice(first, first + measured.size), t_s, rate, push))
        values.append(measured)

    joint_t = prepared.joint_pair @ prepared.joint_at_s
    for joint, name in enumerate(ACTIVE_JOINTS):
        add(
            f"actuation.{name}",
            joint_t,
            prepared.joint_pair @ throw.sensor_velocity_rad_m_per_s[:, joint],
            np.interp(joint_t, motion.t_s, _recent(np.abs(motion.velocity_rad_m_per_s[:, joint]))),
            np.interp(
                joint_t, motion.t_s, _recent(np.abs(motion.acceleration_rad_m_per_s2[:, joint]))
            ),
        )
    imu_t = prepared.imu_pair @ prepared.imu_at_s
    turning = _recent(np.abs(motion.swing_rate_rad_per_s + 0.0).sum(axis=1))
    driving = _recent(np.abs(motion.acceleration_rad_m_per_s2).sum(axis=1))
    levels = [np.interp(imu_t, motion.t_s, level) for level in (turning, driving)]
    imu = (("gyro", throw.gyro_rad_per_s), ("accel", throw.accel_m_per_s2))
    for kind, samples in imu if throw.imu_t_s.size else ():
        for axis, letter in enumerate(AXES):
            add(
                f"swing.{kind}.{letter}",
                imu_t,
                prepared.imu_pair @ samples[:, axis],
                levels[0],
                levels[1],
            )
    one = np.ones(1)
    opening = measured_opening_s(throw)
    if np.isfinite(opening):
        add("release.switch", np.array([opening]), np.array([opening]), one, one)
    if throw.ball_t_s.size:
        # One row after the other: x, y, z of each sample.
        count = throw.ball_t_s.size
        add(
            "flight.ball",
            np.repeat(throw.ball_t_s, 3),
            throw.ball_m.ravel(),
            np.zeros(3 * count),
            np.zeros(3 * count),
        )
    if np.isfinite(throw.impact_m[:2]).all():
        add("flight.impact", np.zeros(2), throw.impact_m[:2].copy(), np.zeros(2), np.zeros(2))
    return blocks, np.concatenate(values)


def _recent(level: Array) -> Array:
    """Maximum of a level (T,) over the last 0.15 s and the next 0.05 s."""
    out = level.copy()
    for shift in range(-5, 16):
        moved = np.roll(level, shift)
        if shift > 0:
            moved[:shift] = level[0]
        elif shift < 0:
            moved[shift:] = level[-1]
        np.maximum(out, moved, out=out)
    return out
