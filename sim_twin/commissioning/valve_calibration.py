"""Measure the valve tables of a simulated machine: steady actuator speeds at steps of the valve command.

The runtime's feed-forward inverts the tables. Uses only signals that a real machine's sensors provide.
"""

from dataclasses import dataclass

import numpy as np

from machine.calibration import ValveCalibration, ValveTable, actuator_ratio
from machine.conventions import ACTIVE_COUNT, ACTIVE_JOINTS, CONTROL_PERIOD_NS, Array
from machine.errors import PlantError
from machine.kinematics import hanging_pitch_rad
from machine.spec import MachineSpec
from runtime.driver import SimulatedDriver, ValveCommand

LEVELS_RATIO = (0.03, 0.05, 0.07, 0.10, 0.15, 0.22, 0.32, 0.45, 0.60, 0.80, 1.00)
"""Valve steps of each direction, dense near the end of the dead band."""
HOLD_S = (4.0, 1.5, 1.2, 1.6)
"""Duration of a step, per joint: the slew takes seconds to reach a steady speed."""
MEASURE_S = (1.0, 0.5, 0.4, 0.5)
"""Last part of a step, over which the speed is averaged, per joint."""
START_UP_RAD_M = (
    (0.0, 0.80, 0.0, 0.50),
    (0.0, 0.35, 0.6, 0.1),
    (0.0, 0.85, -0.6, 0.3),
    (0.0, 0.9, 0.1, 0.1),
)
START_DOWN_RAD_M = (
    (0.0, 0.80, 0.0, 0.50),
    (0.0, 1.10, 0.2, 0.3),
    (0.0, 0.85, 0.8, 0.2),
    (0.0, 1.0, 0.1, 1.5),
)
"""Start positions of steps, by moved joint: room in the direction of motion, load clear of the ground."""
LIMIT_MARGIN_RAD_M = 0.05
"""Distance from a position limit within which speeds are not averaged."""
SLOWEST_RAD_M_PER_S = 2e-3
"""Speed below which a joint counts as standing, inside the dead band."""


@dataclass(frozen=True)
class _Step:
    joint: int
    valve_ratio: float


def _steps() -> list[_Step]:
    return [
        _Step(joint, sign * level)
        for joint in range(ACTIVE_COUNT)
        for sign in (1.0, -1.0)
        for level in LEVELS_RATIO
    ]


def _start_pose(step: _Step) -> Array:
    pose = np.zeros(6)
    pose[:4] = (START_UP_RAD_M if step.valve_ratio > 0.0 else START_DOWN_RAD_M)[step.joint]
    pose[4] = hanging_pitch_rad(pose[:4])
    return pose


def _measure(plant: SimulatedDriver, spec: MachineSpec, steps: list[_Step], seed: int) -> Array:
    """Steady actuator speed of up to `plant.count` steps run side by side, shape (len(steps),)."""
    padded = [steps[i % len(steps)] for i in range(plant.count)]
    joint = np.array([step.joint for step in padded])
    rows = np.arange(plant.count)
    valve = np.zeros((plant.count, ACTIVE_COUNT))
    valve[rows, joint] = [step.valve_ratio for step in padded]
    shut = np.zeros(plant.count, dtype=np.bool_)
    hold_s, measure_s = np.array(HOLD_S)[joint], np.array(MEASURE_S)[joint]
    low, high = spec.position_range_rad_m
    plant.reset(np.stack([_start_pose(step) for step in padded]), seed)
    total, count = np.zeros(plant.count), np.zeros(plant.count)
    start_ns = plant.now_ns()
    for tick in range(round(float(hold_s.max()) * 1e9 / CONTROL_PERIOD_NS)):
        plant.write(ValveCommand(valve, shut))
        plant.advance(start_ns + (tick + 1) * CONTROL_PERIOD_NS)
        sample = plant.read()
        position = sample.joint_position_rad_m
        speed = sample.joint_velocity_rad_m_per_s * np.abs(actuator_ratio(spec, position))
        moved = position[rows, joint]
        low_end, high_end = low[joint] + LIMIT_MARGIN_RAD_M, high[joint] - LIMIT_MARGIN_RAD_M
        free = (moved > low_end) & (moved < high_end)
        time_s = (tick + 1) * CONTROL_PERIOD_NS * 1e-9
        counts = free & (time_s > hold_s - measure_s) & (time_s <= hold_s)
        total += np.where(counts, speed[rows, joint], 0.0)
        count += counts
    if np.any(count[: len(steps)] == 0):
        late = [ACTIVE_JOINTS[padded[i].joint] for i in np.flatnonzero(count[: len(steps)] == 0)]
        raise PlantError(
            f"calibration: {sorted(set(late))} reached a position limit before a steady speed was "
            "measured; the plant is faster than twice its specification, or its positions are wrong"
        )
    return (total / np.maximum(count, 1))[: len(steps)]


def _table(joint: int, valve: Array, speed: Array) -> ValveTable:
    """Increasing table from measured points; the dead band is represented by two points near zero speed."""
    order = np.argsort(valve)
    valve, speed = valve[order], speed[order]
    # Within the dead band a joint may creep against its command; that is not the valve's flow.
    moving = speed * np.sign(valve) > SLOWEST_RAD_M_PER_S
    # Nor is motion at a smaller command than one without motion: the dead band ends beyond both.
    moving[valve < 0] = np.logical_and.accumulate(moving[valve < 0])
    moving[valve > 0] = np.logical_and.accumulate(moving[valve > 0][::-1])[::-1]
    speed = np.maximum.accumulate(np.where(moving, speed, 0.0))
    if min(np.sum(moving & (valve > 0)), np.sum(moving & (valve < 0))) < 2:
        raise PlantError(
            f"calibration: {ACTIVE_JOINTS[joint]} does not move in both directions at full valve; "
            "check that the valve is connected and its sign is right"
        )
    points_valve: list[float] = []
    points_speed: list[float] = []
    for side in (-1.0, 1.0):
        chosen = moving & (np.sign(valve) == side)
        v, s = valve[chosen], speed[chosen]
        inner = int(np.argmin(np.abs(v)))
        neighbour = inner + (1 if side > 0 else -1)
        rise = s[neighbour] - s[inner]
        back = s[inner] * (v[neighbour] - v[inner]) / rise if rise > 0.0 else 0.5 * v[inner]
        onset = float(np.clip(v[inner] - back, -0.99 * abs(v[inner]), 0.99 * abs(v[inner])))
        edge = side * max(abs(onset), 1e-3)
        pairs = [(edge, side * 1e-6), *zip(v.tolist(), s.tolist(), strict=True)]
        for a, b in sorted(pairs):
            points_valve.append(a)
            points_speed.append(b)
    speeds = np.asarray(points_speed)
    # Steps at the pump limit have equal speeds; keep the table invertible.
    speeds += np.arange(speeds.size) * 1e-9
    return ValveTable(
        valve_ratio=tuple(points_valve), actuator_speed_rad_m_per_s=tuple(speeds.tolist())
    )


def calibrate(
    plant: SimulatedDriver, spec: MachineSpec, machine_id: str, seed: int = 0
) -> ValveCalibration:
    """Run every valve step of every joint and return the tables.

    Args:
        plant: copies of the machine, on which steps run side by side.
        spec: machine type.
        machine_id: written into the calibration.
        seed: seed of the plant's noise.

    Raises:
        PlantError: a joint does not move, or moves in the wrong direction.
    """
    steps = _steps()
    speed = np.concatenate(
        [
            _measure(plant, spec, steps[i : i + plant.count], seed + i)
            for i in range(0, len(steps), plant.count)
        ]
    )
    joint = np.array([step.joint for step in steps])
    valve = np.array([step.valve_ratio for step in steps])
    tables = [_table(j, valve[joint == j], speed[joint == j]) for j in range(ACTIVE_COUNT)]
    return ValveCalibration(
        machine_id=machine_id, tables=(tables[0], tables[1], tables[2], tables[3])
    )


CALIBRATION_STEP_COUNT = len(_steps())
"""Number of copies with which all steps run side by side."""
