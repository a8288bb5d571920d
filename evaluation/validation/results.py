"""What a validation throws, and what it found."""

from typing import Literal

from pydantic import BaseModel, ConfigDict

from evaluation.measures import Failure, TargetRow
from machine.conventions import Mode


class ValidationPlan(BaseModel):
    """Throws of a validation; with the versions it determines every landing."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)
    mode: Mode
    protocol: Literal["short", "full"]
    plant: str = "virtual"
    ranges_m: tuple[float, ...]
    throws_per_target: int
    unseen_throws_per_target: int
    """With machines other than the nominal one."""
    unit_seeds: tuple[int, ...]
    """Virtual machines: 0 is the nominal one, the others served no training."""
    seed: int

    def throws_of(self, unit_seed: int) -> int:
        """Throws at each target with a machine."""
        return self.throws_per_target if unit_seed == 0 else self.unseen_throws_per_target


class UnitLandings(BaseModel):
    """Throws of one version with one machine."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)
    unit_seed: int
    is_registered: bool
    registration_note: str
    targets: tuple[TargetRow, ...]
    failures: tuple[Failure, ...]
    is_repeatable: bool | None
    """Whether the same seed gave the same landings, bit for bit; None where it was not tried."""


class Latency(BaseModel):
    """Time of one run of the network for one machine, on the computer of the server."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)
    p50_s: float
    p99_s: float
    run_count: int


class VersionResult(BaseModel):
    """Throws of one version with all machines."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)
    policy_id: str
    policy_sha256: str
    units: tuple[UnitLandings, ...]
    latency: Latency | None

    @property
    def throw_count(self) -> int:
        """All throws."""
        return sum(row.throws for unit in self.units for row in unit.targets)

    @property
    def landed_count(self) -> int:
        """Throws that landed."""
        return sum(row.landed for unit in self.units for row in unit.targets)
