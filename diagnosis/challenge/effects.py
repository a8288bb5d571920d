"""What a challenge may hide: ranges of every effect, confounded pairs, detection limits.

It names effects and stages by the diagnosis contract, and reads nothing of the twin's effect library.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Final, NamedTuple

from machine.conventions import ACTIVE_JOINTS
from machine.errors import UsageError

LIMITS_PATH: Final = Path(__file__).with_name("detection_limits.json")
"""Made by ``python -m diagnosis.challenge.detection_limits``."""


class HiddenEffect(NamedTuple):
    """One effect that a challenge may hide."""

    stage: str
    bounds: Mapping[str, tuple[float, float]]
    """Of each parameter, in its unit."""
    joints: tuple[str, ...] = ()
    """Empty: an effect of the whole machine."""


_ALL = tuple(ACTIVE_JOINTS)
_LOADED = ("boom", "dipper", "telescope")
_A, _S, _R, _F, _M = "actuation", "swing", "release", "flight", "aim"

LIBRARY: Final[Mapping[str, HiddenEffect]] = {
    "valve_dead_time": HiddenEffect(_A, {"extra_dead_time_s": (-0.05, 0.3)}, _ALL),
    "valve_lag": HiddenEffect(_A, {"extra_lag_s": (-0.04, 0.6)}, _ALL),
    "valve_dead_band": HiddenEffect(
        _A, {"positive_ratio": (0.0, 0.4), "negative_ratio": (0.0, 0.4)}, _ALL
    ),
    "valve_gain": HiddenEffect(
        _A, {"positive_ratio": (-0.5, 0.5), "negative_ratio": (-0.5, 0.5)}, _ALL
    ),
    "valve_hysteresis": HiddenEffect(_A, {"half_width_ratio": (0.0, 0.2)}, _ALL),
    "speed_limit": HiddenEffect(_A, {"reduction_ratio": (0.0, 0.7)}, _ALL),
    "load_dependent_speed": HiddenEffect(_A, {"loss_ratio": (-0.6, 0.6)}, _LOADED),
    "backlash": HiddenEffect(_A, {"gap_rad_m": (0.0, 0.06)}, _ALL),
    "stiction": HiddenEffect(_A, {"breakaway_rad_m_per_s": (0.0, 0.15)}, _ALL),
    "pump_flow_sharing": HiddenEffect(_A, {"shortage_ratio": (0.0, 0.6)}),
    "passive_viscous_friction": HiddenEffect(_S, {"extra_viscous_per_s": (-0.03, 0.6)}),
    "passive_coulomb_friction": HiddenEffect(_S, {"extra_coulomb_rad_per_s2": (-0.1, 0.6)}),
    "gripper_length": HiddenEffect(_S, {"extra_length_m": (-0.3, 0.3)}),
    "gripper_inertia": HiddenEffect(_S, {"extra_inertia_ratio": (-0.5, 0.8)}),
    "hose_stiffness": HiddenEffect(_S, {"stiffness_per_s2": (0.0, 3.0)}),
    "payload_mass": HiddenEffect(_S, {"extra_mass_kg": (-0.5, 5.0)}),
    "payload_offset": HiddenEffect(_S, {"offset_x_m": (-0.3, 0.3), "offset_y_m": (-0.3, 0.3)}),
    "release_delay": HiddenEffect(_R, {"extra_delay_s": (-0.2, 0.3)}),
    "release_jitter": HiddenEffect(_R, {"extra_sd_s": (0.0, 0.1)}),
    "sticky_release": HiddenEffect(_R, {"slowdown_ratio": (0.0, 0.4)}),
    "air_drag": HiddenEffect(_F, {"extra_drag_coefficient_ratio": (-0.5, 2.0)}),
    "wind": HiddenEffect(_F, {"x_m_per_s": (-10.0, 10.0), "y_m_per_s": (-10.0, 10.0)}),
    "release_spin": HiddenEffect(_F, {"spin_rad_per_s": (-30.0, 30.0)}),
    "joint_sensor_bias": HiddenEffect(_M, {"bias_rad_m": (-0.08, 0.08)}, _ALL),
    "joint_sensor_latency": HiddenEffect(_M, {"extra_latency_s": (0.0, 0.15)}, _ALL),
    "imu_latency": HiddenEffect(_M, {"extra_latency_s": (0.0, 0.15)}),
    "imu_misalignment": HiddenEffect(
        _M, {"roll_rad": (-0.2, 0.2), "pitch_rad": (-0.2, 0.2), "yaw_rad": (-0.2, 0.2)}
    ),
    "base_tilt": HiddenEffect(_M, {"roll_rad": (-0.1, 0.1), "pitch_rad": (-0.1, 0.1)}),
    "base_yaw_drift": HiddenEffect(_M, {"yaw_rad": (-0.15, 0.15)}),
    "base_height": HiddenEffect(_M, {"extra_height_m": (-0.5, 0.5)}),
    "chassis_compliance": HiddenEffect(_M, {"pitch_rad": (0.0, 0.06)}),
}
"""The effects of the contract. Negative dead times and lags end where the virtual machine's own do."""

DRIFTS: Final = (
    ("valve_dead_time", "extra_dead_time_s"),
    ("valve_lag", "extra_lag_s"),
    ("valve_dead_band", "positive_ratio"),
    ("valve_dead_band", "negative_ratio"),
    ("valve_gain", "positive_ratio"),
    ("valve_gain", "negative_ratio"),
    ("pump_flow_sharing", "shortage_ratio"),
    ("passive_viscous_friction", "extra_viscous_per_s"),
    ("release_delay", "extra_delay_s"),
    ("sticky_release", "slowdown_ratio"),
    ("joint_sensor_bias", "bias_rad_m"),
)
"""What may drift within a set; ``warm_up_drift`` names one of them."""
DRIFT_LIMIT_RATIO: Final = 2.0
"""A ramp from 0 to d has a root mean square of d / sqrt(3), and starts unseen."""

UNKNOWN: Final[Mapping[str, HiddenEffect]] = {
    "turntable_torsion": HiddenEffect(_M, {"windup_rad": (0.0, 0.05)}),
    "gain_oscillation": HiddenEffect(
        _A, {"amplitude_ratio": (0.0, 0.8), "frequency_hz": (0.8, 2.5)}, _ALL
    ),
    "command_dropouts": HiddenEffect(_A, {"rate_per_s": (0.0, 4.0), "length_s": (0.06, 0.25)}),
    "fading_hysteresis": HiddenEffect(
        _A, {"half_width_ratio": (0.0, 0.5), "travel_rad_m": (0.15, 0.5)}, _ALL
    ),
    "gust": HiddenEffect(_F, {"speed_m_per_s": (0.0, 20.0)}),
    "uneven_claw": HiddenEffect(_R, {"kick_x_m_per_s": (-1.5, 1.5), "kick_y_m_per_s": (-1.5, 1.5)}),
    "valve_crosstalk": HiddenEffect(_A, {"leak_ratio": (-0.5, 0.5)}, _ALL),
    "position_dependent_gain": HiddenEffect(
        _A, {"loss_ratio": (0.0, 0.9), "width_rad_m": (0.06, 0.15)}, ("boom", "dipper")
    ),
    "command_steps": HiddenEffect(_A, {"step_ratio": (0.0, 0.6)}, _ALL),
    "encoder_scale": HiddenEffect(_M, {"error_ratio": (-0.15, 0.15)}, _LOADED),
}
"""Effects that no library has."""
STRENGTH: Final[Mapping[str, str]] = {
    "gain_oscillation": "amplitude_ratio",
    "command_dropouts": "rate_per_s",
    "fading_hysteresis": "half_width_ratio",
    "position_dependent_gain": "loss_ratio",
}
"""The parameter that grows with the strength where another only says what kind it is."""

CONFOUNDED: Final[tuple[tuple[str, str], ...]] = (
    ("valve_dead_time", "valve_lag"),
    ("valve_dead_time", "valve_dead_band"),
    ("valve_dead_band", "stiction"),
    ("valve_dead_band", "valve_gain"),
    ("valve_dead_band", "valve_hysteresis"),
    ("backlash", "valve_hysteresis"),
    ("speed_limit", "valve_gain"),
    ("load_dependent_speed", "valve_gain"),
    ("joint_sensor_latency", "valve_dead_time"),
    ("passive_coulomb_friction", "passive_viscous_friction"),
    ("passive_viscous_friction", "imu_latency"),
    ("payload_mass", "passive_viscous_friction"),
    ("release_delay", "air_drag"),
    ("release_delay", "base_yaw_drift"),
    ("release_delay", "payload_offset"),
    ("air_drag", "wind"),
    ("joint_sensor_bias", "base_tilt"),
    ("joint_sensor_bias", "gripper_length"),
    ("base_tilt", "imu_misalignment"),
)
"""Pairs of the design's table of what is hard to tell apart; effects of joints sit on the same joint."""


def limit_key(effect: str, joint: str | None, parameter: str) -> str:
    """Name of a detection limit, ``effect.joint.parameter``."""
    return ".".join(part for part in (effect, joint, parameter) if part)


def load_limits(path: Path = LIMITS_PATH) -> dict[str, float]:
    """Detection limits by name, in the parameter's unit.

    Raises:
        UsageError: the file is missing or broken.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))["limits"]
        return {str(name): float(size) for name, size in found.items()}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UsageError(
            f"detection limits {path} cannot be read ({error}); "
            "make them with `python -m diagnosis.challenge.detection_limits`"
        ) from error
