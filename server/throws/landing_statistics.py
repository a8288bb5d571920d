"""Statistics of measured landings: scatter, one sigma ellipses by group, and error against range."""

import math
from collections import defaultdict
from collections.abc import Sequence
from operator import attrgetter
from typing import Any, NamedTuple

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
    keys = list(map(attrgetter(_KEYS[group_by]), rows))
    groups: dict[str, list[int]] = defaultdict(list)
    for index, key in enumerate(keys):
        groups[key].append(index)
    # By columns: attributes of each row cost as much as all the rest.
    columns: dict[str, tuple[Any, ...]] = dict.fromkeys(Measured._fields, ())
    columns |= zip(Measured._fields, zip(*rows, strict=True), strict=bool(rows))
    errors = np.array([columns["downrange_error_m"], columns["crossrange_error_m"]]).T
    range_m = np.array(columns["range_m"])
    ordered = [(key, np.array(members)) for key, members in sorted(groups.items())]
    return ThrowStats(
        considered_count=len(rows),
        is_truncated=is_truncated,
        group_by=group_by,
        groups=tuple(
            _group(key, _label(rows[members[0]], key, group_by), errors[members])
            for key, members in ordered
        ),
        points=tuple(
            map(
                ScatterPoint,
                columns["throw_id"],
                keys,
                columns["range_m"],
                columns["downrange_error_m"],
                columns["crossrange_error_m"],
                columns["predicted_downrange_error_m"],
                columns["predicted_crossrange_error_m"],
            )
        ),
        by_range=tuple(
            item
            for key, members in ordered
            for item in _bins(key, range_m[members], errors[members])
        ),
    )


_KEYS = {
    GroupBy.POLICY: "policy_sha256",
    GroupBy.MODE: "mode",
    GroupBy.MACHINE: "machine_id",
    GroupBy.OPERATOR: "operator",
}


def _label(row: Measured, key: str, group_by: GroupBy) -> str:
    return row.policy_id if group_by is GroupBy.POLICY else key


def _group(key: str, label: str, errors: Array) -> GroupStats:
    """Accuracy of one group; errors (N, 2) are downrange and crossrange, m."""
    mean = errors.mean(axis=0)
    miss = np.hypot(errors[:, 0], errors[:, 1])
    sd = correlation = axes = None
    if len(errors) > 1:
        covariance = np.cov(errors.T)
        sd = np.sqrt(np.diag(covariance))
        scale = float(sd[0] * sd[1])
        correlation = float(np.clip(covariance[0, 1] / scale, -1.0, 1.0)) if scale > 0.0 else 0.0
        axes = _ellipse(covariance)
    return GroupStats(
        group=key,
        label=label,
        throw_count=len(errors),
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


def _bins(key: str, range_m: Array, errors: Array) -> list[RangeStats]:
    """Accuracy in bins of target range; range_m (N,), errors (N, 2), m."""
    _, which = np.unique(np.round(range_m / RANGE_BIN_M), return_inverse=True)
    counts = np.bincount(which)
    # All bins at once: a call of numpy for each of some hundred bins costs more than the throws do.
    values = (range_m, errors[:, 0], errors[:, 1])
    centre_m, *means = (np.bincount(which, value) / counts for value in values)
    off = [(errors[:, axis] - mean[which]) ** 2 for axis, mean in enumerate(means)]
    sds = [np.sqrt(np.bincount(which, one) / np.maximum(counts - 1, 1)) for one in off]
    return [
        RangeStats(
            group=key,
            range_m=float(centre_m[index]),
            throw_count=int(count),
            mean_downrange_error_m=float(means[0][index]),
            mean_crossrange_error_m=float(means[1][index]),
            sd_downrange_m=float(sds[0][index]) if count > 1 else None,
            sd_crossrange_m=float(sds[1][index]) if count > 1 else None,
        )
        for index, count in enumerate(counts)
    ]
