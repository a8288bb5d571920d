"""Why the widest machine scatters more: the same throws with one property at a time at its nominal value.

Every variant of the machine is calibrated and registered again, because a registration removes mean errors
and mean errors are no spread.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict

from evaluation.campaign_registration import register_campaign
from evaluation.campaigns import CampaignOptions, open_with, throw_campaign
from evaluation.execution.executor import Executor, run_tasks
from evaluation.sensitivity import CONFIDENCE_RATIO, paired_errors
from machine.conventions import Array
from machine.spec import load_spec
from sim_twin.commissioning.valve_calibration import CALIBRATION_STEP_COUNT, calibrate
from sim_twin.confidence_intervals import Interval
from sim_twin.throws.campaign import ThrowResult
from sim_twin.virtual.properties import PROPERTIES, as_drawn
from sim_twin.virtual.units import MachineUnit, make_unit
from sim_twin.virtual_machine import Condition, VirtualMachine

Direction = Literal["downrange", "crossrange"]
BOOTSTRAP_COUNT = 4000
MAX_ABLATION_THROW_COUNT = 200
"""Throws per variant; a variant takes about 10 s."""


class WidestUnit(NamedTuple):
    """One machine, one target and one direction."""

    unit_seed: int
    range_m: float
    direction: Direction
    sd_m: float
    """In the throws by which the machine was chosen."""
    nominal_sd_m: float
    """Of the nominal machine at the same target."""


class PropertyShare(BaseModel):
    """The machine with one property at its nominal value."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)
    name: str
    sd_m: float
    share_ratio: float | None
    """Variance removed, over the variance removed by all properties together; None where that is zero."""
    share_ci95_ratio: Interval | None
    failed_count: int
    """Throws that landed with the machine as built and not with this variant."""


class PropertyAblation(BaseModel):
    """The widest machine and the share of each property; standard deviations in m of paired throws."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)
    unit_seed: int
    range_m: float
    way: Direction
    chosen_sd_m: float
    """In the throws by which the machine was chosen. It is biased upwards: the largest of many."""
    chosen_nominal_sd_m: float
    pair_count: int
    """Throws that landed in all runs."""
    sd_m: float
    """As built, in throws that are independent of the choice."""
    drawn_sd_m: float
    """All properties nominal, the same throws."""
    gain_m: float
    gain_ci95_m: Interval
    properties: tuple[PropertyShare, ...]
    """By standard deviation, smallest first."""
    single_sum_ratio: float | None
    """Sum of the shares: 1 for properties that act independently, more where several must coincide, less
    where one of several suffices."""
    single_sum_ci95_ratio: Interval | None


def ablate_properties(
    mode: str, options: CampaignOptions, chosen: WidestUnit, executor: Executor
) -> PropertyAblation | None:
    """Throw with the machine as built, with all properties nominal, and with each property nominal.

    Only virtual machines can be changed in this way.
    """
    at = f"{chosen.range_m}"
    here = options._replace(
        unit_seed=chosen.unit_seed, targets=at, calibration=None, tables=None, heights="0"
    )
    runs = ((), tuple(PROPERTIES), *((name,) for name in PROPERTIES))
    tasks = [partial(_throw, mode, here, run) for run in runs]
    built, drawn, *single = run_tasks(tasks, executor, f"widest machine, {mode}")
    return property_ablation(chosen, built, drawn, dict(zip(PROPERTIES, single, strict=True)))


def property_ablation(
    chosen: WidestUnit,
    built: Sequence[ThrowResult],
    drawn: Sequence[ThrowResult],
    single: Mapping[str, Sequence[ThrowResult]],
) -> PropertyAblation | None:
    """Compare runs of the same throws.

    Args:
        chosen: the machine, its target and the direction in which it scatters.
        built: throws of the machine as built.
        drawn: throws with all properties nominal.
        single: throws with one property nominal, by its name.

    Returns:
        None where fewer than three throws landed in all runs.
    """
    runs = paired_errors((built, drawn, *single.values()))
    error_m = runs.crossrange_m if chosen.direction == "crossrange" else runs.downrange_m
    pairs = error_m.shape[1]
    if pairs < 3:
        return None
    picks = np.random.default_rng(0).integers(pairs, size=(BOOTSTRAP_COUNT, pairs))
    variance_m2 = error_m.var(axis=1, ddof=1)
    resampled_m2 = np.stack([row[picks].var(axis=1, ddof=1) for row in error_m])
    sd_m, resampled_m = np.sqrt(variance_m2), np.sqrt(resampled_m2)
    gain_ci95_m = _interval(resampled_m[0] - resampled_m[1])
    # Divided by the measured total, not the resampled one, which may be close to zero.
    added_m2 = variance_m2[0] - variance_m2[1] if gain_ci95_m[0] > 0.0 else None
    share = None if added_m2 is None else (variance_m2[0] - variance_m2[2:]) / added_m2
    shares = None if added_m2 is None else (resampled_m2[0] - resampled_m2[2:]) / added_m2
    rows = [
        PropertyShare(
            name=name,
            sd_m=float(sd_m[2 + k]),
            share_ratio=None if share is None else float(share[k]),
            share_ci95_ratio=None if shares is None else _interval(shares[k]),
            failed_count=int(runs.failed_count[2 + k]),
        )
        for k, name in enumerate(single)
    ]
    return PropertyAblation(
        unit_seed=chosen.unit_seed,
        range_m=chosen.range_m,
        way=chosen.direction,
        chosen_sd_m=chosen.sd_m,
        chosen_nominal_sd_m=chosen.nominal_sd_m,
        pair_count=pairs,
        sd_m=float(sd_m[0]),
        drawn_sd_m=float(sd_m[1]),
        gain_m=float(sd_m[0] - sd_m[1]),
        gain_ci95_m=gain_ci95_m,
        properties=tuple(sorted(rows, key=lambda row: row.sd_m)),
        single_sum_ratio=None if share is None else float(share.sum()),
        single_sum_ci95_ratio=None if shares is None else _interval(shares.sum(axis=0)),
    )


def _interval(values: Array) -> Interval:
    tail = 0.5 * (1.0 - CONFIDENCE_RATIO)
    low, high = np.quantile(values, [tail, 1.0 - tail])
    return float(low), float(high)


def _throw(mode: str, options: CampaignOptions, properties: Sequence[str]) -> list[ThrowResult]:
    """Calibrate, register and throw the machine with these properties nominal."""
    spec = load_spec()
    unit = as_drawn(spec, make_unit(spec, options.unit_seed), properties)
    machine = _machine(unit, CALIBRATION_STEP_COUNT)
    try:
        tables = calibrate(machine, spec, "virtual")
    finally:
        machine.close()
    campaign = open_with(options._replace(tables=tables), mode, "")._replace(
        make=lambda count: _machine(unit, count)
    )
    # Another seed than the throws by which the machine was chosen, so that the result is unbiased.
    results = throw_campaign(
        register_campaign(campaign, options.seed),
        min(options.throws, MAX_ABLATION_THROW_COUNT),
        options.seed + 1,
    )
    return results[0]


def _machine(unit: MachineUnit, count: int) -> VirtualMachine:
    return VirtualMachine(count=count, unit_seed=unit.unit_seed, condition=Condition(unit=unit))
