"""What an effect of a size does to the machine, in a sentence with unit and interval; and where to look."""

import math
from collections.abc import Mapping
from typing import Final, NamedTuple

from diagnosis.report.vocabulary import SENTENCES, sentence, size_words
from diagnosis.verdict import FittedEffect, FittedParameter
from sim_twin.effects.table import EFFECTS


class Does(NamedTuple):
    """What a parameter does: clauses with ``{joint}`` and ``{size}``."""

    more: str
    less: str = ""
    """For a negative size; the clause of a positive one with a sign where it is empty."""


_IN = "the {joint} moves {size} {how} than in the twin where its command is {sign}"
_BAND = "the {joint} needs {size} {how} of full command before it moves where its command is {sign}"
DOES: Final[Mapping[str, Mapping[str, Does]]] = {
    "valve_dead_time": {
        "extra_dead_time_s": Does(
            "the {joint} starts {size} later than in the twin",
            "the {joint} starts {size} earlier than in the twin",
        )
    },
    "valve_lag": {
        "extra_lag_s": Does(
            "the {joint} takes {size} longer to come up to speed than in the twin",
            "the {joint} takes {size} less to come up to speed than in the twin",
        )
    },
    "valve_dead_band": {
        "positive_ratio": Does(
            _BAND.format(joint="{joint}", size="{size}", how="more", sign="positive")
        ),
        "negative_ratio": Does(
            _BAND.format(joint="{joint}", size="{size}", how="more", sign="negative")
        ),
    },
    "valve_gain": {
        "positive_ratio": Does(
            _IN.format(joint="{joint}", size="{size}", how="faster", sign="positive"),
            _IN.format(joint="{joint}", size="{size}", how="slower", sign="positive"),
        ),
        "negative_ratio": Does(
            _IN.format(joint="{joint}", size="{size}", how="faster", sign="negative"),
            _IN.format(joint="{joint}", size="{size}", how="slower", sign="negative"),
        ),
    },
    "valve_hysteresis": {
        "half_width_ratio": Does(
            "the spool of the {joint} follows {size} of full command late at each reversal"
        )
    },
    "speed_limit": {
        "reduction_ratio": Does("the {joint} reaches {size} less than its rated speed")
    },
    "load_dependent_speed": {
        "loss_ratio": Does(
            "the {joint} loses {size} of its speed under the largest load",
            "the {joint} gains {size} of its speed under the largest load",
        )
    },
    "backlash": {"gap_rad_m": Does("the {joint} has {size} of play at each reversal")},
    "stiction": {
        "breakaway_rad_m_per_s": Does("the {joint} sticks until its command asks for {size}")
    },
    "pump_flow_sharing": {"shortage_ratio": Does("the pump gives {size} less flow")},
    "passive_viscous_friction": {
        "extra_viscous_per_s": Does(
            "the gripper's swing is damped by {size} more",
            "the gripper's swing is damped by {size} less",
        )
    },
    "passive_coulomb_friction": {
        "extra_coulomb_rad_per_s2": Does(
            "the gripper's joints have {size} more dry friction",
            "the gripper's joints have {size} less dry friction",
        )
    },
    "gripper_length": {
        "extra_length_m": Does("the gripper hangs {size} lower", "the gripper hangs {size} higher")
    },
    "gripper_inertia": {
        "extra_inertia_ratio": Does(
            "the gripper's inertia is {size} larger", "the gripper's inertia is {size} smaller"
        )
    },
    "hose_stiffness": {"stiffness_per_s2": Does("the hoses pull the gripper back by {size}")},
    "payload_mass": {
        "extra_mass_kg": Does("the load is {size} heavier", "the load is {size} lighter")
    },
    "payload_offset": {
        "offset_x_m": Does(
            "the load is held {size} towards +x of the gripper",
            "the load is held {size} towards −x of the gripper",
        ),
        "offset_y_m": Does(
            "the load is held {size} towards +y of the gripper",
            "the load is held {size} towards −y of the gripper",
        ),
    },
    "release_delay": {
        "extra_delay_s": Does(
            "the gripper lets go {size} later", "the gripper lets go {size} earlier"
        )
    },
    "release_jitter": {"extra_sd_s": Does("the moment of letting go scatters by {size} more")},
    "sticky_release": {
        "slowdown_ratio": Does("the load leaves {size} slower than the grip point moves")
    },
    "air_drag": {
        "extra_drag_coefficient_ratio": Does(
            "the load's drag is {size} larger", "the load's drag is {size} smaller"
        )
    },
    "wind": {
        "x_m_per_s": Does(
            "wind blows with {size} towards the machine's front",
            "wind blows with {size} towards the machine's rear",
        ),
        "y_m_per_s": Does(
            "wind blows with {size} to the machine's left",
            "wind blows with {size} to the machine's right",
        ),
    },
    "release_spin": {
        "spin_rad_per_s": Does(
            "the load leaves with {size} of backspin", "the load leaves with {size} of topspin"
        )
    },
    "joint_sensor_bias": {
        "bias_rad_m": Does(
            "the sensor of the {joint} reads {size} too much",
            "the sensor of the {joint} reads {size} too little",
        )
    },
    "joint_sensor_latency": {
        "extra_latency_s": Does("the sensor of the {joint} reports {size} late")
    },
    "imu_latency": {"extra_latency_s": Does("the IMU reports {size} late")},
    "imu_misalignment": {
        "roll_rad": Does("the IMU is mounted {size} off in roll"),
        "pitch_rad": Does("the IMU is mounted {size} off in pitch"),
        "yaw_rad": Does("the IMU is mounted {size} off in yaw"),
    },
    "base_tilt": {
        "roll_rad": Does("the machine is rolled by {size}"),
        "pitch_rad": Does(
            "the machine is pitched by {size}, front down",
            "the machine is pitched by {size}, front up",
        ),
    },
    "base_yaw_drift": {"yaw_rad": Does("the machine has turned by {size} on the ground")},
    "base_height": {
        "extra_height_m": Does(
            "the machine stands {size} higher", "the machine stands {size} lower"
        )
    },
    "chassis_compliance": {
        "pitch_rad": Does("the machine leans by {size} towards the outstretched arm")
    },
}
"""Effect -> parameter -> what it does."""

_PILOT = "the pilot valve and the pilot pressure of the {joint}"
INSPECT: Final[Mapping[str, str]] = {
    "valve_dead_time": _PILOT,
    "valve_lag": f"{_PILOT}, and the oil's temperature",
    "valve_dead_band": "the spool of the {joint}, and its valve table",
    "valve_gain": "the spool of the {joint}, supply and oil temperature",
    "valve_hysteresis": "the spool of the {joint} for play and dirt",
    "speed_limit": "the flow to the {joint}",
    "load_dependent_speed": "the pressure at the {joint} under load",
    "backlash": "pins and bushings of the {joint}",
    "stiction": "seals and grease of the {joint}",
    "pump_flow_sharing": "the pump's flow and the engine's speed",
    "passive_viscous_friction": "the gripper's suspension and its brakes",
    "passive_coulomb_friction": "the gripper's suspension: grease, pins",
    "gripper_length": "which gripper hangs on the machine, and at which pin",
    "gripper_inertia": "which gripper hangs on the machine, and what is fixed to it",
    "hose_stiffness": "the hoses at the gripper",
    "payload_mass": "the mass of the load",
    "payload_offset": "how the gripper holds the load",
    "release_delay": "the gripper's valve and its switch",
    "release_jitter": "the gripper's valve and pressure",
    "sticky_release": "the claws, and what sticks to them",
    "air_drag": "size and surface of the load",
    "wind": "the wind of that time",
    "release_spin": "how the claws let go of the load",
    "joint_sensor_bias": "the zero of the sensor of the {joint}",
    "joint_sensor_latency": "the time stamps of the sensor of the {joint}",
    "imu_latency": "the IMU's time stamps",
    "imu_misalignment": "how the IMU is mounted",
    "base_tilt": "the ground under the machine",
    "base_yaw_drift": "whether the machine was moved since the survey",
    "base_height": "the surveyed height of the machine",
    "chassis_compliance": "the ground under the machine, tracks and stabilisers",
}
"""Effect -> where a person looks."""
BOUND_RATIO: Final = 1e-3
"""Distance to a bound, as a share of the range, at which a size counts as there."""


def effect_sentence(effect: FittedEffect) -> str:
    """What an effect does, with sizes and intervals; what is at a bound of the search is said."""
    return ", and ".join(_clause(effect, name, p) for name, p in effect.parameters.items())


def _clause(effect: FittedEffect, name: str, parameter: FittedParameter) -> str:
    kind, _, drifting = name.rpartition(".")
    does = DOES.get(kind or effect.effect, {}).get(drifting)
    if does is None:
        does = Does(f"{name} is {{size}}")
    shown = _reversed(parameter) if parameter.value < 0.0 and does.less else parameter
    ((_, value, interval),) = size_words(effect.model_copy(update={"parameters": {name: shown}}))
    words = does.more if shown is parameter else does.less
    clause = words.format(joint=effect.joint, size=value)
    if kind:
        clause = sentence("drifts", clause=clause)
    interval = sentence("interval_is", interval=interval)
    at_end = f", {SENTENCES['at_bound']}" if is_at_bound(effect, name, parameter) else ""
    return f"{clause} ({interval}{at_end})"


def _reversed(parameter: FittedParameter) -> FittedParameter:
    """A size in the opposite direction: "20 % slower", not "-20 % faster"."""
    low, high = parameter.ci90
    return parameter.model_copy(update={"value": -parameter.value, "ci90": (-high, -low)})


def is_at_bound(effect: FittedEffect, name: str, parameter: FittedParameter) -> bool:
    """Whether a size lies at an end of the range that is searched, and the true one may lie beyond."""
    spec = EFFECTS.get(effect.effect)
    known = None if spec is None else next((p for p in spec.parameters if p.name == name), None)
    if known is None or not math.isfinite(parameter.value) or parameter.value == 0.0:
        return False
    margin = BOUND_RATIO * (known.high - known.low)
    return parameter.value >= known.high - margin or parameter.value <= known.low + margin


def inspection(effect: FittedEffect) -> str:
    """Where a person looks for an effect."""
    name = next(iter(effect.parameters), "")
    kind = name.rpartition(".")[0] or effect.effect
    return INSPECT.get(kind, kind.replace("_", " ")).format(joint=effect.joint)
