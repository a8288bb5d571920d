"""What the sets of each independent plant hold: healthy days, single effects, pairs, unknown effects."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from benchmarks.plants.compiled_plant import CompiledPlant, load
from benchmarks.plants.mule.plant import Mule
from benchmarks.plants.ring.plant import Ring

Kind = Literal["healthy", "single", "pair", "unknown"]
EffectData = dict[str, Any]


@dataclass(frozen=True)
class Contents:
    """A plant and the sets that are made of it."""

    plant: type[CompiledPlant]
    singles: tuple[EffectData, ...]
    pairs: tuple[tuple[EffectData, EffectData], ...]
    unknowns: tuple[EffectData, ...]
    healthy_count: int = 16

    @property
    def name(self) -> str:
        """Also the identifier of its machines."""
        return self.plant.source.stem

    @property
    def factory(self) -> str:
        """For ``--plant`` of downrange."""
        return f"{self.plant.__module__}:{self.plant.__name__}"

    @property
    def options_variable(self) -> str:
        """Environment variable with the day and the effects, JSON."""
        return self.plant.options_variable

    def load(self) -> None:
        """Compile its code, where that is missing."""
        load(self.plant.source, self.plant.standard)


def known(name: str, joint: str | None = None, **parameters: float) -> dict[str, Any]:
    """An effect of docs/effects.md."""
    return {"effect": name, "joint": joint, "parameters": parameters}


def unknown(name: str, size: float, joint: str | None = None) -> dict[str, Any]:
    """An effect outside docs/effects.md."""
    return {"effect": name, "joint": joint, "parameters": {"size": size}}


RING_SINGLES = (
    known("valve_dead_time", "dipper", extra_dead_time_s=0.07),
    known("valve_dead_time", "slew", extra_dead_time_s=0.12),
    known("valve_lag", "dipper", extra_lag_s=0.15),
    known("valve_lag", "telescope", extra_lag_s=0.18),
    known("valve_dead_band", "dipper", positive_ratio=0.15, negative_ratio=0.15),
    known("valve_dead_band", "telescope", positive_ratio=0.16, negative_ratio=0.16),
    known("valve_gain", "dipper", positive_ratio=-0.22, negative_ratio=-0.22),
    known("valve_gain", "slew", positive_ratio=-0.25, negative_ratio=-0.25),
    known("valve_gain", "telescope", positive_ratio=0.25, negative_ratio=0.25),
    known("speed_limit", "dipper", reduction_ratio=0.35),
    known("speed_limit", "telescope", reduction_ratio=0.35),
    known("passive_viscous_friction", extra_viscous_per_s=0.5),
    known("passive_coulomb_friction", extra_coulomb_rad_per_s2=0.5),
    known("gripper_length", extra_length_m=0.18),
    known("gripper_length", extra_length_m=-0.18),
    known("release_delay", extra_delay_s=0.08),
    known("release_delay", extra_delay_s=-0.07),
    known("sticky_release", slowdown_ratio=0.15),
    known("air_drag", extra_drag_coefficient_ratio=2.0),
    known("wind", x_m_per_s=-6.0, y_m_per_s=3.0),
    known("joint_sensor_bias", "boom", bias_rad_m=0.045),
    known("joint_sensor_bias", "dipper", bias_rad_m=-0.05),
    known("joint_sensor_bias", "slew", bias_rad_m=0.04),
    known("base_tilt", roll_rad=0.0, pitch_rad=0.06),
    known("base_tilt", roll_rad=0.08, pitch_rad=-0.06),
)
RING_PAIRS = (
    (RING_SINGLES[0], RING_SINGLES[15]),
    (RING_SINGLES[6], RING_SINGLES[11]),
    (RING_SINGLES[7], RING_SINGLES[18]),
    (RING_SINGLES[10], RING_SINGLES[16]),
    (RING_SINGLES[1], RING_SINGLES[13]),
    (RING_SINGLES[20], RING_SINGLES[12]),
    (RING_SINGLES[23], RING_SINGLES[4]),
    (RING_SINGLES[9], RING_SINGLES[17]),
)
RING_UNKNOWNS = (
    unknown("sticking_spool", 0.25, "dipper"),
    unknown("sticking_spool", 0.30, "slew"),
    unknown("leaking_piston", 20.0, "dipper"),
    unknown("engine_sag", 1.2),
    unknown("half_opening_gripper", 0.30),
    unknown("dragging_slew_ring", 26.0e3),
    unknown("position_dependent_gain", 0.45, "dipper"),
    unknown("position_dependent_gain", 0.45, "telescope"),
    unknown("air_in_oil", 0.75, "dipper"),
    unknown("pump_hunting", 0.7),
    unknown("slow_opening_spool", 0.5, "telescope"),
)

MULE_SINGLES = (
    known("valve_dead_time", "dipper", extra_dead_time_s=0.08),
    known("valve_dead_time", "telescope", extra_dead_time_s=0.18),
    known("valve_dead_time", "slew", extra_dead_time_s=0.13),
    known("valve_lag", "dipper", extra_lag_s=0.16),
    known("valve_lag", "slew", extra_lag_s=0.22),
    known("valve_dead_band", "dipper", positive_ratio=0.16, negative_ratio=0.16),
    known("valve_gain", "dipper", positive_ratio=-0.24, negative_ratio=-0.24),
    known("valve_gain", "telescope", positive_ratio=-0.42, negative_ratio=-0.42),
    known("valve_gain", "slew", positive_ratio=-0.28, negative_ratio=-0.28),
    known("valve_hysteresis", "dipper", half_width_ratio=0.14),
    known("speed_limit", "dipper", reduction_ratio=0.60),
    known("speed_limit", "slew", reduction_ratio=0.40),
    known("load_dependent_speed", "dipper", loss_ratio=0.50),
    known("pump_flow_sharing", shortage_ratio=0.40),
    known("passive_viscous_friction", extra_viscous_per_s=0.5),
    known("passive_coulomb_friction", extra_coulomb_rad_per_s2=0.5),
    known("gripper_length", extra_length_m=0.20),
    known("gripper_length", extra_length_m=-0.16),
    known("hose_stiffness", stiffness_per_s2=2.5),
    known("release_delay", extra_delay_s=0.09),
    known("release_delay", extra_delay_s=-0.08),
    known("sticky_release", slowdown_ratio=0.16),
    known("air_drag", extra_drag_coefficient_ratio=2.0),
    known("wind", x_m_per_s=5.0, y_m_per_s=-5.0),
    known("joint_sensor_bias", "boom", bias_rad_m=-0.045),
    known("joint_sensor_bias", "dipper", bias_rad_m=0.05),
    known("joint_sensor_bias", "slew", bias_rad_m=-0.05),
    known("base_tilt", roll_rad=-0.07, pitch_rad=0.05),
    known("base_yaw_drift", yaw_rad=0.05),
    known("base_height", extra_height_m=0.35),
)
MULE_PAIRS = (
    (MULE_SINGLES[0], MULE_SINGLES[21]),
    (MULE_SINGLES[2], MULE_SINGLES[22]),
    (MULE_SINGLES[6], MULE_SINGLES[14]),
    (MULE_SINGLES[10], MULE_SINGLES[19]),
    (MULE_SINGLES[11], MULE_SINGLES[17]),
    (MULE_SINGLES[7], MULE_SINGLES[25]),
    (MULE_SINGLES[15], MULE_SINGLES[23]),
    (MULE_SINGLES[8], MULE_SINGLES[20]),
)
MULE_UNKNOWNS = (
    unknown("sticking_spool", 0.30, "dipper"),
    unknown("sticking_spool", 0.55, "slew"),
    unknown("closing_lag", 0.50, "dipper"),
    unknown("shifting_load", 0.35),
    unknown("bad_sector", 30.0e3),
    unknown("stiffening_hose", 20.0),
    unknown("foaming_oil", 3.0),
    unknown("late_slew_brake", 0.70),
    unknown("crossed_pilot", 0.35),
    unknown("gripper_shares_pump", 0.15),
    unknown("claw_kick", 0.5),
    unknown("wind_shear", 5.0),
    unknown("drifting_gyro", 0.02),
    unknown("weak_pump_under_pressure", 0.3),
)

PLANTS: Mapping[str, Contents] = {
    one.name: one
    for one in (
        Contents(Ring, RING_SINGLES, RING_PAIRS, RING_UNKNOWNS),
        Contents(Mule, MULE_SINGLES, MULE_PAIRS, MULE_UNKNOWNS),
    )
}
