"""Throws as the diagnosis uses them: one throw, and a set of throws with its refused logs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from diagnosis.verdict import Diagnosis, VerdictKind
from machine.calibration import ValveCalibration
from machine.conventions import Array, BoolArray
from sim_twin.twin.profile import TwinProfile

MIN_THROWS_COUNT: Final = 3
"""Fewest throws that separate the machine's scatter from an effect."""


@dataclass(frozen=True, slots=True)
class ThrowData:
    """One throw; T ticks of 10 ms, times from the throw's start, positions in frame `machine`."""

    throw_id: str
    machine_id: str
    mode: str
    target_m: Array
    """(3,)"""
    t_s: Array
    """(T,) grid of 10 ms; 0 is the first tick of `Motion.THROW`, up to 2 s of history are negative."""
    valve_ratio: Array
    """(T, 4) valve commands after the safety gate."""
    gripper_open: BoolArray
    """(T,) whether the gripper is commanded open."""
    sensor_t_s: Array
    """(T,) sample times of the joint sensors."""
    sensor_position_rad_m: Array
    """(T, 4)"""
    sensor_velocity_rad_m_per_s: Array
    """(T, 4)"""
    joint_position_rad_m: Array
    """(T, 6) estimate in the policy's observation; pitch and roll come from the IMU."""
    joint_velocity_rad_m_per_s: Array
    """(T, 6)"""
    imu_t_s: Array
    """(K,) sample times; K is 0 for a CSV without IMU."""
    gyro_rad_per_s: Array
    """(K, 3) gripper frame."""
    accel_m_per_s2: Array
    """(K, 3) specific force, gripper frame."""
    open_command_t_s: float
    switch_open_t_s: float
    """When the gripper's switch reported the release; NaN without a report."""
    ball_t_s: Array
    """(B,)"""
    ball_m: Array
    """(B, 3) centre of the load in flight; B may be 0."""
    impact_m: Array
    """(3,) NaN without a survey."""
    impact_sd_m: float
    impact_t_s: float
    supply_pressure_pa: Array
    """(T,)"""
    calibration: ValveCalibration
    spec_sha256: str
    twin_profile: TwinProfile | None
    """The profile that previewed the throw, if the log carries it."""
    recorded_at_ns: int
    """Machine clock at 0 s; it orders the throws of one boot."""
    path: Path
    notes: tuple[str, ...]
    """Repairs that were made."""


@dataclass(frozen=True, slots=True)
class LoadedSet:
    """The usable throws of a set of logs, and the reasons why others were refused."""

    throws: tuple[ThrowData, ...]
    refused: tuple[tuple[Path, str], ...]
    rates: Mapping[str, float]
    """Median rate of each channel over the throws, Hz."""
    clocks: Mapping[str, Mapping[str, Any]]
    """By throw: audit of the control, IMU and ball clocks, sensor age, s."""

    def evidence(self) -> dict[str, Any]:
        """For `Diagnosis.evidence`."""
        return {
            "throws_used": [throw.throw_id for throw in self.throws],
            "rates_hz": dict(self.rates),
            "clocks": {name: dict(audit) for name, audit in self.clocks.items()},
            "repairs": {t.throw_id: list(t.notes) for t in self.throws if t.notes},
            "refused": refusals(self.refused),
        }

    def shortage(self, what: str) -> str | None:
        """Why there are too few of `what`; None when there are enough."""
        if len(self.throws) >= MIN_THROWS_COUNT:
            return None
        reasons = "; ".join(f"{path.name}: {reason}" for path, reason in self.refused[:3])
        count = len(self.refused)
        refused = "1 log was refused" if count == 1 else f"{count} logs were refused"
        return (
            f"{len(self.throws)} {what}, at least {MIN_THROWS_COUNT} are needed; {refused}. {reasons}"
        ).strip()

    def too_few(self) -> Diagnosis | None:
        """The verdict when there are too few throws to diagnose; None when there are enough."""
        sentence = self.shortage("usable throws")
        if sentence is None:
            return None
        return Diagnosis(verdict=VerdictKind.BAD_DATA, sentence=sentence, evidence=self.evidence())


def refusals(refused: Sequence[tuple[Path, str]]) -> list[dict[str, str]]:
    """Refused logs for `Diagnosis.evidence`."""
    return [{"path": str(path), "reason": reason} for path, reason in refused]
