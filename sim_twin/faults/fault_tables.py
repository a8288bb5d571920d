"""All faults of the virtual machine: one for each effect of the table, and some that the table does not have.

A fault of the first kind (`TABLE_FAULTS`) realises the effect of the same name, by physics independent of the
twin's; a diagnosis names it. Those of the second kind (`UNLISTED_FAULTS`) it must call unknown.
"""

from collections.abc import Mapping
from typing import NamedTuple

from machine.conventions import ACTIVE_JOINTS
from sim_twin.effects.schema import DRIFT, EffectSpec, PartName, StageName
from sim_twin.effects.table import EFFECTS, LOADED_JOINTS


class FaultSpec(NamedTuple):
    """What a fault of the virtual machine acts on, and its parameters."""

    name: str
    stage: StageName
    part: PartName
    bounds: Mapping[str, tuple[float, float]]
    """Lowest and highest value of each parameter, in its unit."""
    joints: tuple[str, ...] = ()
    """Joints that it may act on; empty for a fault of the whole machine."""
    strength: str | None = None
    """The parameter that grows with the strength, where the others say of what kind it is."""


def _of_table(spec: EffectSpec) -> FaultSpec:
    bounds = {
        p.name: (p.low if p.virtual_low is None else p.virtual_low, p.high) for p in spec.parameters
    }
    return FaultSpec(spec.name, spec.stage, spec.part, bounds, spec.joints)


_UNLISTED = (
    FaultSpec("turntable_torsion", "aim", "base", {"windup_rad": (0.0, 0.05)}),
    FaultSpec(
        "gain_oscillation",
        "actuation",
        "drive",
        {"amplitude_ratio": (0.0, 0.8), "frequency_hz": (0.8, 2.5)},
        ACTIVE_JOINTS,
        strength="amplitude_ratio",
    ),
    FaultSpec(
        "command_dropouts",
        "actuation",
        "drive",
        {"rate_per_s": (0.0, 4.0), "length_s": (0.06, 0.25)},
        strength="rate_per_s",
    ),
    FaultSpec(
        "fading_hysteresis",
        "actuation",
        "drive",
        {"half_width_ratio": (0.0, 0.5), "travel_rad_m": (0.15, 0.5)},
        ACTIVE_JOINTS,
        strength="half_width_ratio",
    ),
    FaultSpec("gust", "flight", "air", {"speed_m_per_s": (0.0, 20.0)}),
    FaultSpec(
        "uneven_claw",
        "release",
        "grasp",
        {"kick_x_m_per_s": (-1.5, 1.5), "kick_y_m_per_s": (-1.5, 1.5)},
    ),
    FaultSpec("valve_crosstalk", "actuation", "drive", {"leak_ratio": (-0.5, 0.5)}, ACTIVE_JOINTS),
    FaultSpec(
        "position_dependent_gain",
        "actuation",
        "drive",
        {"loss_ratio": (0.0, 0.9), "width_rad_m": (0.06, 0.15)},
        ("boom", "dipper"),
        strength="loss_ratio",
    ),
    FaultSpec("command_steps", "actuation", "drive", {"step_ratio": (0.0, 0.6)}, ACTIVE_JOINTS),
    FaultSpec(
        "encoder_scale", "aim", "joint_sensor", {"error_ratio": (-0.15, 0.15)}, LOADED_JOINTS
    ),
)
TABLE_FAULTS: Mapping[str, FaultSpec] = {
    spec.name: _of_table(spec) for spec in EFFECTS.values() if spec.name != DRIFT
}
"""The effects of the table, in its order."""
UNLISTED_FAULTS: Mapping[str, FaultSpec] = {spec.name: spec for spec in _UNLISTED}
"""The faults that the table does not have; the code of their part says what each does."""
FAULTS: Mapping[str, FaultSpec] = {**TABLE_FAULTS, **UNLISTED_FAULTS}
"""All that the virtual machine can have."""
