"""An evaluation's numbers: each target's row with 95 % intervals, cycle time, failures, 9 m scatter."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict

from diagnosis.evaluation.conditions import ConditionRow
from diagnosis.evaluation.paper import SCATTER_RANGE_M
from diagnosis.evaluation.sensitivity import FactorShift
from diagnosis.evaluation.spread import SpreadParts
from diagnosis.evaluation.wide_unit import WideUnit
from diagnosis.intervals import Interval, deviation_interval, mean_interval, share_interval
from machine.conventions import Array
from sim_twin.throws.accuracy import landing_errors, outcome_counts
from sim_twin.throws.campaign import Outcome, ThrowResult

CONFIDENCE_RATIO = 0.95


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
    """Beside the report, if it was written."""


class UnitRow(BaseModel):
    """One machine, measured and registered as at its first start; root mean squares over its targets, m."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)
    unit_seed: int
    landed_count: int
    throw_count: int
    mean_downrange_error_m: float | None
    sd_downrange_m: float | None
    mean_crossrange_error_m: float | None
    sd_crossrange_m: float | None
    targets: tuple[ConditionRow, ...] = ()
    """Each target by itself; empty in files of before."""


class TrainingRow(BaseModel):
    """One target of one training."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)
    policy: str
    training_seed: int
    step_count: int
    is_registered: bool = False
    """Whether the machine had been registered with this training."""
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
    """Drawn when the evaluation began, the policy being there; else given."""
    seconds: float
    real_time_factor: float
    outcomes: dict[str, int]
    targets: tuple[TargetRow, ...]
    start_to_release_s: Estimate
    start_to_landing_s: Estimate
    """To the survey of the impact, 0.5 s after it on the virtual machine."""
    failures: tuple[Failure, ...]
    sensitivity_range_m: float | None
    sensitivity: tuple[FactorShift, ...]
    sensitivity_note: str
    paces: tuple[ConditionRow, ...] = ()
    """Careful to fast; empty for a policy that knows no pace."""
    heights: tuple[ConditionRow, ...] = ()
    """Off the ground; empty for a policy of the ground alone."""
    spread: SpreadParts | None = None
    """What the spread is made of."""
    units: tuple[UnitRow, ...] = ()
    """Machines that no training has seen; the first is the nominal one. Empty where none were asked for."""
    wide_unit: WideUnit | None = None
    """What makes the widest of them wide."""
    trainings: tuple[TrainingRow, ...] = ()
    """Other trainings of the same mode."""
    is_registered: bool = False
    """Whether the machine aimed by a registration of this policy."""
    aim: str = ""
    """How it aimed, in words; where it is not registered, why, and what to do."""

    @property
    def scatter(self) -> TargetRow | None:
        """The row of the paper's real-world target."""
        return next((t for t in self.targets if abs(t.range_m - SCATTER_RANGE_M) < 1e-6), None)


def mean_estimate(values: Array) -> Estimate:
    """Mean, Student's interval."""
    if values.size == 0:
        return Estimate(value=None, ci95=None)
    ends = mean_interval(values, CONFIDENCE_RATIO) if values.size > 1 else None
    return Estimate(value=float(values.mean()), ci95=ends)


def deviation_estimate(values: Array) -> Estimate:
    """Standard deviation of the sample, chi-square interval."""
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
        success_ratio=Estimate(value=landed / n, ci95=share_interval(landed, n, CONFIDENCE_RATIO)),
        mean_downrange_error_m=mean_estimate(down),
        sd_downrange_m=deviation_estimate(down),
        mean_crossrange_error_m=mean_estimate(cross),
        sd_crossrange_m=deviation_estimate(cross),
        downrange_error_m=tuple(down.round(4).tolist()),
        crossrange_error_m=tuple(cross.round(4).tolist()),
    )


def evaluation(
    about: dict[str, Any],
    ranges_m: Sequence[float],
    results: Sequence[Sequence[ThrowResult]],
    logs: Sequence[Path],
    folder: Path,
    sensitivity: tuple[float | None, Sequence[FactorShift], str],
) -> ModeEvaluation:
    """Everything about one mode.

    Args:
        about: mode, plant, unit_seed, policy, seed and seconds.
        ranges_m: of the targets.
        results: by target, in the order in which they were thrown.
        logs: of failed throws; their names end with the number of the throw.
        folder: that the logs are named relative to.
        sensitivity: range, shifts, and where they come from.
    """
    every = [r for part in results for r in part]
    landed = [r for r in every if r.outcome is Outcome.LANDED]
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
        if r.outcome is not Outcome.LANDED
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
