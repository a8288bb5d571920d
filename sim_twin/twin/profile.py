"""Twin profile: deviations of one machine from the nominal model, as one versioned JSON file.

Unknown fields are refused, so that a typo in a file is an error.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, cast

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from machine.errors import UsageError
from machine.spec import MachineSpec
from sim_twin.effects.effect import Effect, deterministic
from sim_twin.twin.oil_spring import FourDrives

NonNegative = Annotated[float, Field(ge=0.0)]
Positive = Annotated[float, Field(gt=0.0)]
DeadTime = Annotated[float, Field(ge=0.0, le=1.0)]
FourPositive = tuple[Positive, Positive, Positive, Positive]
FourNonNegative = tuple[NonNegative, NonNegative, NonNegative, NonNegative]
TwoNonNegative = tuple[NonNegative, NonNegative]
Interval = tuple[float, float]


class Spread(BaseModel):
    """Standard deviations between throws with equal target and start.

    Assumed unless identified: warm hydraulics repeat the steady speed to one or two percent and the dead
    time to half a control tick.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    start_position_sd_rad_m: FourNonNegative = (0.0015, 0.005, 0.005, 0.005)
    """Active joints at the start of a throw, relative to the commanded pose; the cabin is aligned to
    2.5 mrad (runtime.control.swing_control)."""
    start_swing_sd_rad: TwoNonNegative = (0.01, 0.01)
    """Pitch and roll from plumb at the start."""
    dead_time_sd_s: FourNonNegative = (0.005, 0.005, 0.005, 0.005)
    natural_frequency_sd_ratio: FourNonNegative = (0.05, 0.05, 0.05, 0.05)
    gain_sd_ratio: FourNonNegative = (0.01, 0.01, 0.01, 0.01)
    friction_sd_ratio: NonNegative = 0.15
    drag_sd_ratio: NonNegative = 0.02


class SensorNoise(BaseModel):
    """Standard deviation of one sample of each sensor."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    joint_position_sd_rad_m: FourNonNegative = (0.001, 0.001, 0.001, 0.001)
    joint_velocity_sd_rad_m_per_s: FourNonNegative = (0.005, 0.005, 0.005, 0.005)
    gyro_sd_rad_per_s: NonNegative = 6.2e-4
    """ASM330 class sensor in a 50 Hz band (docs/machine.md)."""
    accel_sd_m_per_s2: NonNegative = 4.2e-3
    survey_sd_m: NonNegative = 0.0
    """Survey of the impact, each horizontal axis."""


class TwinProfile(BaseModel):
    """Parameters of one machine. Tuples of four are in the order of the active joints.

    Response of an active joint, from the steady speed u of the valve calibration to the joint
    velocity y: y'' = w^2 (g u(t - d) - y) - 2 z w y', with dead time d, natural frequency w, damping ratio z
    and gain g; or, with `drives`, that of `sim_twin.twin.oil_spring`.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    schema_version: Literal[3] = 3
    """Version 2 has `effects`, version 3 `drives`; older files have none."""
    machine_id: str
    version_count: int = Field(ge=0)
    """0: nominal twin of the machine type; increases by one with every applied correction."""
    note: str = ""
    """Source of the values, as text."""
    dead_time_s: tuple[DeadTime, DeadTime, DeadTime, DeadTime]
    natural_frequency_rad_per_s: FourPositive
    damping_ratio: FourPositive
    gain_ratio: FourPositive = (1.0, 1.0, 1.0, 1.0)
    drives: FourDrives | None = None
    """Drives as oil springs, identified at commissioning; they replace the response above. None: the linear
    response."""
    viscous_friction_per_s: TwoNonNegative
    """Pitch and roll (paper, eq. 3)."""
    coulomb_friction_rad_per_s2: TwoNonNegative
    release_delay_s: NonNegative
    release_delay_sd_s: NonNegative
    drag_coefficient_ratio: NonNegative
    wind_m_per_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Frame `machine`."""
    effects: tuple[Effect, ...] = ()
    """Effects found by diagnoses, in addition to the values above (sim_twin.effects.table)."""
    noise: SensorNoise = SensorNoise()
    spread: Spread = Spread()
    intervals: Mapping[str, Interval] = {}
    """90 % intervals by name of the value: ``field``, ``field.joint``, ``effect.parameter`` or
    ``effect.joint.parameter``."""

    @property
    def mean_lag_s(self) -> tuple[float, ...]:
        """Mean lag of each joint behind its dead time, s."""
        if self.drives is not None:
            return tuple(drive.mean_lag_s for drive in self.drives)
        pairs = zip(self.damping_ratio, self.natural_frequency_rad_per_s, strict=True)
        return tuple(2.0 * z / w for z, w in pairs)

    @model_validator(mode="before")
    @classmethod
    def _migrate(cls, data: Any) -> Any:
        if isinstance(data, dict):
            tree = cast("dict[str, Any]", data)
            if tree.get("schema_version") in (1, 2):
                return {**tree, "schema_version": 3}
        return cast("Any", data)

    @model_validator(mode="after")
    def _intervals_name_effects(self) -> "TwinProfile":
        known = set(type(self).model_fields)
        parameters = {
            ".".join(part for part in (e.effect, e.joint, name) if part)
            for e in self.effects
            for name in e.parameters
        }
        for name, (low, high) in self.intervals.items():
            if name.split(".")[0] not in known and name not in parameters:
                raise ValueError(f"interval '{name}' names no effect of the profile")
            if low > high:
                raise ValueError(f"interval '{name}' runs from {low} down to {high}")
        return self


def nominal_profile(spec: MachineSpec) -> TwinProfile:
    """Profile of an unmeasured machine: the spec's response, friction, release and drag.

    The spec's first-order lag T becomes the critically damped second order with the same mean delay:
    2 z / w = T with z = 1.
    """
    lag = spec.response.lag_s
    passive = spec.passive
    return TwinProfile(
        machine_id="nominal",
        version_count=0,
        note="nominal values of the machine type",
        dead_time_s=spec.response.dead_time_s,
        natural_frequency_rad_per_s=(2.0 / lag[0], 2.0 / lag[1], 2.0 / lag[2], 2.0 / lag[3]),
        damping_ratio=(1.0, 1.0, 1.0, 1.0),
        viscous_friction_per_s=(passive.viscous_friction_per_s, passive.viscous_friction_per_s),
        coulomb_friction_rad_per_s2=(
            passive.coulomb_friction_rad_per_s2,
            passive.coulomb_friction_rad_per_s2,
        ),
        release_delay_s=spec.release.delay_s,
        release_delay_sd_s=spec.release.delay_sd_s,
        drag_coefficient_ratio=spec.ball.drag_coefficient_ratio,
    )


def exact_profile(profile: TwinProfile) -> TwinProfile:
    """The profile without random scatter, for nominal throws."""
    nothing = (0.0, 0.0, 0.0, 0.0)
    return profile.model_copy(
        update={
            "effects": deterministic(profile.effects),
            "release_delay_sd_s": 0.0,
            "noise": SensorNoise(
                joint_position_sd_rad_m=nothing,
                joint_velocity_sd_rad_m_per_s=nothing,
                gyro_sd_rad_per_s=0.0,
                accel_sd_m_per_s2=0.0,
            ),
            "spread": Spread(
                start_position_sd_rad_m=nothing,
                start_swing_sd_rad=(0.0, 0.0),
                dead_time_sd_s=nothing,
                natural_frequency_sd_ratio=nothing,
                gain_sd_ratio=nothing,
                friction_sd_ratio=0.0,
                drag_sd_ratio=0.0,
            ),
        }
    )


def load_profile(path: Path) -> TwinProfile:
    """Read a profile.

    Raises:
        UsageError: the file is missing or is not a profile.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise UsageError(
            f"twin profile {path} cannot be read ({error.strerror}); "
            "leave --profile out for the nominal twin"
        ) from error
    try:
        return TwinProfile.model_validate_json(text)
    except ValidationError as error:
        wrong = error.errors()
        first = f"{'.'.join(map(str, wrong[0]['loc'])) or 'content'}: {wrong[0]['msg']}"
        more = f", and {len(wrong) - 1} more" if len(wrong) > 1 else ""
        raise UsageError(
            f"{path} is not a twin profile ({first}{more}); `downrange calibrate` writes one, "
            "MACHINE.profile.json"
        ) from error


def save_profile(profile: TwinProfile, path: Path) -> None:
    """Write a profile as indented JSON, which keeps differences between versions readable."""
    path.write_text(profile_text(profile), encoding="utf-8")


def profile_text(profile: TwinProfile) -> str:
    """Text of a profile file."""
    return profile.model_dump_json(indent=2) + "\n"
