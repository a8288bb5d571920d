"""Statistics of measured landings: scatter, one sigma ellipses by group, and error against range."""

import math
from collections import defaultdict
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from machine.conventions import Array
from server.schemas.history import (
    GroupBy,
    GroupStats,
    RangeStats,
    ScatterPoint,
    ThrowStats,
)

RANGE_BIN_M = 0.5


class Measured(NamedTuple):
    """What statistics need of a throw; whole rows would cost ten times as much."""

    throw_id: str
    machine_id: str
    operator: str
    mode: str
    policy_id: str
    policy_sha256: str
    range_m: float
    downrange_error_m: float
    crossrange_error_m: float
    predicted_downrange_error_m: float | None
    predicted_crossrange_error_m: float | None


def statistics_of(
    rows: Sequence[Measured], group_by: GroupBy, *, is_truncated: bool = False
) -> ThrowStats:
    """Statistics of measured throws."""
    groups: dict[str, list[Measured]] = defaultdict(list)
    for row in rows:
        groups[_key(row, group_by)].append(row)
    ordered = sorted(groups.items())
    return ThrowStats(
        considered_count=len(rows),
        is_truncated=is_truncated,
        group_by=group_by,
        groups=tuple(_group(key, members, group_by) for key, members in ordered),
        points=tuple(_point(row, _key(row, group_by)) for row in rows),
        by_range=tuple(item for key, members in ordered for item in _bins(key, members)),
    )


def _key(row: Measured, group_by: GroupBy) -> str:
    return {
        GroupBy.POLICY: row.policy_sha256,
        GroupBy.MODE: row.mode,
        GroupBy.MACHINE: row.machine_id,
        GroupBy.OPERATOR: row.operator,
    }[group_by]


def _label(row: Measured, group_by: GroupBy) -> str:
    return row.policy_id if group_by is GroupBy.POLICY else _key(row, group_by)


def _errors(rows: Sequence[Measured]) -> Array:
    """Downrange and crossrange errors, shape (N, 2), m."""
    return np.array([(r.downrange_error_m, r.crossrange_error_m) for r in rows])


def _group(key: str, rows: Sequence[Measured], group_by: GroupBy) -> GroupStats:
    errors = _errors(rows)
    mean = errors.mean(axis=0)
    miss = np.hypot(errors[:, 0], errors[:, 1])
    sd = correlation = axes = None
    if len(rows) > 1:
        covariance = np.cov(errors.T)
        sd = np.sqrt(np.diag(covariance))
        scale = float(sd[0] * sd[1])
        correlation = float(np.clip(covariance[0, 1] / scale, -1.0, 1.0)) if scale > 0.0 else 0.0
        axes = _ellipse(covariance)
    return GroupStats(
        group=key,
        label=_label(rows[0], group_by),
        throw_count=len(rows),
        mean_downrange_error_m=float(mean[0]),
        mean_crossrange_error_m=float(mean[1]),
        sd_downrange_m=None if sd is None else float(sd[0]),
        sd_crossrange_m=None if sd is None else float(sd[1]),
        correlation_ratio=correlation,
        ellipse_major_m=None if axes is None else axes[0],
        ellipse_minor_m=None if axes is None else axes[1],
        ellipse_angle_rad=None if axes is None else axes[2],
        mean_miss_m=float(miss.mean()),
        median_miss_m=float(np.median(miss)),
    )


def _ellipse(covariance: Array) -> tuple[float, float, float]:
    """Semi-axes (m) and angle (rad) of the one sigma ellipse of a covariance (2, 2)."""
    values, vectors = np.linalg.eigh(covariance)
    values = np.sqrt(np.maximum(values, 0.0))
    angle = math.atan2(float(vectors[1, 1]), float(vectors[0, 1]))
    # An axis has no direction: keep the angle within a half turn.
    angle = (angle + math.pi / 2) % math.pi - math.pi / 2
    return float(values[1]), float(values[0]), angle


def _point(row: Measured, key: str) -> ScatterPoint:
    return ScatterPoint(
        throw_id=row.throw_id,
        group=key,
        range_m=row.range_m,
        downrange_error_m=row.downrange_error_m,
        crossrange_error_m=row.crossrange_error_m,
        predicted_downrange_error_m=row.predicted_downrange_error_m,
        predicted_crossrange_error_m=row.predicted_crossrange_error_m,
    )


def _bins(key: str, rows: Sequence[Measured]) -> list[RangeStats]:
    bins: dict[int, list[Measured]] = defaultdict(list)
    for row in rows:
        bins[round(row.range_m / RANGE_BIN_M)].append(row)
    result: list[RangeStats] = []
    for _, members in sorted(bins.items()):
        errors = _errors(members)
        sd = errors.std(axis=0, ddof=1) if len(members) > 1 else None
        result.append(
            RangeStats(
                group=key,
                range_m=float(np.mean([row.range_m for row in members])),
                throw_count=len(members),
                mean_downrange_error_m=float(errors[:, 0].mean()),
                mean_crossrange_error_m=float(errors[:, 1].mean()),
                sd_downrange_m=None if sd is None else float(sd[0]),
                sd_crossrange_m=None if sd is None else float(sd[1]),
            )
        )
    return result
