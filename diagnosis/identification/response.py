"""Response of each driven joint and direction from logs: dead time, lag, gain and limits, with intervals.

Model: y = sum over directions of g H(w, z) u(t - d). The steady speed u is what the valve tables give for
the command, set to zero outside the direction. H is the second-order response of the twin profile with lag
2 z / w. The intervals come from a bootstrap over blocks of the logs.
"""

from collections.abc import Sequence

import numpy as np
from pydantic import BaseModel, ConfigDict

from diagnosis.identification.drive_record import DriveRecord, drive_record, moved_blocks
from diagnosis.identification.quantity import Quantity, unknown
from diagnosis.identification.rate_limits import acceleration_limit, speed_limit
from diagnosis.identification.response_estimation import (
    NAMES,
    UNITS,
    Fitted,
    fit,
    quantities,
    simulate,
)
from diagnosis.loading.throw_data import ThrowData
from machine.conventions import ACTIVE_JOINTS, BoolArray
from machine.spec import MachineSpec
from sim_twin.child_processes import one_blas_thread

DIRECTIONS = ("positive", "negative")
MIN_BLOCKS = 4
"""Fewest blocks in which a direction moves for which an interval is given."""


class JointResponse(BaseModel):
    """Response of one joint: shared by both directions, per direction, and the quality of the fit."""

    model_config = ConfigDict(frozen=True)
    joint: str
    best: dict[str, float] | None
    """Estimate shared by both directions, in the twin's parameters; also where no interval can be given."""
    shared: dict[str, Quantity]
    directions: dict[str, dict[str, Quantity]]
    r2_ratio: float | None = None
    residual_rad_m_per_s: float | None = None
    block_count: int = 0


def identify_response(
    throws: Sequence[ThrowData], spec: MachineSpec, seed: int = 0
) -> tuple[JointResponse, ...]:
    """Response of all driven joints.

    Args:
        throws: of one machine.
        spec: its type.
        seed: of the bootstrap.
    """
    rng = np.random.default_rng(seed)
    with one_blas_thread():
        return tuple(_joint(throws, spec, joint, rng) for joint in range(len(ACTIVE_JOINTS)))


def _joint(
    throws: Sequence[ThrowData], spec: MachineSpec, joint: int, rng: np.random.Generator
) -> JointResponse:
    name = ACTIVE_JOINTS[joint]
    record = drive_record(throws, spec, joint)
    limit = spec.limits.speed_positive_rad_m_per_s[joint]
    moved = [moved_blocks(record, sign, limit) for sign in (1.0, -1.0)]
    counts = [int(m.sum()) for m in moved]
    both = moved[0] | moved[1]
    limits = _limits(record, spec, joint)
    if int(both.sum()) < MIN_BLOCKS:
        nothing = _nothing(f"{name} moved in {int(both.sum())} pieces, {MIN_BLOCKS} are needed")
        directions = {d: {**nothing, **limits[d]} for d in DIRECTIONS}
        return JointResponse(joint=name, best=None, shared=nothing, directions=directions)
    shared = fit(record, both, True, rng)
    free = fit(record, both, False, rng, shared) if min(counts) >= MIN_BLOCKS else shared
    directions: dict[str, dict[str, Quantity]] = {}
    for k, direction in enumerate(DIRECTIONS):
        if counts[k] >= MIN_BLOCKS:
            found = quantities(free, k, counts[k])
        else:
            found = _nothing(
                f"it moved {direction}ly in {counts[k]} pieces, {MIN_BLOCKS} are needed"
            )
        directions[direction] = {**found, **limits[direction]}
    error, share = _left(record, both, free)
    return JointResponse(
        joint=name,
        best=shared.as_profile(),
        shared=quantities(shared, 0, int(both.sum())),
        directions=directions,
        r2_ratio=share,
        residual_rad_m_per_s=error,
        block_count=int(both.sum()),
    )


def _nothing(why: str) -> dict[str, Quantity]:
    return {n: unknown(u, why) for n, u in zip(NAMES, UNITS, strict=True)}


def _limits(record: DriveRecord, spec: MachineSpec, joint: int) -> dict[str, dict[str, Quantity]]:
    unit = "m/s" if joint == 3 else "rad/s"
    return {
        direction: {
            "speed_limit": speed_limit(record, spec, joint, sign, unit),
            "acceleration_limit": acceleration_limit(record, joint, sign, f"{unit}2"),
        }
        for direction, sign in zip(DIRECTIONS, (1.0, -1.0), strict=True)
    }


def _left(record: DriveRecord, moved: BoolArray, fitted: Fitted) -> tuple[float, float]:
    """Root mean square of the residual, and the share of the variance that the model explains."""
    keep = record.used & moved[np.maximum(record.block, 0)]
    seen = record.measured[keep]
    error = (simulate(record, fitted.x) - record.measured)[keep]
    share = 1.0 - float(np.sum(error**2) / np.sum((seen - seen.mean()) ** 2))
    return float(np.sqrt(np.mean(error**2))), share
