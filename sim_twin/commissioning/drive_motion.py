"""Valve motions that show a drive's oil: steps up to full valve, stops and reversals at several reaches."""

from typing import NamedTuple

import numpy as np

from machine.calibration import ValveCalibration, actuator_ratio
from machine.conventions import (
    ACTIVE_COUNT,
    CONTROL_PERIOD_NS,
    CONTROL_PERIOD_S,
    JOINT_COUNT,
    Array,
    IntArray,
)
from machine.kinematics import hanging_pitch_rad
from machine.spec import MachineSpec
from runtime.driver import SimulatedDriver, ValveCommand
from sim_twin.commissioning.excitation import WINDOW_RAD_M
from sim_twin.twin.oil_spring import squared_reach

DRIVE_COPY_COUNT = 80
"""Copies of a machine that run side by side, twenty per joint."""
DURATION_S = 3.5
"""Short, from rest, as throws are: longer motion swings the gripper beyond what a drive depends on."""
VALVE_RATIO = (0.2, 1.0)
"""Smallest and largest valve command."""
STOP_SHARE_RATIO = 0.3
"""Share of commands that close the valve, after which the oil rings freely."""
HOLD_S = ((0.5, 2.0), (0.2, 0.9), (0.2, 0.8), (0.2, 0.9))
"""Shortest and longest duration of a valve command, per joint."""
START_RAD_M = (
    ((0.0, 0.80, 0.0, 0.5), (0.0, 1.0, -0.3, 0.2), (0.0, 0.7, 0.5, 1.0)),
    ((0.0, 0.80, 0.3, 0.0), (0.0, 0.85, 0.0, 0.2), (0.0, 0.8, 0.6, 0.6)),
    ((0.0, 0.90, 0.0, 0.0), (0.0, 1.0, 0.1, 0.4), (0.0, 1.0, 0.2, 0.8)),
    ((0.0, 1.00, 0.1, 0.8), (0.0, 1.0, 0.3, 0.6), (0.0, 0.95, 0.2, 1.0)),
)
"""Start positions of the driven joints, by moved joint: three reaches, the load clear of the ground."""


class DriveMotion(NamedTuple):
    """Motions of one joint; N runs of T control ticks. Column k acts in tick k, or was read at its end."""

    actuator_speed_rad_m_per_s: Array
    """(N, T) steady actuator speed that the valve tables give for the command."""
    moment_ratio: Array
    """(N, T) actuator speed a joint speed, at the begin of the tick."""
    squared_reach_ratio: Array
    """(N, T) `oil_spring.squared_reach` at the begin of the tick."""
    position_rad_m: Array
    """(N, T)"""
    velocity_rad_m_per_s: Array
    """(N, T)"""
    sensor_age_s: float
    """Age of the sensor values when they were read."""

    def runs(self, index: IntArray) -> "DriveMotion":
        """Some of the runs."""
        speed, ratio, reach, position, velocity = (part[index] for part in self[:5])
        return DriveMotion(speed, ratio, reach, position, velocity, self.sensor_age_s)

    @property
    def velocity_lag_s(self) -> float:
        """Lag of the velocity behind the position, s: that of the sensor's filter.

        Position minus the integral of the reported velocity is the lag times the velocity, plus a constant.
        """
        v = self.velocity_rad_m_per_s
        way = np.cumsum(0.5 * CONTROL_PERIOD_S * (v[:, 1:] + v[:, :-1]), axis=1)
        left = self.position_rad_m[:, 1:] - way
        late = v[:, 1:] - v[:, 1:].mean(axis=1, keepdims=True)
        left = left - left.mean(axis=1, keepdims=True)
        power = float((late * late).sum())
        return max(float((late * left).sum()) / power, 0.0) if power > 0.0 else 0.0


def record_drives(
    plant: SimulatedDriver, spec: MachineSpec, calibration: ValveCalibration, seed: int
) -> tuple[DriveMotion, DriveMotion, DriveMotion, DriveMotion]:
    """Drive copies of a machine with random valve commands, one joint at a time; one record per joint."""
    rng = np.random.default_rng((seed, 0xD21))
    count = plant.count
    rows, joint = np.arange(count), np.arange(count) % ACTIVE_COUNT
    low, high = np.asarray(WINDOW_RAD_M)[joint].T
    hold = np.asarray(HOLD_S)[joint]
    starts = np.asarray(START_RAD_M)
    pose = np.zeros((count, JOINT_COUNT))
    pose[:, :ACTIVE_COUNT] = starts[joint, (rows // ACTIVE_COUNT) % starts.shape[1]]
    pose[:, ACTIVE_COUNT] = hanging_pitch_rad(pose[:, :ACTIVE_COUNT])
    tables = [
        (np.asarray(t.valve_ratio), np.asarray(t.actuator_speed_rad_m_per_s))
        for t in calibration.tables
    ]
    ticks = round(DURATION_S / CONTROL_PERIOD_S)
    found = np.zeros((5, count, ticks))
    plant.reset(pose, seed)
    shut = np.zeros(count, dtype=np.bool_)
    level, until = np.zeros(count), np.zeros(count)
    sample, age_s = plant.read(), 0.0
    for tick in range(ticks):
        position = sample.joint_position_rad_m
        moved = position[rows, joint]
        turn = np.where(moved > high, -1.0, np.where(moved < low, 1.0, 0.0))
        now_s = tick * CONTROL_PERIOD_S
        due = (now_s >= until) | (turn * level < 0.0)
        sign = np.where(turn != 0.0, turn, rng.choice([-1.0, 1.0], count))
        stops = (rng.uniform(size=count) < STOP_SHARE_RATIO) & (turn == 0.0)
        new = np.where(stops, 0.0, sign * rng.uniform(*VALVE_RATIO, count))
        level = np.where(due, new, level)
        until = np.where(due, now_s + rng.uniform(hold[:, 0], hold[:, 1]), until)
        valve = np.zeros((count, ACTIVE_COUNT))
        valve[rows, joint] = level
        found[0, :, tick] = [np.interp(v, *tables[j]) for v, j in zip(level, joint, strict=True)]
        found[1, :, tick] = np.abs(actuator_ratio(spec, position))[rows, joint]
        found[2, :, tick] = squared_reach(spec, position)[rows, joint]
        plant.write(ValveCommand(valve, shut))
        plant.advance(plant.now_ns() + CONTROL_PERIOD_NS)
        sample = plant.read()
        age_s += (plant.now_ns() - sample.t_mono_ns) * 1e-9 / ticks
        found[3, :, tick] = sample.joint_position_rad_m[rows, joint]
        found[4, :, tick] = sample.joint_velocity_rad_m_per_s[rows, joint]
    every = DriveMotion(found[0], found[1], found[2], found[3], found[4], age_s)
    one, two, three, four = (every.runs(np.flatnonzero(joint == j)) for j in range(ACTIVE_COUNT))
    return one, two, three, four
