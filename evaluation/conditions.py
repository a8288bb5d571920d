"""Accuracy by condition: pace from careful to fast, target height on and off the ground."""

from collections.abc import Sequence

import numpy as np
from pydantic import BaseModel, ConfigDict

from evaluation.campaigns import Campaign, throw_campaign
from evaluation.progress import progress_line
from sim_twin.throws.accuracy import landing_errors
from sim_twin.throws.campaign import ThrowOutcome, ThrowResult

PACES = (0.0, 0.25, 0.5, 0.75, 1.0)
PACE_RANGES_M = (7.5, 9.0, 10.0)
HEIGHTS_M = (-1.0, 0.0, 1.0, 2.0, 3.0)
HEIGHT_RANGES_M = (7.0, 8.0, 9.0)
MAX_CONDITION_THROW_COUNT = 100
"""Throws per condition are limited because there are many conditions."""
ERROR_NAMES = (
    "mean_downrange_error_m",
    "sd_downrange_m",
    "mean_crossrange_error_m",
    "sd_crossrange_m",
)
"""Fields of a row that are lengths, m, frame `throw`."""


class ConditionRow(BaseModel):
    """Landings under one condition, m, frame `throw`; None where fewer than two throws landed."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)
    range_m: float
    height_m: float
    pace_ratio: float
    throw_count: int
    landed_count: int
    mean_downrange_error_m: float | None
    sd_downrange_m: float | None
    mean_crossrange_error_m: float | None
    sd_crossrange_m: float | None
    start_to_release_s: float | None
    """Mean of the throws that landed."""
    release_speed_m_per_s: float | None
    """Mean of the throws that landed."""


def condition_row(
    range_m: float, height_m: float, pace_ratio: float, results: Sequence[ThrowResult]
) -> ConditionRow:
    """Summarise the throws at one target and one pace."""
    down, cross = landing_errors(results)
    landed = [r for r in results if r.outcome is ThrowOutcome.LANDED]
    numbers: dict[str, float] = {}
    if len(landed) >= 2:
        numbers = {
            "mean_downrange_error_m": float(down.mean()),
            "sd_downrange_m": float(down.std(ddof=1)),
            "mean_crossrange_error_m": float(cross.mean()),
            "sd_crossrange_m": float(cross.std(ddof=1)),
            "start_to_release_s": float(np.mean([r.throw_duration_s for r in landed])),
            "release_speed_m_per_s": float(np.mean([r.release_speed_m_per_s for r in landed])),
        }
    empty = dict.fromkeys(ConditionRow.model_fields)
    known = {
        "range_m": range_m,
        "height_m": height_m,
        "pace_ratio": pace_ratio,
        "throw_count": len(results),
        "landed_count": len(landed),
    }
    return ConditionRow.model_validate({**empty, **known, **numbers})


def root_mean_square(rows: Sequence[ConditionRow], name: str) -> float | None:
    """Root mean square of a field over the rows that have it; None where no row has."""
    values = [v for v in (getattr(row, name) for row in rows) if v is not None]
    return float(np.sqrt(np.mean(np.square(values)))) if values else None


def condition_rows(campaign: Campaign, throws: int, seed: int) -> list[ConditionRow]:
    """Throw a campaign; one row per target."""
    results = throw_campaign(campaign, min(throws, MAX_CONDITION_THROW_COUNT), seed)
    return [
        condition_row(range_m, height_m, campaign.pace_ratio, part)
        for (range_m, height_m), part in zip(campaign.places, results, strict=True)
    ]


def pace_rows(campaign: Campaign, throws: int, seed: int) -> list[ConditionRow]:
    """Throw the same throws at five paces; empty for a policy that was trained without a pace."""
    policy = campaign.params.policy
    if policy is None or not policy.is_paced:
        return []
    show = progress_line("paces", "campaigns")
    found: list[ConditionRow] = []
    for number, pace in enumerate(PACES):
        at_pace = campaign._replace(ranges_m=PACE_RANGES_M, heights_m=(0.0,), pace_ratio=pace)
        found += condition_rows(at_pace, throws, seed)
        show(number + 1, len(PACES))
    return found


def height_rows(campaign: Campaign, throws: int, seed: int) -> list[ConditionRow]:
    """Throw the same ranges on the ground, below it and above it; empty for a policy of the ground alone."""
    policy = campaign.params.policy
    if policy is None or policy.card.target_height_max_m <= policy.card.target_height_min_m:
        return []
    lowest, highest = policy.card.target_height_min_m, policy.card.target_height_max_m
    heights = tuple(height for height in HEIGHTS_M if lowest <= height <= highest)
    raised = campaign._replace(ranges_m=HEIGHT_RANGES_M, heights_m=heights)
    return condition_rows(raised, throws, seed)


def condition_table(rows: Sequence[ConditionRow]) -> str:
    """Rows as text for a terminal."""
    lines = ["range/m  height/m  pace  landed  down mean/sd, m  cross mean/sd, m  release"]
    for row in rows:
        down = _mean_and_deviation(row.mean_downrange_error_m, row.sd_downrange_m)
        cross = _mean_and_deviation(row.mean_crossrange_error_m, row.sd_crossrange_m)
        time, speed = row.start_to_release_s, row.release_speed_m_per_s
        release = "-" if time is None or speed is None else f"{time:.2f} s, {speed:.2f} m/s"
        lines.append(
            f"{row.range_m:7.2f}  {row.height_m:+8.1f}  {row.pace_ratio:4.2f}  "
            f"{row.landed_count:3d}/{row.throw_count:<3d} {down:>15} {cross:>16}  {release}"
        )
    return "\n".join(lines)


def _mean_and_deviation(mean: float | None, sd: float | None) -> str:
    return "-" if mean is None or sd is None else f"{mean:+.3f}/{sd:.3f}"
