"""Results of a shadow: what a version would have done in recorded throws."""

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
    """A version beside recorded throws of one machine."""

    model_config = ConfigDict(frozen=True)

    policy_id: str
    policy_sha256: str
    machine_id: str
    mode: Mode
    is_registered: bool
    """Whether the machine is registered with the version; else its mean miss is that of the bare network."""
    throws: tuple[ShadowThrow, ...]
    left_out: tuple[tuple[str, str], ...]
    """Ids of throws that could not be used, with the reason."""
