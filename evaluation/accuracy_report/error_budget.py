"""What the accuracy report concludes: causes of error by size, spread ratios, the widest machine."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from evaluation.measures import ModeEvaluation, UnitRow
from evaluation.property_ablation import Direction, PropertyAblation
from evaluation.requirements import MAX_SPREAD_RATIO
from reports.number_format import fixed


class ErrorCause(NamedTuple):
    """One cause of downrange error at the range of the sensitivities."""

    name: str
    size_m: float
    shows_in: str
    """Mean or spread."""


def error_budget(part: ModeEvaluation) -> list[ErrorCause]:
    """Causes of downrange error, the largest first."""
    found: list[ErrorCause] = []
    spread = part.spread
    if spread is not None:
        found += [
            ErrorCause("start pose", spread.between_starts_downrange_m, "spread between starts"),
            ErrorCause(
                "random variation: release, valves, sensors",
                spread.within_start_downrange_m,
                "spread of throws from one start",
            ),
        ]
    at = next((t for t in part.targets if t.range_m == part.sensitivity_range_m), None)
    mean = None if at is None else at.mean_downrange_error_m.value
    if mean is not None:
        found.append(ErrorCause("bias left by policy and registration", abs(mean), "mean"))
    for shift in part.sensitivity:
        sides = [abs(v) for v in (shift.low_m, shift.high_m) if v is not None]
        if sides:
            name = f"{shift.name}, off by {shift.change.removeprefix('-/+ ')}"
            found.append(ErrorCause(name, float(np.mean(sides)), "mean, if it is off by that"))
    others = [u.mean_downrange_error_m for u in part.units[1:]]
    known = [m for m in others if m is not None]
    if known:
        rms = float(np.sqrt(np.mean(np.square(known))))
        found.append(
            ErrorCause("another machine of the type, registered", rms, "mean of its targets")
        )
    return sorted(found, key=lambda cause: -cause.size_m)


class SpreadRatios(NamedTuple):
    """Standard deviations of the other machines over the first machine's, in one direction."""

    direction: Direction
    median: float
    worst: float
    beyond: tuple[int, ...]
    """Machines above `MAX_SPREAD_RATIO`."""


def spread_ratios(units: Sequence[UnitRow]) -> list[SpreadRatios]:
    """Spread ratios by direction; empty where they are not known."""
    found: list[SpreadRatios] = []
    directions: tuple[Direction, ...] = ("downrange", "crossrange")
    for direction in directions:
        name = f"sd_{direction}_m"
        nominal = getattr(units[0], name) if units else None
        ratios = [
            (sd / nominal, unit.unit_seed)
            for unit in units[1:]
            if nominal and (sd := getattr(unit, name))
        ]
        if ratios:
            median = float(np.median([ratio for ratio, _ in ratios]))
            beyond = tuple(seed for ratio, seed in ratios if ratio > MAX_SPREAD_RATIO)
            found.append(SpreadRatios(direction, median, max(ratios)[0], beyond))
    return found


def ablation_conclusion(found: PropertyAblation) -> str:
    """What the shares of single properties say about their combination."""
    ends = found.single_sum_ci95_ratio
    if ends is None:
        return "Its spread is not significantly wider: it was the widest by chance, not by how it is built."
    known = [
        f"{row.name} ({fixed(100.0 * (row.share_ratio or 0.0), 0)} %)"
        for row in found.properties
        if row.share_ci95_ratio is not None and row.share_ci95_ratio[0] > 0.0
    ]
    single = (
        f"Properties that reduce it on their own: {', '.join(known)}."
        if known
        else "No single property reduces it significantly."
    )
    if ends[0] > 1.0:
        return f"{single} The shares add up to more than all: several properties must coincide."
    if ends[1] < 1.0:
        return f"{single} The shares add up to less than all: one of several properties suffices."
    return f"{single} Whether several must coincide does not show in these throws."
