"""What can be wrong with the machine: changes of parameters, each acting at its place in the physics."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.plants.mule.parameters import Parameters

JOINTS = ("slew", "boom", "dipper", "telescope")
PITCH_INERTIA_KG_M2, ROLL_INERTIA_KG_M2 = 275.0, 194.0

ADDED: dict[str, dict[str, tuple[str, int | None]]] = {
    "valve_dead_time": {"extra_dead_time_s": ("dead_time", None)},
    "valve_lag": {"extra_lag_s": ("lag", None)},
    "valve_dead_band": {
        "positive_ratio": ("band_positive", None),
        "negative_ratio": ("band_negative", None),
    },
    "valve_gain": {
        "positive_ratio": ("gain_positive", None),
        "negative_ratio": ("gain_negative", None),
    },
    "valve_hysteresis": {"half_width_ratio": ("play", None)},
    "speed_limit": {"reduction_ratio": ("reduction", None)},
    "load_dependent_speed": {"loss_ratio": ("load_loss", None)},
    "backlash": {"gap_rad_m": ("gap", None)},
    "joint_sensor_bias": {"bias_rad_m": ("position_bias", None)},
    "joint_sensor_latency": {"extra_latency_s": ("joint_late", None)},
    "imu_latency": {"extra_latency_s": ("imu_late", 0)},
    "imu_misalignment": {
        "roll_rad": ("imu_angles", 0),
        "pitch_rad": ("imu_angles", 1),
        "yaw_rad": ("imu_angles", 2),
    },
    "base_tilt": {"roll_rad": ("base", 0), "pitch_rad": ("base", 1)},
    "base_yaw_drift": {"yaw_rad": ("base", 2)},
    "base_height": {"extra_height_m": ("base", 3)},
    "hose_stiffness": {"stiffness_per_s2": ("hose", 0)},
    "payload_mass": {"extra_mass_kg": ("mass", 5)},
    "payload_offset": {"offset_x_m": ("load_offset", 0), "offset_y_m": ("load_offset", 1)},
    "release_delay": {"extra_delay_s": ("open_delay", 0)},
    "sticky_release": {"slowdown_ratio": ("drag_on_claws", 0)},
    "wind": {"x_m_per_s": ("wind", 0), "y_m_per_s": ("wind", 1)},
    "release_spin": {"spin_rad_per_s": ("spin", 0)},
}
"""Effects of docs/effects.md that add to a field: its name and index, None for the effect's joint."""
SPECIAL = {
    "gripper_length": "extra_length_m",
    "gripper_inertia": "extra_inertia_ratio",
    "passive_viscous_friction": "extra_viscous_per_s",
    "passive_coulomb_friction": "extra_coulomb_rad_per_s2",
    "pump_flow_sharing": "shortage_ratio",
    "release_jitter": "extra_sd_s",
    "air_drag": "extra_drag_coefficient_ratio",
}
KNOWN = (*ADDED, *SPECIAL)
UNKNOWN: dict[str, str] = {
    "sticking_spool": "s: in one throw in three the joint's spool stands still for this long as it starts",
    "closing_lag": "s: the joint's spool has this much more lag towards its middle",
    "shifting_load": "m: the load slides this far in the claws to where they swing",
    "bad_sector": "N m: dry friction more in three sectors of the slew ring",
    "stiffening_hose": "1/s2: hoses pull the gripper back with the cube of its angle",
    "foaming_oil": "1: oil springs softer by it within the first 2 s of a throw",
    "late_slew_brake": "s: the slew's brake opens this late after each standstill and closes at once",
    "crossed_pilot": "1: the dipper's valve gets this share of the boom's command",
    "gripper_shares_pump": "s: the gripper opens later by it at full flow of the pump",
    "claw_kick": "m/s: the claw on the right opens first and pushes the load to the left",
    "wind_shear": "1/s: wind along x that grows with height",
    "drifting_gyro": "rad/s2: the pitch rate's bias grows with time in a throw",
    "weak_pump_under_pressure": "1: the pump gives less by it from 100 bar on, from 40 bar on in proportion",
}
"""Effects outside that table: what their parameter `size` is. They set the field of the same name."""
PER_JOINT = ("sticking_spool", "closing_lag")


@dataclass(frozen=True)
class Effect:
    """An effect with its parameters."""

    effect: str
    joint: str | None
    parameters: dict[str, float]


def parse_effects(data: Sequence[Mapping[str, Any]]) -> list[Effect]:
    """Effects of JSON objects with `effect`, `joint` and `parameters`.

    Raises:
        ValueError: an effect that this plant does not have.
    """
    effects = [
        Effect(str(item["effect"]), item.get("joint"), dict(item["parameters"])) for item in data
    ]
    for one in effects:
        if one.effect not in KNOWN and one.effect not in UNKNOWN:
            raise ValueError(f"the plant `mule` has no effect {one.effect}")
    return effects


def apply(effect: Effect, p: Parameters) -> None:
    """Change the parameters.

    Raises:
        ValueError: a parameter or a joint that the effect does not have.
    """
    for name, value in effect.parameters.items():
        if effect.effect in UNKNOWN and name == "size":
            index = _joint(effect) if effect.effect in PER_JOINT else 0
            p[effect.effect][index] = value
        elif (place := ADDED.get(effect.effect, {}).get(name)) is not None:
            field, index = place
            p[field][_joint(effect) if index is None else index] += value
        elif SPECIAL.get(effect.effect) == name:
            _apply_special(effect.effect, value, p)
        else:
            raise ValueError(f"{effect.effect} has no parameter {name}")


def _apply_special(effect: str, value: float, p: Parameters) -> None:
    match effect:
        case "gripper_length":
            p["gripper_com"] += value
            p["grip_length"] += value
        case "gripper_inertia":
            p["inertia"][12:15] *= 1.0 + value
        case "passive_viscous_friction":
            p["viscous"][4:] += value * np.array([PITCH_INERTIA_KG_M2, ROLL_INERTIA_KG_M2])
            p["viscous"][4:] = np.maximum(p["viscous"][4:], 0.0)
        case "passive_coulomb_friction":
            p["dry"][4:] += value * np.array([PITCH_INERTIA_KG_M2, ROLL_INERTIA_KG_M2])
            p["dry"][4:] = np.maximum(p["dry"][4:], 0.0)
        case "pump_flow_sharing":
            p["pump_flow"] *= 1.0 - value
        case "release_jitter":
            p["open_sd"] = np.hypot(p["open_sd"], value)
        case _:
            p["drag"] *= 1.0 + value


def _joint(effect: Effect) -> int:
    if effect.joint not in JOINTS:
        raise ValueError(f"{effect.effect} acts on one of {', '.join(JOINTS)}, not {effect.joint}")
    return JOINTS.index(effect.joint)
