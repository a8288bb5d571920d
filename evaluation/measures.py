"""Numbers of an evaluation: landings by target with 95 % intervals, cycle times, failures, scatter at 9 m."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict

from evaluation.conditions import ConditionRow
from evaluation.paper import SCATTER_RANGE_M
from evaluation.property_ablation import PropertyAblation
from evaluation.sensitivity import CONFIDENCE_RATIO, FactorShift
from evaluation.spread import SpreadParts
from machine.conventions import Array
from sim_twin.confidence_intervals import (
    Interval,
    deviation_interval,
    mean_interval,
    proportion_interval,
)
from sim_twin.throws.accuracy import landing_errors, outcome_counts
from sim_twin.throws.campaign import ThrowOutcome, ThrowResult


class Estimate(BaseModel):
    """A number with its 95 % interval; None where too few throws landed."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)
    value: float | None
    ci95: Interval | None


class TargetRow(BaseModel):
    """Landings at one target, m, frame `throw`."""

    model_config = ConfigDict(frozen=True)
    range_m: float
    throws: int
    landed: int
    success_ratio: Estimate
    mean_downrange_error_m: Estimate
    sd_downrange_m: Estimate
    mean_crossrange_error_m: Estimate
    sd_crossrange_m: Estimate
    downrange_error_m: tuple[float, ...]
    """Of each throw that landed."""
    crossrange_error_m: tuple[float, ...]


class Failure(BaseModel):
    """A throw that did not land."""

    model_config = ConfigDict(frozen=True)
    range_m: float
    number: int
    """Of the throw in its campaign."""
    outcome: str
    after_release: bool
    log: str | None
    """Path relative to the report; None if no log was written."""


class UnitRow(BaseModel):
    """One machine, calibrated and registered as at commissioning; root mean squares over its targets, m."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)
    unit_seed: int
    landed_count: int
    throw_count: int
    mean_downrange_error_m: float | None
    sd_downrange_m: float | None
    mean_crossrange_error_m: float | None
    sd_crossrange_m: float | None
    targets: tuple[ConditionRow, ...] = ()
    """By target; empty in reports of earlier versions."""


class TrainingRow(BaseModel):
    """One target of one training."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)
    policy: str
    training_seed: int
    step_count: int
    is_registered: bool = False
    """Whether the machine was registered with this policy."""
    row: ConditionRow


class ModeEvaluation(BaseModel):
    """One mode's campaign."""

    model_config = ConfigDict(frozen=True)
    mode: str
    plant: str
    unit_seed: int
    policy: str
    policy_sha256: str = ""
    seed: int
    seed_is_drawn: bool = False
    """Drawn at the start of the evaluation, when the policy was fixed; else given by the user."""
    seconds: float
    real_time_factor: float
    outcomes: dict[str, int]
    targets: tuple[TargetRow, ...]
    start_to_release_s: Estimate
    start_to_landing_s: Estimate
    """Until the survey of the impact, 0.5 s after it on the virtual machine."""
    failures: tuple[Failure, ...]
    sensitivity_range_m: float | None
    sensitivity: tuple[FactorShift, ...]
    sensitivity_note: str
    paces: tuple[ConditionRow, ...] = ()
    """From careful to fast; empty for a policy that was trained without a pace."""
    heights: tuple[ConditionRow, ...] = ()
    """By target height; empty for a policy that was trained for the ground alone."""
    spread: SpreadParts | None = None
    """Parts of the spread; None if it was not measured."""
    units: tuple[UnitRow, ...] = ()
    """The nominal machine, then machines outside training; empty if none were requested."""
    wide_unit: PropertyAblation | None = None
    """Why the widest of them scatters more."""
    trainings: tuple[TrainingRow, ...] = ()
    """Other policies of the same mode."""
    is_registered: bool = False
    """Whether the machine was registered with this policy."""
    aim: str = ""
    """State of the registration, for people; where it is missing, the reason and the remedy."""

    @property
    def scatter(self) -> TargetRow | None:
        """The row of the target at which the paper threw with the real machine."""
        return next((t for t in self.targets if abs(t.range_m - SCATTER_RANGE_M) < 1e-6), None)


def mean_estimate(values: Array) -> Estimate:
    """Mean with Student's interval."""
    if values.size == 0:
        return Estimate(value=None, ci95=None)
    ends = mean_interval(values, CONFIDENCE_RATIO) if values.size > 1 else None
    return Estimate(value=float(values.mean()), ci95=ends)


def deviation_estimate(values: Array) -> Estimate:
    """Standard deviation of the sample with its chi-square interval."""
    if values.size < 2:
        return Estimate(value=None, ci95=None)
    sd = float(values.std(ddof=1))
    return Estimate(value=sd, ci95=deviation_interval(sd, int(values.size), CONFIDENCE_RATIO))


def target_row(range_m: float, results: Sequence[ThrowResult]) -> TargetRow:
    """One target's row."""
    down, cross = landing_errors(results)
    n, landed = len(results), int(down.size)
    return TargetRow(
        range_m=range_m,
        throws=n,
        landed=landed,
        success_ratio=Estimate(
            value=landed / n, ci95=proportion_interval(landed, n, CONFIDENCE_RATIO)
        ),
        mean_downrange_error_m=mean_estimate(down),
        sd_downrange_m=deviation_estimate(down),
        mean_crossrange_error_m=mean_estimate(cross),
        sd_crossrange_m=deviation_estimate(cross),
        downrange_error_m=tuple(down.round(4).tolist()),
        crossrange_error_m=tuple(cross.round(4).tolist()),
    )


def mode_evaluation(
    about: dict[str, Any],
    ranges_m: Sequence[float],
    results: Sequence[Sequence[ThrowResult]],
    logs: Sequence[Path],
    folder: Path,
    sensitivity: tuple[float | None, Sequence[FactorShift], str],
) -> ModeEvaluation:
    """Put together the numbers of one mode.

    Args:
        about: mode, plant, unit_seed, policy, seed and seconds.
        ranges_m: of the targets.
        results: by target, in the order in which they were thrown.
        logs: of failed throws; their names end with the number of the throw.
        folder: that the logs are named relative to.
        sensitivity: range, shifts, and a note on how they were measured.
    """
    every = [r for part in results for r in part]
    landed = [r for r in every if r.outcome is ThrowOutcome.LANDED]
    by_number = {int(path.stem.rsplit("-", 1)[-1]): path for path in logs}
    failures = tuple(
        Failure(
            range_m=float(np.hypot(r.target_m[0], r.target_m[1])),
            number=number,
            outcome=r.outcome.value,
            after_release=bool(np.isfinite(r.throw_duration_s)),
            log=str(by_number[number].relative_to(folder)) if number in by_number else None,
        )
        for number, r in enumerate(every)
        if r.outcome is not ThrowOutcome.LANDED
    )
    return ModeEvaluation(
        **about,
        real_time_factor=sum(r.simulated_s for r in every) / max(float(about["seconds"]), 1e-9),
        outcomes=outcome_counts(every),
        targets=tuple(target_row(r, p) for r, p in zip(ranges_m, results, strict=True)),
        start_to_release_s=mean_estimate(np.array([r.throw_duration_s for r in landed])),
        start_to_landing_s=mean_estimate(np.array([r.simulated_s for r in landed])),
        failures=failures,
        sensitivity_range_m=sensitivity[0],
        sensitivity=tuple(sensitivity[1]),
        sensitivity_note=sensitivity[2],
    )
