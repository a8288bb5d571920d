"""Excite a machine's drives and fit their velocity responses for its twin profile.

Uses only signals that a real machine's sensors provide. One joint moves at a time, because joints that
move together share the pump's flow.
"""

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
from sim_twin.commissioning.response_fit import ResponseFit, fit_response
from sim_twin.twin.profile import TwinProfile, nominal_profile

RESPONSE_COPY_COUNT = 24
"""Copies of a machine that run side by side, six per joint."""
DURATION_S = 6.0
HOLD_S = ((0.8, 2.0), (0.2, 0.9), (0.2, 0.9), (0.2, 0.9))
"""Shortest and longest duration of a valve command, per joint, as between reversals in throws, s."""
VALVE_RATIO = (0.15, 0.85)
"""Smallest and largest valve command: outside the dead band, below a joint's flow limit."""
START_RAD_M = (
    (0.0, 0.8, 0.0, 0.5),
    (0.0, 0.8, 0.3, 0.0),
    (0.0, 0.9, 0.0, 0.0),
    (0.0, 1.0, 0.1, 0.8),
)
"""Start positions of the driven joints, by moved joint; the load stays clear of the ground."""
WINDOW_RAD_M = ((-np.inf, np.inf), (0.55, 1.05), (-0.6, 0.7), (0.2, 1.5))
"""Range of the moved joint; outside it the command reverses."""


def record_valve_response(
    plant: SimulatedDriver, spec: MachineSpec, calibration: ValveCalibration, seed: int
) -> tuple[IntArray, Array, Array]:
    """Drive each copy of the plant with random valve commands on one joint.

    Returns:
        Joint index (N,), steady joint velocity that the calibration gives for the command (N, ticks), and
        the measured joint velocity (N, ticks), rad/s and m/s.
    """
    rng = np.random.default_rng(seed)
    count = plant.count
    rows, joint = np.arange(count), np.arange(count) % ACTIVE_COUNT
    hold = np.asarray(HOLD_S)[joint]
    low, high = np.asarray(WINDOW_RAD_M)[joint].T
    tables = [
        (np.asarray(t.valve_ratio), np.asarray(t.actuator_speed_rad_m_per_s))
        for t in calibration.tables
    ]
    ticks = round(DURATION_S / CONTROL_PERIOD_S)
    steady, measured = np.zeros((count, ticks)), np.zeros((count, ticks))
    pose = np.zeros((count, JOINT_COUNT))
    pose[:, :ACTIVE_COUNT] = np.asarray(START_RAD_M)[joint]
    pose[:, 4] = hanging_pitch_rad(pose[:, :ACTIVE_COUNT])
    plant.reset(pose, seed)
    shut = np.zeros(count, dtype=np.bool_)
    level = np.zeros(count)
    until = np.zeros(count)
    sample = plant.read()
    for tick in range(ticks):
        position = sample.joint_position_rad_m
        moved = position[rows, joint]
        turn = np.where(moved > high, -1.0, np.where(moved < low, 1.0, 0.0))
        due = (tick * CONTROL_PERIOD_S >= until) | (turn * level < 0.0)
        sign = np.where(turn != 0.0, turn, rng.choice([-1.0, 1.0], count))
        level = np.where(due, sign * rng.uniform(*VALVE_RATIO, count), level)
        until = np.where(due, tick * CONTROL_PERIOD_S + rng.uniform(hold[:, 0], hold[:, 1]), until)
        valve = np.zeros((count, ACTIVE_COUNT))
        valve[rows, joint] = level
        ratio = np.abs(actuator_ratio(spec, position))[rows, joint]
        actuator = np.array([np.interp(v, *tables[j]) for v, j in zip(level, joint, strict=True)])
        steady[:, tick] = actuator / ratio
        plant.write(ValveCommand(valve, shut))
        plant.advance(plant.now_ns() + CONTROL_PERIOD_NS)
        sample = plant.read()
        measured[:, tick] = sample.joint_velocity_rad_m_per_s[rows, joint]
    return joint, steady, measured


def identify_profile(
    plant: SimulatedDriver,
    spec: MachineSpec,
    calibration: ValveCalibration,
    machine_id: str,
    seed: int = 0,
) -> tuple[TwinProfile, tuple[ResponseFit, ...]]:
    """Twin profile of a machine with its identified response; everything else is nominal.

    Raises:
        ValueError: a joint did not move.
    """
    joint, steady, measured = record_valve_response(plant, spec, calibration, seed)
    fits = tuple(
        fit_response(steady[joint == j], measured[joint == j]) for j in range(ACTIVE_COUNT)
    )

    def four(values: list[float]) -> tuple[float, float, float, float]:
        return values[0], values[1], values[2], values[3]

    profile = nominal_profile(spec).model_copy(
        update={
            "machine_id": machine_id,
            "version_count": 1,
            "note": "response identified from random valve motion, one joint at a time; "
            + ", ".join(f"R2 {fit.r2_ratio:.3f}" for fit in fits),
            "dead_time_s": four([fit.dead_time_s for fit in fits]),
            "natural_frequency_rad_per_s": four([fit.natural_frequency_rad_per_s for fit in fits]),
            "damping_ratio": four([fit.damping_ratio for fit in fits]),
            "gain_ratio": four([fit.gain_ratio for fit in fits]),
        }
    )
    return profile, fits
