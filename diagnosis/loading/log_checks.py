"""Checks that refuse a throw log, with the numbers, the likely cause and the remedy.

A check repairs nothing: it raises `RefusedLogError` or returns.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from machine.conventions import ACTIVE_JOINTS, CONTROL_PERIOD_S, JOINT_NAMES, Array, BoolArray
from machine.errors import LogError
from machine.spec import MachineSpec

MAX_REPAIRED_TICKS: Final = 3
"""Most missing ticks in a row that are interpolated: 30 ms, shorter than any lag of the machine."""
MAX_MISSING_RATIO: Final = 0.1
"""Largest share of missing ticks in a usable log."""
CLOCK_JUMP_S: Final = 0.025
"""A step that differs from the tick counter's by more than this is a jump of the clock, s."""
STUCK_S: Final = 0.3
STUCK_TRAVEL_RAD_M: Final = 0.02
"""A position that does not change while its velocity sensor travels this far (rad or m) is stuck."""
RANGE_SLACK_RAD_M: Final = 0.25
"""Allowed excess over the joint's range, rad or m: encoder bias, cylinder cushions, a wrong zero."""
SPEED_SLACK_RATIO: Final = 3.0
MAX_GYRO_RAD_PER_S: Final = 12.0
"""Largest plausible rate; a gripper at full swing turns at 3 rad/s."""
SPECIFIC_FORCE_M_PER_S2: Final = (4.0, 40.0)
"""Plausible median magnitude over a throw; a gripper at rest reads 9.81."""
MAX_DISTANCE_M: Final = 60.0
"""Largest plausible distance; targets lie within 60 m (machine.messages.Target)."""
LARGEST_NUMBER: Final = 1e12
"""Larger values of any quantity count as missing."""
MIN_PRESSURE_PA: Final = 1e5
DEGREES: Final = 180.0 / np.pi


class RefusedLogError(LogError):
    """A log that cannot be used; its text gives the reason with numbers, and the remedy."""


def is_number(values: Array) -> BoolArray:
    """(rows,) whether all axes of (rows, axes) hold plausible finite numbers."""
    return np.all(np.abs(values) < LARGEST_NUMBER, axis=1)


def check_finite(name: str, missing: NDArray[np.bool_]) -> int:
    """Number of missing values of a channel, from flags (ticks,) that are true where a value is missing.

    Raises:
        RefusedLogError: more in a row, or more in total, than may be interpolated.
    """
    count = int(np.sum(missing))
    if count == 0:
        return 0
    longest = longest_run(missing)
    if longest > MAX_REPAIRED_TICKS or count > MAX_MISSING_RATIO * len(missing):
        raise RefusedLogError(
            f"{name} has {count} of {len(missing)} values missing or NaN, {longest} in a row; up to "
            f"{MAX_REPAIRED_TICKS} in a row are interpolated. A sensor or its cable dropped out: "
            "repair it and record this throw again"
        )
    return count


def longest_run(flags: NDArray[np.bool_]) -> int:
    """Length of the longest run of true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return int(np.max(edges[1::2] - edges[::2])) if edges.size else 0


def check_stuck(position: Array, velocity: Array, valve: Array) -> None:
    """Check for frozen joint sensors: (T, 4) positions, velocities and valve commands on the tick grid.

    Raises:
        RefusedLogError: a sensor does not change while another one shows that the joint moves.
    """
    stuck = round(STUCK_S / CONTROL_PERIOD_S)
    for joint, name in enumerate(ACTIVE_JOINTS):
        travel = np.cumsum(velocity[:, joint]) * CONTROL_PERIOD_S
        for start, end in _runs(np.diff(position[:, joint]) == 0.0, stuck):
            moved = float(np.ptp(travel[start : end + 1]))
            if moved > STUCK_TRAVEL_RAD_M:
                raise RefusedLogError(
                    f"the position of {name} stays at {position[start, joint]:.6g} for "
                    f"{(end - start) * CONTROL_PERIOD_S:.2f} s while its velocity sensor travels "
                    f"{moved:.3f}: constant channel. Check the encoder and its cable"
                )
        for start, end in _runs(np.diff(velocity[:, joint]) == 0.0, stuck):
            held = velocity[start, joint] * (end - start) * CONTROL_PERIOD_S
            moved = abs(position[end, joint] - position[start, joint] - held)
            if moved > STUCK_TRAVEL_RAD_M:
                raise RefusedLogError(
                    f"the velocity of {name} stays at {velocity[start, joint]:.6g} for "
                    f"{(end - start) * CONTROL_PERIOD_S:.2f} s while its position moves on by "
                    f"{moved:.3f}: constant channel. Check the sensor"
                )
        still = np.ptp(position[:, joint]) == 0.0 and np.ptp(velocity[:, joint]) == 0.0
        if still and float(np.max(np.abs(valve[:, joint]))) > 0.2:
            raise RefusedLogError(
                f"position and velocity of {name} are constant while its valve was opened to "
                f"{float(np.max(np.abs(valve[:, joint]))):.2f}. Check the joint's sensors"
            )
    if (
        float(np.max(np.ptp(valve, axis=0))) == 0.0
        and float(np.max(np.ptp(position, axis=0))) > 0.1
    ):
        raise RefusedLogError(
            "all four valve commands are constant while joints move by more than 0.1: the commands "
            "were not recorded. Log valve_applied_ratio"
        )


def check_constant(name: str, samples: Array) -> None:
    """Check a channel (K, axes) of a sensor with noise.

    Raises:
        RefusedLogError: an axis never changes.
    """
    if len(samples) < 5:
        return
    still = np.flatnonzero(np.ptp(samples, axis=0) == 0.0)
    if still.size:
        axes = ", ".join("xyz"[axis] for axis in still)
        raise RefusedLogError(
            f"{name} {axes} is {samples[0, still[0]]:.6g} in all {len(samples)} samples: constant "
            "channel. A live sensor has noise; check its power and cable"
        )


def check_joint_units(spec: MachineSpec, position: Array, velocity: Array, estimate: Array) -> None:
    """Check the units of joint channels against the machine's ranges and against each other.

    Args:
        spec: the machine's ranges and speeds.
        position: (T, 4) as read, rad and m.
        velocity: (T, 4) as read, rad/s and m/s.
        estimate: (T, 6) joint positions in the policy's observation.

    Raises:
        RefusedLogError: degrees for radians, millimetres for metres, or values that the machine cannot
            reach.
    """
    low, high = spec.position_range_rad_m
    speed = np.maximum(
        spec.limits.speed_positive_rad_m_per_s, spec.limits.speed_negative_rad_m_per_s
    )
    for joint, name in enumerate(ACTIVE_JOINTS):
        is_length = name == "telescope"
        factor, wrong, right = (1000.0, "mm", "m") if is_length else (DEGREES, "degrees", "rad")
        seen = (float(np.min(position[:, joint])), float(np.max(position[:, joint])))
        if seen[0] < low[joint] - RANGE_SLACK_RAD_M or seen[1] > high[joint] + RANGE_SLACK_RAD_M:
            raise RefusedLogError(
                f"{name} runs from {seen[0]:.4g} to {seen[1]:.4g} {right}, its range is "
                f"{low[joint]:.3g} to {high[joint]:.3g} {right}: swapped units ({wrong} for {right}, "
                f"factor {factor:.4g}), or a wrong zero. Convert or calibrate the sensor"
            )
        peak = float(np.quantile(np.abs(velocity[:, joint]), 0.98))
        if peak > SPEED_SLACK_RATIO * speed[joint]:
            raise RefusedLogError(
                f"{name} moves at {peak:.4g} {right}/s, its limit is {speed[joint]:.3g} {right}/s: "
                f"swapped units ({wrong}/s for {right}/s), or a broken velocity sensor"
            )
        _check_agreement(name, position[:, joint], velocity[:, joint], factor, wrong)
    apart = np.quantile(np.abs(estimate[:, :4] - position), 0.9, axis=0)
    worst = int(np.argmax(apart))
    if apart[worst] > 0.5:
        raise RefusedLogError(
            f"estimate and sensor of {ACTIVE_JOINTS[worst]} are {apart[worst]:.3g} apart: swapped units "
            "in one of them, or another machine's estimator"
        )
    for joint in (4, 5):
        peak = float(np.max(np.abs(estimate[:, joint])))
        if peak > np.pi:
            raise RefusedLogError(
                f"{JOINT_NAMES[joint]} reaches {peak:.4g} rad; a hanging gripper stays within pi: "
                "swapped units (degrees for rad)"
            )


def check_imu_units(gyro_rad_per_s: Array, accel_m_per_s2: Array) -> None:
    """Units of the IMU, (K, 3) each.

    Raises:
        RefusedLogError: degrees for radians or g for m/s^2.
    """
    if len(gyro_rad_per_s) == 0:
        return
    peak = float(np.quantile(np.abs(gyro_rad_per_s), 0.995))
    if peak > MAX_GYRO_RAD_PER_S:
        raise RefusedLogError(
            f"the gyro reads up to {peak:.4g} rad/s, a gripper turns at less than "
            f"{MAX_GYRO_RAD_PER_S:g} rad/s: swapped units (degrees/s for rad/s)"
        )
    force = float(np.median(np.linalg.norm(accel_m_per_s2, axis=1)))
    low, high = SPECIFIC_FORCE_M_PER_S2
    if not low < force < high:
        raise RefusedLogError(
            f"the accelerometer's median magnitude is {force:.4g} m/s^2, a hanging gripper reads about "
            "9.81: swapped units (g for m/s^2) or a broken sensor"
        )


def check_places(**points_m: Array) -> None:
    """Points in frame `machine`, each (..., 3), m.

    Raises:
        RefusedLogError: further away than any throw.
    """
    for name, points in points_m.items():
        farthest = float(np.max(np.abs(points), initial=0.0, where=np.isfinite(points)))
        if farthest > MAX_DISTANCE_M:
            raise RefusedLogError(
                f"{name} is {farthest:.4g} m from the machine, throws end within {MAX_DISTANCE_M:g} m: "
                "swapped units (mm for m), or a survey in another frame"
            )


def check_valve_and_supply(valve_ratio: Array, supply_pressure_pa: Array) -> None:
    """Valve commands (T, 4) within -1..1 and a supply pressure (T,) in Pa.

    Raises:
        RefusedLogError: per cent for ratio, bar for pascal.
    """
    peak = float(np.max(np.abs(valve_ratio)))
    if peak > 1.05:
        raise RefusedLogError(
            f"a valve command of {peak:.4g} lies outside -1..1: swapped units (per cent or mA for ratio)"
        )
    known = supply_pressure_pa[np.isfinite(supply_pressure_pa) & (supply_pressure_pa > 0.0)]
    if known.size and float(np.median(known)) < MIN_PRESSURE_PA:
        raise RefusedLogError(
            f"the supply pressure is {float(np.median(known)):.4g} Pa, less than the air's: swapped "
            "units (bar or MPa for Pa), or the pump was off"
        )


def check_machine(metadata: dict[str, Any], spec: MachineSpec) -> None:
    """The log's machine type must be the one the twin models.

    Raises:
        RefusedLogError: another model hash.
    """
    seen = str(metadata.get("model_sha256") or "")
    if seen and seen != spec.sha256:
        raise RefusedLogError(
            f"wrong machine: the log's model hash is {seen[:12]}, this twin's is {spec.sha256[:12]}. "
            "The log comes from another machine type or model version; use the twin it was recorded with"
        )


def _check_agreement(
    name: str, position: Array, velocity: Array, factor: float, wrong: str
) -> None:
    """Compare the position's travel with the integral of the velocity, over windows that average noise."""
    window = 10
    rate = (position[window:] - position[:-window]) / (window * CONTROL_PERIOD_S)
    summed = np.concatenate([[0.0], np.cumsum(0.5 * (velocity[1:] + velocity[:-1]))])
    mean = (summed[window:] - summed[:-window]) / window
    if len(rate) < window or float(np.max(np.abs(mean))) < 0.03:
        return
    slope = float(np.dot(rate, mean) / np.dot(mean, mean))
    if not 0.3 < slope < 3.0:
        raise RefusedLogError(
            f"the position of {name} moves {slope:.3g} times as far as its velocity says: swapped units "
            f"({wrong}, factor {factor:.4g}) or sign in one of the two"
        )


def _runs(flags: NDArray[np.bool_], at_least: int) -> list[tuple[int, int]]:
    """Start and end (exclusive) of runs of true that are long enough."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return [
        (int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= at_least
    ]
