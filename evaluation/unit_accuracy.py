"""Accuracy on other machines of the type: each is calibrated and registered as at commissioning."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from evaluation.campaign_registration import register_campaign
from evaluation.campaigns import CampaignOptions, open_with
from evaluation.conditions import (
    ERROR_NAMES,
    ConditionRow,
    condition_rows,
    root_mean_square,
)
from evaluation.measures import UnitRow

NOMINAL_UNIT = 0
FIRST_UNIT = 2000
"""Lower numbers were used in training and development."""
UNIT_TARGETS = "7.5,8.5,9.5"
MAX_UNIT_THROW_COUNT = 60
"""Throws per target and machine in a report."""


def throw_unit(mode: str, options: CampaignOptions, unit_seed: int) -> list[ConditionRow]:
    """Throw with one machine at the targets of the options; one row per target."""
    here = options._replace(unit_seed=unit_seed, calibration=None, tables=None, heights="0")
    campaign = register_campaign(open_with(here, mode, UNIT_TARGETS), options.seed)
    return condition_rows(campaign, options.throws, options.seed)


def unit_row(mode: str, options: CampaignOptions, unit_seed: int) -> UnitRow:
    """Throw with one machine at the targets of the report, and summarise."""
    throws = min(options.throws, MAX_UNIT_THROW_COUNT)
    rows = throw_unit(mode, options._replace(targets=UNIT_TARGETS, throws=throws), unit_seed)
    return UnitRow(
        unit_seed=unit_seed,
        landed_count=sum(row.landed_count for row in rows),
        throw_count=sum(row.throw_count for row in rows),
        targets=tuple(rows),
        **{name: root_mean_square(rows, name) for name in ERROR_NAMES},
    )


def throw_units(
    mode: str, options: CampaignOptions, count: int, first: int
) -> Iterator[tuple[int, list[ConditionRow]]]:
    """Throw with the nominal machine and `count` others; machine number and rows, one machine at a time."""
    for unit_seed in (NOMINAL_UNIT, *range(first, first + count)):
        yield unit_seed, throw_unit(mode, options, unit_seed)


def compare_units(units: Mapping[int, Sequence[ConditionRow]]) -> dict[str, float]:
    """Spread of the other machines beside the nominal machine's; the keys are for people."""
    others = [rows for unit, rows in units.items() if unit != NOMINAL_UNIT]
    found: dict[str, float] = {}
    for way in ("downrange", "crossrange"):
        nominal = root_mean_square(units[NOMINAL_UNIT], f"sd_{way}_m")
        spreads = [root_mean_square(rows, f"sd_{way}_m") for rows in others]
        known = [s for s in spreads if s is not None]
        if nominal is None or not known:
            continue
        found |= {
            f"sd {way} of unit 0, m": nominal,
            f"sd {way}, median unit, m": float(np.median(known)),
            f"sd {way}, worst unit, m": max(known),
            f"median over unit 0, {way}": float(np.median(known)) / nominal,
            f"worst over unit 0, {way}": max(known) / nominal,
        }
        misses = [root_mean_square(rows, f"mean_{way}_error_m") for rows in others]
        found[f"mean {way} error, rms over units, m"] = float(
            np.sqrt(np.mean([m * m for m in misses if m is not None]))
        )
    landed = sum(row.landed_count for rows in others for row in rows)
    found["landed share of the units"] = landed / sum(
        row.throw_count for rows in others for row in rows
    )
    return found
