"""Parameters of the nominal machine, of units and of days. SI units; joints as in docs/machine.md."""

from collections.abc import Mapping

import numpy as np

from machine.conventions import Array
from machine.spec import load_spec

Parameters = dict[str, Array]

NOMINAL: Mapping[str, float | list[float]] = {
    "imu_place": [0.20, 0.0, -0.42],
    # boom, dipper, telescope, hanger, gripper, load
    "mass": [750.0, 450.0, 400.0, 20.0, 380.0, 0.609],
    "inertia": [
        *(40.0, 510.0, 500.0, 150.0, 153.0, 25.0, 173.0, 175.0, 12.0),
        *(0.2, 0.2, 0.1, 40.6, 40.6, 25.0, 0.006, 0.006, 0.006),
    ],
    "upper_inertia": 4700.0 + 4700.0 * 0.70**2,
    # Speeds of the actuators at full opening, m/s (slew: rad/s), without load.
    "speed_positive": [0.99, 0.245, 0.395, 0.385],
    "speed_negative": [0.96, 0.275, 0.400, 0.545],
    "gain_positive": [1.0] * 4,
    "gain_negative": [1.0] * 4,
    "band_positive": [0.045, 0.035, 0.04, 0.04],
    "band_negative": [0.04, 0.04, 0.035, 0.045],
    "dead_time": [0.12, 0.060, 0.055, 0.065],
    "lag": [0.09, 0.045, 0.040, 0.050],
    "stroke_s": [0.22, 0.12, 0.11, 0.12],
    "play": [0.008, 0.006, 0.006, 0.008],
    "notch": [0.30, 0.25, 0.28, 0.22],
    "largest_load": [1e9, 69.7e3, 27.7e3, 7.85e3],
    "bypass": 0.06,
    # Oil springs, N/m (slew: N m/rad), and the force that one unit of leaking speed takes, N s/m.
    "stiffness": [2.4e6, 3.6e7, 1.6e7, 1.5e6],
    "flow_damping": [4.5e5, 7.0e6, 2.2e6, 2.2e5],
    "closed_factor": [4.0, 200.0, 200.0, 200.0],
    "damper": [7.0e3, 8.0e4, 2.6e4, 1.8e3],
    "pump_flow": 220.0 / 60e3,
    "pump_power": 88e3,
    "pump_lag": 0.05,
    "pump_standby": 70.0 / 60e3,
    # Dry friction, N m (telescope: N), then viscous, N m s.
    "dry": [2200.0, 2200.0, 1000.0, 700.0, 27.5, 19.4],
    "viscous": [0.0, 0.0, 0.0, 0.0, 8.25, 5.82],
    "static_ratio": 0.25,
    "open_delay": 0.145,
    "open_time": 0.113,
    "open_sd": 0.012,
    "slip": 0.012,
    "grasp": 0.008,
    "encoder_step": [2.0 * np.pi / 16384.0, 2.0 * np.pi / 20000.0, 2.0 * np.pi / 20000.0, 2.5e-4],
    "encoder_noise": [1e-4, 1e-4, 1e-4, 1e-4],
    "gyro_drift": 1e-5,
}
"""What the drawing does not give; the other fields are 0 or come from machine/spec.json."""


def nominal(sizes: Mapping[str, int]) -> Parameters:
    """Parameters of unit 0 on day 0, by name; `sizes` are the fields of the C code in order."""
    spec = load_spec()
    geometry, limits, oil, ball = spec.geometry, spec.limits, spec.hydraulics, spec.ball
    x, y, z = geometry.boom_pivot_m
    slew = oil.slew_displacement_m3_per_rad

    def areas(bore_m: float, rod_m: float) -> tuple[float, float]:
        full = 0.25 * np.pi * bore_m**2
        return full, full - 0.25 * np.pi * rod_m**2

    boom = areas(oil.boom_cylinder.bore_m, oil.boom_cylinder.rod_m)
    dipper = areas(oil.dipper_cylinder.bore_m, oil.dipper_cylinder.rod_m)
    tube = areas(oil.telescope_bore_m, oil.telescope_rod_m)
    pressure = oil.supply_pressure_pa
    values: dict[str, float | list[float] | tuple[float, ...]] = {
        "pivot": [x, y, z + geometry.slew_frame_height_m],
        "boom_length": geometry.boom_length_m,
        "tube_offset": geometry.telescope_axis_offset_m,
        "tube_length": geometry.dipper_to_telescope_m,
        "pin_length": geometry.telescope_to_pin_m,
        "roll_length": geometry.pitch_to_roll_m,
        "grip_length": geometry.roll_to_grip_centre_m,
        "gripper_com": spec.passive.gripper_com_m,
        "boom_cylinder": [*oil.boom_cylinder.base_xz_m, *oil.boom_cylinder.rod_xz_m],
        "dipper_cylinder": [*oil.dipper_cylinder.base_xz_m, *oil.dipper_cylinder.rod_xz_m],
        # The dipper's cylinder shortens as the dipper goes out.
        "area_positive": [slew, boom[0], dipper[1], tube[0]],
        "area_negative": [slew, boom[1], dipper[0], tube[1]],
        "rated_positive": limits.speed_positive_rad_m_per_s,
        "rated_negative": limits.speed_negative_rad_m_per_s,
        # The slew's motor gives 44 kN m at its relief valves.
        "force_positive": [44e3, *(pressure * area for area in (boom[0], dipper[0], tube[0]))],
        "force_negative": [44e3, *(pressure * area for area in (boom[1], dipper[1], tube[1]))],
        "stop_low": [-1e9 if v is None else v for v in limits.position_min_rad_m],
        "stop_high": [1e9 if v is None else v for v in limits.position_max_rad_m],
        "radius": ball.radius_m,
        "drag": ball.drag_coefficient_ratio,
        "air": ball.air_density_kg_per_m3,
        **NOMINAL,
    }
    p = {name: np.zeros(size) for name, size in sizes.items()}
    for name, value in values.items():
        p[name][:] = value
    return p


def vary_unit(p: Parameters, unit: int) -> None:
    """Make it machine number `unit`: what differs from one machine to the next. Unit 0 stays nominal."""
    if unit == 0:
        return
    rng = np.random.default_rng([71, unit])

    def scale(name: str, share: float) -> None:
        p[name] *= 1.0 + share * rng.uniform(-1.0, 1.0, p[name].size)

    def shift(name: str, width: float) -> None:
        p[name] += width * rng.uniform(-1.0, 1.0, p[name].size)

    for name in ("boom_length", "tube_length", "grip_length", "roll_length"):
        shift(name, 0.003)
    for name in ("mass", "inertia", "upper_inertia", "gripper_com"):
        scale(name, 0.03 if name != "gripper_com" else 0.01)
    p["mass"][5] = load_spec().ball.mass_kg * (1.0 + 0.01 * rng.uniform(-1.0, 1.0))
    for name in ("speed_positive", "speed_negative", "pump_flow"):
        scale(name, 0.05)
    for name in (
        "lag",
        "stroke_s",
        "stiffness",
        "flow_damping",
        "damper",
        "dry",
        "viscous",
        "notch",
    ):
        scale(name, 0.20)
    shift("dead_time", 0.012)
    for name in ("band_positive", "band_negative"):
        shift(name, 0.01)
    scale("force_positive", 0.05)
    p["force_negative"][0] = p["force_positive"][0]
    shift("open_delay", 0.02)
    shift("position_bias", 0.003)
    shift("imu_angles", 0.010)
    shift("gyro_bias", 0.002)
    shift("accel_bias", 0.03)
    scale("drag", 0.03)


def vary_day(p: Parameters, unit: int, day: int) -> None:
    """Make it day number `day`: what nobody would have repaired. Day 0 stays as it is."""
    if day == 0:
        return
    rng = np.random.default_rng([72, unit, day])

    def normal(size: int) -> Array:
        return np.clip(rng.normal(size=size), -2.0, 2.0)

    common = 0.007 * normal(1)
    for name in ("gain_positive", "gain_negative"):
        p[name] *= 1.0 + common + 0.007 * normal(4)
    p["dead_time"] += 0.002 * normal(4)
    for name in ("band_positive", "band_negative"):
        p[name] += 0.003 * normal(4)
    for name in ("dry", "viscous"):
        p[name] *= 1.0 + 0.15 * normal(6)
    p["position_bias"][1:] += 0.001 * normal(3)
    p["imu_angles"] += 0.002 * normal(3)
    p["base"][:3] += 0.002 * normal(3)
    p["gyro_bias"] += 0.0005 * normal(3)
