"""Parameters of a machine: nominal values, what differs between units, what a day changes.

Sources: docs/machine.md and machine/spec.json for geometry, masses and limits; the rest is this plant's own.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from machine.spec import MachineSpec, load_spec

Parameters = dict[str, Any]
"""By field of the C struct: an array of its length, or one of length 1."""

DAY_DEAD_TIME_SD_S = 0.002
DAY_GAIN_SD = 0.01
DAY_BAND_SD = 0.003
DAY_FRICTION_SD = 0.15
DAY_MOUNTING_SD_RAD = 0.002


def nominal(sizes: Mapping[str, int]) -> Parameters:
    """The machine of the drawing."""
    spec = load_spec()
    made = {name: np.zeros(size) for name, size in sizes.items()}
    for name, value in (_bodies(spec) | _drives(spec) | _swing_and_sensors(spec)).items():
        made[name][:] = value
    return made


def _bodies(spec: MachineSpec) -> dict[str, Any]:
    """Lengths, masses and inertias."""
    geometry, passive, ball = spec.geometry, spec.passive, spec.ball
    return {
        "slew_height": geometry.slew_frame_height_m,
        "boom_pivot": geometry.boom_pivot_m,
        "boom_length": geometry.boom_length_m,
        "telescope_offset": geometry.telescope_axis_offset_m,
        "dipper_length": geometry.dipper_to_telescope_m,
        "tool_length": geometry.telescope_to_pin_m,
        "hanger_length": geometry.pitch_to_roll_m,
        "grip_length": geometry.roll_to_grip_centre_m,
        "imu_place": [0.20, 0.0, -0.42],
        "mass": [4700.0, 750.0, 450.0, 400.0, passive.hanger_mass_kg, passive.gripper_mass_kg],
        "com": [
            *(-0.70, 0.0, 0.55),
            *(1.149, 0.0, -0.084),
            *(0.252, 0.0, -0.189),
            *(0.0, 0.0, 0.589),
            *(0.0, 0.0, -passive.hanger_com_m),
            *(0.0, 0.0, -passive.gripper_com_m),
        ],
        "inertia": [
            *(3300.0, 3600.0, 4700.0),
            *(40.0, 510.0, 500.0),
            *(150.0, 153.0, 25.0),
            *(173.0, 175.0, 12.0),
            *passive.hanger_inertia_kg_m2,
            *passive.gripper_inertia_kg_m2,
        ],
        "load_mass": ball.mass_kg,
        "load_radius": ball.radius_m,
        "load_drag": ball.drag_coefficient_ratio,
        "air_density": ball.air_density_kg_per_m3,
    }


def _drives(spec: MachineSpec) -> dict[str, Any]:
    """Limits, cylinders, pump, valves, oil springs and friction of the driven joints."""
    limits, hydraulics = spec.limits, spec.hydraulics
    bore = (
        0.25
        * np.pi
        * np.square(
            [
                hydraulics.boom_cylinder.bore_m,
                hydraulics.dipper_cylinder.bore_m,
                hydraulics.telescope_bore_m,
            ]
        )
    )
    annulus = bore - 0.25 * np.pi * np.square(
        [
            hydraulics.boom_cylinder.rod_m,
            hydraulics.dipper_cylinder.rod_m,
            hydraulics.telescope_rod_m,
        ]
    )
    slew = hydraulics.slew_displacement_m3_per_rad
    low = [-1e9 if value is None else value for value in limits.position_min_rad_m]
    high = [1e9 if value is None else value for value in limits.position_max_rad_m]
    return {
        "position_min": low,
        "position_max": high,
        "rated_positive": limits.speed_positive_rad_m_per_s,
        "rated_negative": limits.speed_negative_rad_m_per_s,
        "cylinder_base": [
            *hydraulics.boom_cylinder.base_xz_m,
            *hydraulics.dipper_cylinder.base_xz_m,
        ],
        "cylinder_rod": [*hydraulics.boom_cylinder.rod_xz_m, *hydraulics.dipper_cylinder.rod_xz_m],
        # The boom extends upwards, the dipper retracts outwards, the telescope extends outwards.
        "area_positive": [slew, bore[0], annulus[1], bore[2]],
        "area_negative": [slew, annulus[0], bore[1], annulus[2]],
        "pump_flow": hydraulics.pump_flow_m3_per_s,
        "pump_pressure": hydraulics.supply_pressure_pa,
        "pump_margin": 2.2e6,
        "pump_lag": 0.05,
        # Full opening: rad/s of the slew, m/s of the actuators.
        "full_positive": [1.02, 0.235, 0.39, 0.43],
        "full_negative": [1.02, 0.285, 0.39, 0.53],
        "notch_curve": [0.30, 0.22, 0.25, 0.18],
        "dead_time": [0.105, 0.050, 0.048, 0.052],
        "pilot_frequency": [7.0, 8.0, 8.5, 8.0],
        "pilot_damping": [0.8, 0.75, 0.75, 0.8],
        "spool_lag": [0.06, 0.035, 0.03, 0.03],
        "band_positive": 0.04,
        "band_negative": 0.04,
        "oil_frequency": [1.1, 2.5, 4.5, 6.0],
        "oil_damping": [0.20, 0.28, 0.35, 0.40],
        "torque_limit": [
            52.0e3,
            *(0.45 * hydraulics.supply_pressure_pa * bore[:2]),
            hydraulics.supply_pressure_pa * bore[2],
        ],
        "coulomb": [1800.0, 900.0, 500.0, 700.0],
        "breakaway": [2600.0, 1300.0, 750.0, 1000.0],
        "viscous": [1500.0, 1500.0, 800.0, 1500.0],
        "stribeck_speed": 0.03,
    }


def _swing_and_sensors(spec: MachineSpec) -> dict[str, Any]:
    """Friction of the free joints, release, sensors."""
    passive = spec.passive
    return {
        "swing_viscous": passive.viscous_friction_per_s,
        "swing_coulomb": passive.coulomb_friction_rad_per_s2,
        "swing_breakaway": 1.15 * passive.coulomb_friction_rad_per_s2,
        "swing_inertia_pitch": 275.0,
        "swing_inertia_roll": 194.0,
        "release_delay": spec.release.delay_s,
        "release_sd": spec.release.delay_sd_s,
        "quantum": [1.0e-4, 1.0e-4, 1.0e-4, 1.0e-4],
        "noise": 1.0,
    }


def vary_unit(p: Parameters, seed: int) -> None:
    """What differs between machines of the type, within the drawing's tolerance; 0 is the nominal one."""
    if seed == 0:
        return
    rng = np.random.default_rng([7301, seed])

    def scale(name: str, sd: float) -> None:
        p[name] *= np.clip(
            1.0 + sd * rng.standard_normal(p[name].shape), 1 - 2.5 * sd, 1 + 2.5 * sd
        )

    for name in ("boom_length", "dipper_length", "tool_length", "telescope_offset"):
        p[name] += np.clip(0.003 * rng.standard_normal(1), -0.006, 0.006)
    for name in ("mass", "inertia", "torque_limit", "spool_lag"):
        scale(name, 0.03)
    for name in (
        "full_positive",
        "full_negative",
        "notch_curve",
        "pump_flow",
        "oil_frequency",
        "pilot_frequency",
    ):
        scale(name, 0.04)
    for name in (
        "coulomb",
        "breakaway",
        "viscous",
        "swing_viscous",
        "swing_coulomb",
        "oil_damping",
    ):
        scale(name, 0.12)
    for name in ("pump_margin", "pump_lag", "stribeck_speed"):
        scale(name, 0.08)
    scale("grip_length", 0.005)
    p["com"][17] *= 1.0 + 0.008 * rng.standard_normal()
    p["swing_breakaway"] = 1.15 * p["swing_coulomb"]
    p["dead_time"] += np.clip(0.008 * rng.standard_normal(4), -0.016, 0.016)
    p["band_positive"] += np.clip(0.006 * rng.standard_normal(4), -0.012, 0.012)
    p["band_negative"] += np.clip(0.006 * rng.standard_normal(4), -0.012, 0.012)
    p["release_delay"] += np.clip(0.012 * rng.standard_normal(1), -0.025, 0.025)
    p["joint_bias"] += 0.0015 * rng.standard_normal(4)
    p["imu_turn"] += 0.006 * rng.standard_normal(3)
    p["gyro_bias"] += 0.002 * rng.standard_normal(3)
    p["accel_bias"] += 0.03 * rng.standard_normal(3)


def vary_day(p: Parameters, unit_seed: int, seed: int) -> None:
    """What changes from day to day on a healthy machine; 0 changes nothing."""
    if seed == 0:
        return
    rng = np.random.default_rng([9127, unit_seed, seed])
    for name in ("full_positive", "full_negative"):
        p[name] *= 1.0 + DAY_GAIN_SD * rng.standard_normal(4)
    p["dead_time"] += DAY_DEAD_TIME_SD_S * rng.standard_normal(4)
    for name in ("band_positive", "band_negative"):
        p[name] += DAY_BAND_SD * rng.standard_normal(4)
    for name in ("coulomb", "breakaway", "viscous", "swing_viscous", "swing_coulomb"):
        p[name] *= np.maximum(1.0 + DAY_FRICTION_SD * rng.standard_normal(p[name].shape), 0.4)
    p["swing_breakaway"] = 1.15 * p["swing_coulomb"]
    p["joint_bias"] += DAY_MOUNTING_SD_RAD * rng.standard_normal(4)
    p["imu_turn"] += DAY_MOUNTING_SD_RAD * rng.standard_normal(3)
    p["base_turn"][:2] += DAY_MOUNTING_SD_RAD * rng.standard_normal(2)
