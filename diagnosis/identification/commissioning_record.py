"""What a commissioning has measured so far: one JSON file, from which it goes on."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from diagnosis.identification.quantity import AxisSwing, Quantity
from diagnosis.identification.release_delay import ReleaseDelay
from machine.errors import UsageError
from reports.number_format import percent
from sim_twin.commissioning.drive_identification import JointExplanation
from sim_twin.twin.oil_spring import OilSpringDrive

StepName = Literal["valves", "response", "release", "swing", "registration", "reference"]
STEPS: dict[StepName, str] = {
    "valves": "valve tables",
    "response": "drives",
    "release": "release delay",
    "swing": "swing of the gripper",
    "registration": "registration",
    "reference": "reference throws",
}
"""Steps in order, in words."""
LEAST_EXPLAINED_RATIO = 0.97
"""Share of a joint's speed below which the report flags it."""
PHASE_WORDS = {
    "rise": "the rise after a step",
    "reversal": "reversals",
    "ringing": "what follows, such as ringing",
}


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class StepDone(_Model):
    """One step."""

    done_utc: str
    """YYYY-MM-DDTHH:MM:SSZ"""
    words: str
    """What was measured."""


class JointFit(_Model):
    """Drive of one joint and what it explains of motion that was not fitted."""

    joint: str
    drive: OilSpringDrive
    is_oil_spring: bool
    linear_explained_ratio: float
    explained_ratio: float
    unexplained_by_phase_ratio: dict[str, float]
    residual_rad_m_per_s: float
    at_bound: tuple[str, ...]
    plot: dict[str, list[float]]
    """Times, measured and simulated speed of the run that is explained worst."""


class RegistrationFit(_Model):
    """Registration with the active policy of one mode."""

    mode: str
    throw_count: int
    largest_correction_m: float


class Commissioning(_Model):
    """Content of ``MACHINE.commissioning.json``."""

    schema_version: Literal[1] = 1
    machine_id: str
    steps: dict[StepName, StepDone] = {}
    joints: tuple[JointFit, ...] = ()
    release: ReleaseDelay | None = None
    swing: tuple[AxisSwing, ...] = ()
    registrations: tuple[RegistrationFit, ...] = ()
    reference_day_count: dict[str, int] = {}
    """Reference throws that landed, by day."""

    def done(self, step: StepName, words: str, **found: Any) -> "Commissioning":
        """With one more step."""
        at = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        steps = {**self.steps, step: StepDone(done_utc=at, words=words)}
        return self.model_copy(update={**found, "steps": steps})

    def flags(self) -> list[str]:
        """What an engineer should look at, in sentences."""
        found: list[str] = []
        for fit in self.joints:
            if fit.explained_ratio < LEAST_EXPLAINED_RATIO:
                phase = max(
                    fit.unexplained_by_phase_ratio, key=fit.unexplained_by_phase_ratio.__getitem__
                )
                share = percent(fit.unexplained_by_phase_ratio[phase])
                explained = percent(fit.explained_ratio, 1)
                found.append(
                    f"{fit.joint}: the twin explains {explained} of its speed; {share} of "
                    f"what is left lies in {PHASE_WORDS[phase]}."
                )
            found += [f"{fit.joint}: {name} is at a bound of the search." for name in fit.at_bound]
        for name, known in self.quantities():
            if known.value is None:
                found.append(f"{name}: {known.why}.")
        return found

    def quantities(self) -> list[tuple[str, Quantity]]:
        """Identified numbers of release and swing by name."""
        found: list[tuple[str, Quantity]] = []
        if self.release is not None:
            found += [
                ("release delay", self.release.mean),
                ("its standard deviation", self.release.sd),
            ]
        for axis in self.swing:
            found += [
                (f"{axis.joint}, length", axis.length_m),
                (f"{axis.joint}, viscous friction", axis.viscous_friction_per_s),
                (f"{axis.joint}, dry friction", axis.coulomb_friction_rad_per_s2),
            ]
        return found


def joint_fit(found: JointExplanation) -> JointFit:
    """As it is stored; the plot with a value every 20 ms."""
    return JointFit(
        joint=found.joint,
        drive=found.drive,
        is_oil_spring=found.is_oil_spring,
        linear_explained_ratio=found.linear_explained_ratio,
        explained_ratio=found.explained_ratio,
        unexplained_by_phase_ratio=found.unexplained_by_phase_ratio,
        residual_rad_m_per_s=found.residual_rad_m_per_s,
        at_bound=found.at_bound,
        plot={
            "t_s": found.plot_s[::2].round(3).tolist(),
            "measured": found.plot_measured[::2].round(5).tolist(),
            "simulated": found.plot_simulated[::2].round(5).tolist(),
        },
    )


def load_record(path: Path, machine_id: str) -> Commissioning:
    """What was measured before; nothing where there is no file.

    Raises:
        UsageError: the file is no record of a commissioning.
    """
    if not path.exists():
        return Commissioning(machine_id=machine_id)
    try:
        return Commissioning.model_validate_json(path.read_text(encoding="utf-8"))
    except (OSError, ValidationError) as error:
        raise UsageError(
            f"{path} is no record of a commissioning; move it away to begin anew, or give another --out"
        ) from error
