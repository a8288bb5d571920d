"""Properties of a virtual machine by name, and machines with one of them set to nominal.

For reports on simulated machines. Controllers, twin and training must not read it, as with `MachineUnit`.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from machine.spec import MachineSpec
from sim_twin.virtual.units import MachineUnit, nominal_unit

PROPERTIES: dict[str, tuple[str, ...]] = {
    "dead time of the valves": ("dead_time_s",),
    "lag of the spools": ("spool_lag_s",),
    "valve openings": (
        "dead_band_positive_ratio", "dead_band_negative_ratio", "hysteresis_ratio",
        "valve_gain_positive_ratio", "valve_gain_negative_ratio", "metering_curve_ratio",
    ),
    "friction of the drives": ("friction_pressure_pa", "viscous_friction_ratio"),
    "oil, pump and pressures": (
        "bulk_modulus_pa", "pump_flow_m3_per_s", "supply_pressure_pa", "slew_relief_pressure_pa",
    ),
    "lengths": (
        "boom_pivot_x_m", "boom_pivot_z_m", "boom_length_m", "dipper_to_telescope_m",
        "telescope_to_pin_m", "pitch_to_roll_m", "roll_to_grip_centre_m",
    ),
    "masses of the arm": (
        "upper_mass_ratio", "boom_mass_ratio", "dipper_mass_ratio", "telescope_mass_ratio",
    ),
    "gripper and its swing": (
        "gripper_com_m", "gripper_mass_kg", "gripper_inertia_ratio", "swing_viscous_ratio",
        "swing_coulomb_ratio",
    ),
    "opening and load": (
        "release_delay_s", "release_delay_sd_s", "ball_mass_kg", "ball_radius_m",
        "drag_coefficient_ratio",
    ),
    "sensors and levelling": (
        "joint_bias_rad_m", "gyro_bias_rad_per_s", "accel_bias_m_per_s2", "imu_misalignment_rad",
        "base_height_error_m", "base_tilt_rad",
    ),
}  # fmt: skip
"""Name of each property and its fields of `MachineUnit`; every field in which units differ occurs once."""


def as_drawn(spec: MachineSpec, unit: MachineUnit, properties: Iterable[str]) -> MachineUnit:
    """The machine with the given properties of the nominal unit; its unit seed is kept."""
    nominal = nominal_unit(spec)
    values: dict[str, Any] = {
        name: getattr(nominal, name) for words in properties for name in PROPERTIES[words]
    }
    return replace(unit, **values)
