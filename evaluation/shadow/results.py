"""Results of a shadow: what a version would have done in recorded throws."""

import statistics
from collections.abc import Sequence

from pydantic import BaseModel, ConfigDict

from machine.conventions import Mode
from machine.messages import Target
from sim_twin.throws.campaign import ThrowOutcome


class PredictedThrow(BaseModel):
    """One throw in the twin without scatter; None where it does not land."""

    model_config = ConfigDict(frozen=True)

    outcome: ThrowOutcome
    release_s: float | None
    """From the start of the throw to the release command."""
    release_m: tuple[float, float, float] | None
    """Grip centre when the load leaves, frame `machine`."""
    release_speed_m_per_s: float | None
    downrange_error_m: float | None
    crossrange_error_m: float | None


class ShadowThrow(BaseModel):
    """One recorded throw, and what the version would have done."""

    model_config = ConfigDict(frozen=True)

    throw_id: str
    machine_id: str
    target: Target
    pace_ratio: float
    step_count: int
    """Policy steps up to the release."""
    action_difference_rms_ratio: float
    """Root mean square of the difference of the clipped velocity actions, over steps and joints; 2 is the
    whole range."""
    flown_release_s: float | None
    """When the version that flew commanded the release; None when it did not."""
    shown_release_s: float | None
    """When the version, shown the same observations, would have; None: not before the record's release."""
    measured_downrange_error_m: float | None
    measured_crossrange_error_m: float | None
    flown: PredictedThrow | None
    """The version that flew, in the twin; None where its files are not at hand."""
    candidate: PredictedThrow


class ShadowReport(BaseModel):
    """A version beside recorded throws."""

    model_config = ConfigDict(frozen=True)

    policy_id: str
    policy_sha256: str
    machine_ids: tuple[str, ...]
    """Machines whose throws were used."""
    mode: Mode
    unregistered_ids: tuple[str, ...]
    """Machines not registered with the version: their mean miss is that of the bare network."""
    throws: tuple[ShadowThrow, ...]
    left_out: tuple[tuple[str, str], ...]
    """Ids of throws that could not be used, with the reason."""


class ShadowMisses(BaseModel):
    """Predicted landings of one version in a shadow."""

    model_config = ConfigDict(frozen=True)

    throw_count: int
    landed_count: int
    mean_downrange_m: float | None
    """Of the throws that land; None where none does."""
    mean_crossrange_m: float | None


class ShadowFigures(BaseModel):
    """The figures of a shadow in short."""

    model_config = ConfigDict(frozen=True)

    candidate: ShadowMisses
    flown: ShadowMisses
    """Of the versions that flew, in the throws for which their files are at hand."""
    action_difference_rms_ratio: float
    """Mean over the throws."""


def shadow_figures(report: ShadowReport) -> ShadowFigures:
    """Sum a shadow up."""
    throws = report.throws
    return ShadowFigures(
        candidate=_misses([one.candidate for one in throws]),
        flown=_misses([one.flown for one in throws if one.flown is not None]),
        action_difference_rms_ratio=statistics.fmean(
            one.action_difference_rms_ratio for one in throws
        ),
    )


def _misses(throws: Sequence[PredictedThrow]) -> ShadowMisses:
    down = [one.downrange_error_m for one in throws if one.downrange_error_m is not None]
    cross = [one.crossrange_error_m for one in throws if one.crossrange_error_m is not None]
    return ShadowMisses(
        throw_count=len(throws),
        landed_count=len(down),
        mean_downrange_m=statistics.fmean(down) if down else None,
        mean_crossrange_m=statistics.fmean(cross) if cross else None,
    )
