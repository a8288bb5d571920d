"""Accuracy of a campaign: one row per target, as JSON and as a text table."""

from collections.abc import Sequence

import numpy as np
from typing_extensions import TypedDict

from machine.conventions import Array
from sim_twin.throws.campaign import ThrowOutcome, ThrowResult


class TargetAccuracy(TypedDict):
    """Landings at one target; None for values that need more landed throws."""

    range_m: float
    height_m: float
    """Height of the target surface above ground."""
    throws: int
    landed: int
    success_ratio: float
    mean_downrange_error_m: float | None
    sd_downrange_m: float | None
    mean_crossrange_error_m: float | None
    sd_crossrange_m: float | None


class AccuracyReport(TypedDict):
    """Result of ``downrange evaluate``."""

    mode: str
    plant: str
    policy: str
    is_registered: bool
    """Whether aim points were corrected by a registration of this policy."""
    seed: int
    seconds: float
    """Wall time of the throws without calibration."""
    real_time_factor: float
    """Simulated time of all throws, each up to its end, over wall time."""
    targets: list[TargetAccuracy]


def landing_errors(results: Sequence[ThrowResult]) -> tuple[Array, Array]:
    """Downrange and crossrange errors of the landed throws."""
    landed = [r for r in results if r.outcome is ThrowOutcome.LANDED]
    return (
        np.array([r.downrange_error_m for r in landed]),
        np.array([r.crossrange_error_m for r in landed]),
    )


def target_accuracy(
    range_m: float, results: Sequence[ThrowResult], height_m: float = 0.0
) -> TargetAccuracy:
    """Row of one target; standard deviations of the sample (n - 1)."""
    down, cross = landing_errors(results)
    has_mean, has_spread = down.size >= 1, down.size >= 2
    return TargetAccuracy(
        range_m=range_m,
        height_m=height_m,
        throws=len(results),
        landed=int(down.size),
        success_ratio=down.size / len(results),
        mean_downrange_error_m=float(down.mean()) if has_mean else None,
        sd_downrange_m=float(down.std(ddof=1)) if has_spread else None,
        mean_crossrange_error_m=float(cross.mean()) if has_mean else None,
        sd_crossrange_m=float(cross.std(ddof=1)) if has_spread else None,
    )


def outcome_counts(results: Sequence[ThrowResult]) -> dict[str, int]:
    """Number of throws by outcome, without zeros."""
    counts = {kind.value: sum(r.outcome is kind for r in results) for kind in ThrowOutcome}
    return {kind: count for kind, count in counts.items() if count}


def bad_throws_text(results: Sequence[ThrowResult]) -> str:
    """Outcomes of the throws that did not land, as text; empty if all landed."""
    bad = [r for r in results if r.outcome is not ThrowOutcome.LANDED]
    if not bad:
        return ""
    kinds = ", ".join(f"{count} {kind}" for kind, count in outcome_counts(bad).items())
    after = sum(np.isfinite(r.throw_duration_s) for r in bad)
    return f"{len(bad)} of {len(results)} throws ended badly: {kinds} ({after} after the opening command)"


def accuracy_table(report: AccuracyReport) -> str:
    """The report as a table."""
    lines = [
        f"{report['mode']} on {report['plant']}, policy {report['policy']}, seed {report['seed']}",
        "range/m  height/m  throws  landed  mean down/m  sd down/m  mean cross/m  sd cross/m",
    ]
    for row in report["targets"]:
        down, cross = _cell(row["mean_downrange_error_m"]), _cell(row["mean_crossrange_error_m"])
        sd_down, sd_cross = _cell(row["sd_downrange_m"], ""), _cell(row["sd_crossrange_m"], "")
        lines.append(
            f"{row['range_m']:7.2f}  {row['height_m']:8.1f}  {row['throws']:6d}  "
            f"{row['landed']:6d}  {down:>11}  "
            f"{sd_down:>9}  {cross:>12}  {sd_cross:>10}"
        )
    lines.append(
        f"{report['seconds']:.1f} s, {report['real_time_factor']:.0f} times faster than real time"
    )
    return "\n".join(lines)


def _cell(value: float | None, sign: str = "+") -> str:
    return "-" if value is None else f"{value:{sign}.3f}"
