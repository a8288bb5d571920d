"""Speed and acceleration limits of a joint, or the reason why the logs do not reach them."""

import numpy as np
from scipy.signal import savgol_filter

from diagnosis.identification.drive_record import DriveRecord
from diagnosis.identification.quantity import Quantity, mean_quantity, unknown
from machine.calibration import actuator_ratio_magnitude
from machine.conventions import CONTROL_PERIOD_S, Array, BoolArray
from machine.spec import MachineSpec

FULL_VALVE_RATIO = 0.97
HELD_S = 0.35
"""Full valve is held for this long before the speed counts, s: dead time and lag of an arm joint."""
SLEW_HELD_S = 1.2
"""The same for the slew, s."""
MEASURE_S = 0.1
REFERENCE_RAD_M = np.array([[0.0, 0.5, 0.0, 0.5]])
"""Pose at which a cylinder's speed is given, as in `machine.calibration.nominal_calibration`."""
MIN_COUNT = 3
ONSET_RATIO = 0.05
"""A joint is at rest below this share of its largest commanded speed."""
SLOPE_S, SLEW_SLOPE_S = 0.07, 0.15
"""Windows of the local slope that gives an acceleration, s, for arm joints and the slew."""
ONSET_S = 0.6
STEP_TICKS = 3
STEP_RATIO = 0.8
"""A command that reaches this share of its size within `STEP_TICKS` is a step; a slower ramp limits by
itself."""
SATURATED_RATIO = 0.7
"""A limit is seen when peak acceleration over step size of the largest steps falls below this share of
that of the smallest steps."""


def speed_limit(
    record: DriveRecord, spec: MachineSpec, joint: int, sign: float, unit: str
) -> Quantity:
    """Speed at full valve, at the reference pose; rad/s or m/s, positive in both directions."""
    held = round((SLEW_HELD_S if joint == 0 else HELD_S) / CONTROL_PERIOD_S)
    measure = round(MEASURE_S / CONTROL_PERIOD_S)
    actuator = sign * record.measured * record.actuator_ratio
    reference = float(actuator_ratio_magnitude(spec, REFERENCE_RAD_M)[0, joint])
    found = [
        float(np.mean(actuator[last - measure : last])) / reference
        for first, last in _runs(sign * record.valve_ratio >= FULL_VALVE_RATIO)
        if last - first >= held + measure
    ]
    if len(found) >= MIN_COUNT:
        return mean_quantity(np.asarray(found), unit)
    seen = float(np.max(sign * record.measured[record.used], initial=0.0))
    seconds = (held + measure) * CONTROL_PERIOD_S
    return unknown(
        unit,
        f"full valve was held for {seconds:.2f} s in {len(found)} pieces, {MIN_COUNT} are needed",
        at_least=seen,
        count=len(found),
    )


def acceleration_limit(record: DriveRecord, joint: int, sign: float, unit: str) -> Quantity:
    """Peak acceleration that larger steps do not exceed, rad/s2 or m/s2."""
    window = round((SLEW_SLOPE_S if joint == 0 else SLOPE_S) / CONTROL_PERIOD_S) | 1
    slope = savgol_filter(record.measured, window, 1, deriv=1, delta=CONTROL_PERIOD_S)
    size, peak = _steps(record, sign * np.asarray(slope), sign)
    most = float(np.max(sign * np.asarray(slope)[record.used], initial=0.0))
    if size.size < 3 * MIN_COUNT:
        why = f"{size.size} steps from rest, {3 * MIN_COUNT} of different sizes are needed"
        return unknown(unit, why, most, int(size.size))
    order = np.argsort(size)
    third = size.size // 3
    small, large = order[:third], order[-third:]
    if size[large].mean() < 2.0 * size[small].mean():
        return unknown(unit, "all steps are about equally large", most, int(size.size))
    share = float(np.median(peak[large] / size[large]) / np.median(peak[small] / size[small]))
    if share > SATURATED_RATIO:
        why = f"it grows with the step: {100.0 * share:.0f} % of proportional in the largest steps"
        return unknown(unit, why, most, int(size.size))
    return mean_quantity(peak[large], unit)


def _steps(record: DriveRecord, slope: Array, sign: float) -> tuple[Array, Array]:
    """Sizes and peak accelerations of the steps from rest in one direction."""
    steady = sign * record.steady
    rest = ONSET_RATIO * float(np.max(np.abs(record.steady), initial=1e-9))
    ahead = round(ONSET_S / CONTROL_PERIOD_S)
    sizes: list[float] = []
    peaks: list[float] = []
    for first, last in _runs(steady > rest):
        before = record.measured[max(first - 10, 0) : first]
        if last - first < 10 or (before.size and np.max(np.abs(before)) > 3.0 * rest):
            continue
        size = float(np.max(steady[first : min(first + 20, last)]))
        if np.max(steady[first : first + STEP_TICKS]) < STEP_RATIO * size:
            continue
        sizes.append(size)
        peaks.append(float(np.max(slope[first : min(first + ahead, last)])))
    return np.asarray(sizes), np.asarray(peaks)


def _runs(flags: BoolArray) -> list[tuple[int, int]]:
    """Start and end (exclusive) of the runs of true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
