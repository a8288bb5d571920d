"""Parameter ranges for training from throws: the closed loop from velocity reference to joint velocity.

The parameters are those of `training.environment.task.ResponseConfig` with a second-order lag. 90 % of
single throws lie within a range.
"""

from collections.abc import Sequence

import numpy as np

from diagnosis.identification.drive_record import drive_record, moved_blocks
from diagnosis.identification.quantity import Quantity
from diagnosis.identification.response import MIN_BLOCKS
from diagnosis.identification.response_estimation import HIGH, LOW, fit, quantities
from diagnosis.loading.throw_data import ThrowData
from machine.conventions import ACTIVE_JOINTS, Array
from machine.spec import MachineSpec
from runtime.records.log_reader import read_throw_log
from sim_twin.child_processes import one_blas_thread

ONE_SIDED_NORMAL = 1.645
"""Standard deviations to either side that hold 90 % of a normal distribution."""
Ranges = dict[str, tuple[float, float] | str]


def training_ranges(
    throws: Sequence[ThrowData], spec: MachineSpec, seed: int = 0
) -> dict[str, Ranges]:
    """By joint: low and high of each parameter, or the reason why the throws do not determine it."""
    rng = np.random.default_rng(seed)
    references = [_reference(throw) for throw in throws]
    with one_blas_thread():
        return {
            name: _joint(throws, spec, joint, references, rng)
            for joint, name in enumerate(ACTIVE_JOINTS)
        }


def _reference(throw: ThrowData) -> Array:
    """Velocity references of the controller (T, 4) on the log's grid, held between samples."""
    rows = read_throw_log(throw.path).control
    t_s = (rows["t_mono_ns"] - throw.recorded_at_ns).astype(np.float64) * 1e-9
    before = np.clip(np.searchsorted(t_s, throw.t_s + 0.003) - 1, 0, None)
    return np.nan_to_num(rows["velocity_reference_rad_m_per_s"].astype(np.float64)[before])


def _joint(
    throws: Sequence[ThrowData],
    spec: MachineSpec,
    joint: int,
    references: Sequence[Array],
    rng: np.random.Generator,
) -> Ranges:
    record = drive_record(throws, spec, joint, references)
    limit = spec.limits.speed_positive_rad_m_per_s[joint]
    moved = [moved_blocks(record, sign, limit) for sign in (1.0, -1.0)]
    count = int((moved[0] | moved[1]).sum())
    names = ("dead_time_s", "natural_frequency_rad_per_s", "damping_ratio")
    if count < MIN_BLOCKS:
        why = f"cannot be known from these logs: {count} throws use it, {MIN_BLOCKS} are needed"
        return dict.fromkeys((*names, "gain_positive_ratio", "gain_negative_ratio"), why)
    shared = fit(record, moved[0] | moved[1], True, rng)
    known = quantities(shared, 0, count)
    found: Ranges = {name: _range(known[name], name) for name in names}
    free = fit(record, moved[0] | moved[1], False, rng, shared)
    for k, direction in enumerate(("positive", "negative")):
        used_count = int(moved[k].sum())
        found[f"gain_{direction}_ratio"] = (
            _range(quantities(free, k, used_count)["gain_ratio"], "gain_ratio")
            if used_count >= MIN_BLOCKS
            else f"cannot be known from these logs: {used_count} throws use it, {MIN_BLOCKS} are needed"
        )
    return found


def _range(known: Quantity, name: str) -> tuple[float, float] | str:
    if known.value is None:
        return known.why
    half = ONE_SIDED_NORMAL * (known.spread or 0.0)
    bounds = {"dead_time_s": 0, "damping_ratio": 2, "gain_ratio": 3}
    low, high = known.value - half, known.value + half
    if name in bounds:
        low, high = max(low, float(LOW[bounds[name]])), min(high, float(HIGH[bounds[name]]))
    return max(low, 0.25 * known.value), high
