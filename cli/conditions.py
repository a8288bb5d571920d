"""Campaigns over what an operator may ask for: pace from careful to fast, targets off the ground."""

from collections.abc import Sequence

from cli.campaigns import Campaign, progress_line, throw_campaign
from diagnosis.evaluation.conditions import ConditionRow, condition_row

PACES = (0.0, 0.25, 0.5, 0.75, 1.0)
PACE_RANGES_M = (7.5, 9.0, 10.0)
HEIGHTS_M = (-1.0, 0.0, 1.0, 2.0, 3.0)
HEIGHT_RANGES_M = (7.0, 8.0, 9.0)
MOST_THROWS = 100
"""A condition's throws are no more than this: there are many conditions."""


def pace_rows(campaign: Campaign, throws: int, seed: int) -> list[ConditionRow]:
    """The front: the same throws at five paces; none for a policy that knows no pace."""
    policy = campaign.params.policy
    if policy is None or not policy.is_paced:
        return []
    show = progress_line("paces", "campaigns")
    found: list[ConditionRow] = []
    for number, pace in enumerate(PACES):
        at_pace = campaign._replace(ranges_m=PACE_RANGES_M, heights_m=(0.0,), pace_ratio=pace)
        found += rows_of(at_pace, throws, seed)
        show(number + 1, len(PACES))
    return found


def height_rows(campaign: Campaign, throws: int, seed: int) -> list[ConditionRow]:
    """The same ranges on the ground, in a pit and raised; none for a policy of the ground alone."""
    policy = campaign.params.policy
    if policy is None or policy.card.target_height_max_m <= policy.card.target_height_min_m:
        return []
    lowest, highest = policy.card.target_height_min_m, policy.card.target_height_max_m
    heights = tuple(height for height in HEIGHTS_M if lowest <= height <= highest)
    raised = campaign._replace(ranges_m=HEIGHT_RANGES_M, heights_m=heights)
    return rows_of(raised, throws, seed)


def rows_of(campaign: Campaign, throws: int, seed: int) -> list[ConditionRow]:
    """Throw a campaign; a row a target."""
    results = throw_campaign(campaign, min(throws, MOST_THROWS), seed)
    return [
        condition_row(range_m, height_m, campaign.pace_ratio, part)
        for (range_m, height_m), part in zip(campaign.places, results, strict=True)
    ]


def table(rows: Sequence[ConditionRow]) -> str:
    """Rows for people."""
    lines = ["range/m  height/m  pace  landed  down mean/sd, m  cross mean/sd, m  release"]
    for row in rows:
        down = _pair(row.mean_downrange_error_m, row.sd_downrange_m)
        cross = _pair(row.mean_crossrange_error_m, row.sd_crossrange_m)
        time, speed = row.start_to_release_s, row.release_speed_m_per_s
        release = "-" if time is None or speed is None else f"{time:.2f} s, {speed:.2f} m/s"
        lines.append(
            f"{row.range_m:7.2f}  {row.height_m:+8.1f}  {row.pace_ratio:4.2f}  "
            f"{row.landed_count:3d}/{row.throw_count:<3d} {down:>15} {cross:>16}  {release}"
        )
    return "\n".join(lines)


def _pair(mean: float | None, sd: float | None) -> str:
    return "-" if mean is None or sd is None else f"{mean:+.3f}/{sd:.3f}"
