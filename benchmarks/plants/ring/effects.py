"""Effects that the plant can be given: those of docs/effects.md by name, and unknown ones outside it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from benchmarks.plants.ring.parameters import Parameters

JOINTS = ("slew", "boom", "dipper", "telescope")


@dataclass(frozen=True)
class Effect:
    """One thing that is wrong with the machine."""

    effect: str
    """Name of docs/effects.md, or of `UNKNOWN`."""
    joint: str | None = None
    parameters: Mapping[str, float] = field(default_factory=dict[str, float])
    """By name; those of docs/effects.md, or `size` for an unknown effect."""


ADDED: dict[str, dict[str, tuple[str, int | None]]] = {
    "valve_dead_time": {"extra_dead_time_s": ("dead_time", None)},
    "valve_lag": {"extra_lag_s": ("spool_lag", None)},
    "valve_gain": {
        "positive_ratio": ("gain_positive", None),
        "negative_ratio": ("gain_negative", None),
    },
    "valve_hysteresis": {"half_width_ratio": ("play", None)},
    "speed_limit": {"reduction_ratio": ("limit_reduction", None)},
    "load_dependent_speed": {"loss_ratio": ("load_loss", None)},
    "passive_viscous_friction": {"extra_viscous_per_s": ("swing_viscous", 0)},
    "hose_stiffness": {"stiffness_per_s2": ("hose", 0)},
    "payload_mass": {"extra_mass_kg": ("load_mass", 0)},
    "payload_offset": {"offset_x_m": ("load_offset", 0), "offset_y_m": ("load_offset", 1)},
    "release_delay": {"extra_delay_s": ("release_delay", 0)},
    "sticky_release": {"slowdown_ratio": ("release_slowdown", 0)},
    "wind": {"x_m_per_s": ("wind", 0), "y_m_per_s": ("wind", 1)},
    "release_spin": {"spin_rad_per_s": ("release_spin", 0)},
    "joint_sensor_bias": {"bias_rad_m": ("joint_bias", None)},
    "joint_sensor_latency": {"extra_latency_s": ("joint_latency", None)},
    "imu_latency": {"extra_latency_s": ("imu_latency", 0)},
    "imu_misalignment": {
        "roll_rad": ("imu_turn", 0),
        "pitch_rad": ("imu_turn", 1),
        "yaw_rad": ("imu_turn", 2),
    },
    "base_tilt": {"roll_rad": ("base_turn", 0), "pitch_rad": ("base_turn", 1)},
    "base_yaw_drift": {"yaw_rad": ("base_turn", 2)},
    "base_height": {"extra_height_m": ("base_height", 0)},
}
"""Effects that add to a parameter: field and index by effect parameter; index None is the joint's."""

KNOWN = (
    *ADDED,
    "valve_dead_band",
    "passive_coulomb_friction",
    "gripper_length",
    "gripper_inertia",
    "pump_flow_sharing",
    "release_jitter",
    "air_drag",
)

UNKNOWN: dict[str, str] = {
    "sticking_spool": "In one throw of three the joint's spool sticks in its centre for `size` s at first.",
    "leaking_piston": "Oil passes the piston: the drive slips by `size` of its deflection a second.",
    "engine_sag": "Pump flow falls by `size` under full power, and comes back in 0.6 s.",
    "half_opening_gripper": "The load slides off one claw, which deflects its speed upwards by `size` rad.",
    "dragging_slew_ring": "Dry friction of the slew up to `size` N m more, over the angle of the slew.",
    "position_dependent_gain": "Valve gain of the joint changes by plus or minus `size` over its range.",
    "air_in_oil": "The joint's oil spring is softer by `size`.",
    "pump_hunting": "The pump's pressure margin swings by `size` at 1.4 Hz.",
    "slow_opening_spool": "The spool opens with a lag of `size` s and closes at once.",
}
"""Effects outside docs/effects.md, with the meaning of their one parameter `size`."""


def parse_effects(data: Sequence[Mapping[str, Any]]) -> list[Effect]:
    """Effects from JSON objects with `effect`, `joint` and `parameters`.

    Raises:
        ValueError: unknown effect, parameter or joint.
    """
    effects = [Effect(**item) for item in data]
    for effect in effects:
        if effect.effect not in KNOWN and effect.effect not in UNKNOWN:
            raise ValueError(f"the plant has no effect {effect.effect!r}")
        if effect.joint is not None and effect.joint not in JOINTS:
            raise ValueError(f"{effect.effect}: no driven joint {effect.joint!r}")
    return effects


def apply(effect: Effect, p: Parameters) -> None:
    """Change the machine's parameters by an effect.

    Raises:
        ValueError: a parameter that the effect does not have, or no joint where one is needed.
    """
    if effect.effect in UNKNOWN:
        _apply_unknown(effect, p)
        return
    values = dict(effect.parameters)
    match effect.effect:
        case "valve_dead_band":
            joint = _joint(effect)
            p["band_positive"][joint] += values.pop("positive_ratio", 0.0)
            p["band_negative"][joint] += values.pop("negative_ratio", 0.0)
        case "passive_coulomb_friction":
            extra = values.pop("extra_coulomb_rad_per_s2", 0.0)
            p["swing_coulomb"] += extra
            p["swing_breakaway"] += extra
        case "gripper_length":
            extra = values.pop("extra_length_m", 0.0)
            p["com"][17] -= extra
            p["grip_length"] += extra
        case "gripper_inertia":
            p["inertia"][15:18] *= 1.0 + values.pop("extra_inertia_ratio", 0.0)
        case "pump_flow_sharing":
            p["pump_flow"] *= 1.0 - values.pop("shortage_ratio", 0.0)
        case "release_jitter":
            extra_sd = values.pop("extra_sd_s", 0.0)
            p["release_sd"][:] = (p["release_sd"] ** 2 + extra_sd**2) ** 0.5
        case "air_drag":
            p["load_drag"] *= 1.0 + values.pop("extra_drag_coefficient_ratio", 0.0)
        case name:
            for parameter, (target, index) in ADDED[name].items():
                where = _joint(effect) if index is None else index
                p[target][where] += values.pop(parameter, 0.0)
    if values:
        raise ValueError(f"{effect.effect} has no parameter {', '.join(values)}")


def _apply_unknown(effect: Effect, p: Parameters) -> None:
    size = effect.parameters["size"]
    match effect.effect:
        case "sticking_spool":
            p["stick_share"][_joint(effect)] = 1.0 / 3.0
            p["stick_time"][_joint(effect)] = size
        case "leaking_piston":
            p["leak_rate"][_joint(effect)] = size
        case "engine_sag":
            p["engine_sag"][:] = size
        case "half_opening_gripper":
            p["half_open"][:] = size
        case "dragging_slew_ring":
            p["ring_drag"][:] = size
        case "position_dependent_gain":
            p["position_gain"][_joint(effect)] = size
        case "air_in_oil":
            p["air_in_oil"][_joint(effect)] = size
        case "pump_hunting":
            p["pressure_hunting"][:] = size
        case _:
            p["slow_opening"][_joint(effect)] = size


def _joint(effect: Effect) -> int:
    if effect.joint is None:
        raise ValueError(f"{effect.effect} needs a joint")
    return JOINTS.index(effect.joint)
