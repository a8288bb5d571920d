"""What a report throws besides its campaign: repeated starts, other machines, other trainings."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from cli.campaigns import Campaign, CampaignOptions, campaign_starts, open_with
from cli.conditions import rows_of
from cli.registration import is_registered, open_aimed, registered
from diagnosis.evaluation.conditions import pooled
from diagnosis.evaluation.measures import TrainingRow, UnitRow
from diagnosis.evaluation.spread import SpreadParts, spread_parts
from machine.errors import UsageError
from machine.policy_card import load_card
from sim_twin.throws.campaign import run_throws

REPEATED_STARTS, REPEATS = 25, 4
FIRST_UNIT = 2000
UNIT_RANGES = "7.5,8.5,9.5"
UNIT_THROWS = 60
TRAINING_THROWS = 60


def repeated_starts(campaign: Campaign, range_m: float, seed: int) -> SpreadParts | None:
    """Throws repeated from the same starts, split into what hangs on the start and what is chance."""
    target_m, starts = campaign_starts(
        campaign._replace(ranges_m=(range_m,), heights_m=(0.0,)), REPEATED_STARTS, seed
    )
    plant = campaign.make(REPEATED_STARTS * REPEATS)
    try:
        results = run_throws(
            plant,
            campaign.params,
            np.repeat(target_m, REPEATS, axis=0),
            np.repeat(starts, REPEATS, axis=0),
            seed,
            pace_ratio=campaign.pace_ratio,
        )
    finally:
        plant.close()
    groups = [results[i : i + REPEATS] for i in range(0, len(results), REPEATS)]
    return spread_parts(range_m, groups)


def unit_row(mode: str, options: CampaignOptions, unit: int) -> UnitRow:
    """One machine, measured and registered by itself."""
    here = _anew(options)._replace(unit_seed=unit, targets=UNIT_RANGES)
    campaign = registered(open_with(here, mode, UNIT_RANGES), options.seed)
    rows = rows_of(campaign, min(options.throws, UNIT_THROWS), options.seed)
    names = (
        "mean_downrange_error_m",
        "sd_downrange_m",
        "mean_crossrange_error_m",
        "sd_crossrange_m",
    )
    return UnitRow(
        unit_seed=unit,
        landed_count=sum(row.landed_count for row in rows),
        throw_count=sum(row.throw_count for row in rows),
        targets=tuple(rows),
        **{name: pooled(rows, name) for name in names},
    )


def training_rows(
    mode: str, options: CampaignOptions, folder: Path, default_targets: str
) -> tuple[TrainingRow, ...]:
    """One training of the mode, registered by itself; others' at the same targets, from the same starts."""
    card = load_card(folder)
    if card.mode.value != mode:
        return ()
    here = _anew(options)._replace(policy=folder)
    campaign = open_aimed(here, mode, default_targets).campaign
    return tuple(
        TrainingRow(
            policy=card.policy_id,
            training_seed=card.training.seed_count,
            step_count=card.training.environment_step_count,
            is_registered=is_registered(campaign),
            row=row,
        )
        for row in rows_of(campaign, min(options.throws, TRAINING_THROWS), options.seed)
    )


def _anew(options: CampaignOptions) -> CampaignOptions:
    """Options of a machine that is measured and registered anew."""
    return options._replace(calibration=None, tables=None, heights="0")


def check_parts(
    options: CampaignOptions, units: int, first_unit: int, trainings: Sequence[Path]
) -> None:
    """Refuse what cannot be thrown, before anything is.

    Raises:
        UsageError: a number of units that is none, or units of a plant that has only one.
        PolicyError: a folder without a policy.
    """
    if units < 0:
        raise UsageError(f"--units {units}: 0 or more")
    if first_unit < 1:
        raise UsageError(f"--first-unit {first_unit}: 1 or more; 0 is the nominal machine")
    if units and options.plant == "twin":
        raise UsageError("--units asks for other machines, the twin is one: use --plant virtual")
    for folder in trainings:
        load_card(folder)
