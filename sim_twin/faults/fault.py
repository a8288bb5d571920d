"""Effects that a virtual machine can have beyond its unit: what a diagnosis is asked to find.

They act on pressures, spools, sensors, body and load of the virtual machine. Nothing here is shared with the
effects of the twin; only names and units are the same, because both name the same physics.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from machine.conventions import ACTIVE_COUNT, ACTIVE_JOINTS, Array
from machine.errors import PlantError

JOINT_EFFECTS: Mapping[str, tuple[str, ...]] = {
    "valve_dead_time": ("extra_dead_time_s",),
    "valve_lag": ("extra_lag_s",),
    "valve_dead_band": ("positive_ratio", "negative_ratio"),
    "valve_gain": ("positive_ratio", "negative_ratio"),
    "valve_hysteresis": ("half_width_ratio",),
    "speed_limit": ("reduction_ratio",),
    "load_dependent_speed": ("loss_ratio",),
    "backlash": ("gap_rad_m",),
    "stiction": ("breakaway_rad_m_per_s",),
    "joint_sensor_bias": ("bias_rad_m",),
    "joint_sensor_latency": ("extra_latency_s",),
}
"""Effects of one joint and their parameters."""
MACHINE_EFFECTS: Mapping[str, tuple[str, ...]] = {
    "pump_flow_sharing": ("shortage_ratio",),
    "passive_viscous_friction": ("extra_viscous_per_s",),
    "passive_coulomb_friction": ("extra_coulomb_rad_per_s2",),
    "gripper_length": ("extra_length_m",),
    "gripper_inertia": ("extra_inertia_ratio",),
    "hose_stiffness": ("stiffness_per_s2",),
    "payload_mass": ("extra_mass_kg",),
    "payload_offset": ("offset_x_m", "offset_y_m"),
    "release_delay": ("extra_delay_s",),
    "release_jitter": ("extra_sd_s",),
    "sticky_release": ("slowdown_ratio",),
    "air_drag": ("extra_drag_coefficient_ratio",),
    "wind": ("x_m_per_s", "y_m_per_s"),
    "release_spin": ("spin_rad_per_s",),
    "imu_latency": ("extra_latency_s",),
    "imu_misalignment": ("roll_rad", "pitch_rad", "yaw_rad"),
    "base_tilt": ("roll_rad", "pitch_rad"),
    "base_yaw_drift": ("yaw_rad",),
    "base_height": ("extra_height_m",),
    "chassis_compliance": ("pitch_rad",),
}
"""Effects of the whole machine."""
UNHEARD_OF: Mapping[str, tuple[str, ...]] = {
    "turntable_torsion": ("windup_rad",),
    "gain_oscillation": ("amplitude_ratio", "frequency_hz"),
    "command_dropouts": ("rate_per_s", "length_s"),
    "fading_hysteresis": ("half_width_ratio", "travel_rad_m"),
    "gust": ("speed_m_per_s",),
    "uneven_claw": ("kick_x_m_per_s", "kick_y_m_per_s"),
    "valve_crosstalk": ("leak_ratio",),
    "position_dependent_gain": ("loss_ratio", "width_rad_m"),
    "command_steps": ("step_ratio",),
    "encoder_scale": ("error_ratio",),
}
"""Effects that no library of the twin has; the names say what happens, docstrings of the code how."""
UNHEARD_OF_OF_A_JOINT = frozenset(
    {
        "gain_oscillation",
        "fading_hysteresis",
        "valve_crosstalk",
        "position_dependent_gain",
        "command_steps",
        "encoder_scale",
    }
)
DRIFT = "warm_up_drift"
"""Its one parameter is named ``<effect>.<parameter>``: the change from the first to the last throw."""
PARAMETERS: Mapping[str, tuple[str, ...]] = {**JOINT_EFFECTS, **MACHINE_EFFECTS, **UNHEARD_OF}


class PlantEffect(NamedTuple):
    """One effect at its size."""

    effect: str
    joint: str | None
    parameters: Mapping[str, float]


class EffectSizes:
    """Sizes of all parameters on each of N machines: constant, plus drift times the place in the set."""

    def __init__(self, effects: Sequence[PlantEffect], place_ratio: Array) -> None:
        """Add up the effects.

        Args:
            effects: any number, of any kind.
            place_ratio: (N,) 0 at the first throw of a set, 1 at the last.

        Raises:
            PlantError: an effect, a joint or a parameter that does not exist.
        """
        self.count = place_ratio.size
        self._sizes: dict[tuple[str, int, str], Array] = {}
        for item in effects:
            _check(item)
            for name, value in item.parameters.items():
                if item.effect == DRIFT:
                    effect, _, parameter = name.partition(".")
                    size = value * place_ratio
                else:
                    effect, parameter = item.effect, name
                    size = np.full(self.count, value)
                key = effect, _joint_index(effect, item.joint), parameter
                if parameter not in PARAMETERS[effect]:
                    raise PlantError(
                        f"effect {effect} has no parameter {parameter}; it has {PARAMETERS[effect]}"
                    )
                self._sizes[key] = self._sizes.get(key, np.zeros(self.count)) + size

    def has(self, *effects: str) -> bool:
        """Whether any of these effects is there."""
        return any(key[0] in effects for key in self._sizes)

    def joints(self, effect: str, parameter: str) -> Array:
        """Sizes (N, 4) of an effect of the joints, 0 where it is not."""
        sizes = np.zeros((self.count, ACTIVE_COUNT))
        for joint in range(ACTIVE_COUNT):
            size = self._sizes.get((effect, joint, parameter))
            if size is not None:
                sizes[:, joint] = size
        return sizes

    def machine(self, effect: str, parameter: str) -> Array:
        """Sizes (N,) of an effect of the whole machine."""
        return self._sizes.get((effect, -1, parameter), np.zeros(self.count))

    def built_in(self, effect: str, parameter: str) -> float:
        """Size of an effect that is part of the machine's body and cannot drift.

        Raises:
            PlantError: it drifts.
        """
        size = self.machine(effect, parameter)
        if np.ptp(size) > 0.0:
            raise PlantError(f"{effect} is part of the machine's body: it cannot drift in a set")
        return float(size[0])


def _check(item: PlantEffect) -> None:
    if item.effect not in (DRIFT, *PARAMETERS):
        raise PlantError(
            f"the virtual machine has no effect '{item.effect}'; it has {[DRIFT, *PARAMETERS]}"
        )


def _joint_index(effect: str, joint: str | None) -> int:
    if effect not in PARAMETERS:
        raise PlantError(f"the virtual machine has no effect '{effect}'; it has {list(PARAMETERS)}")
    per_joint = effect in JOINT_EFFECTS or effect in UNHEARD_OF_OF_A_JOINT
    if per_joint != (joint is not None) or (joint is not None and joint not in ACTIVE_JOINTS):
        wanted = f"one of {ACTIVE_JOINTS}" if per_joint else "no joint"
        raise PlantError(f"effect {effect} needs {wanted}, not {joint}")
    return ACTIVE_JOINTS.index(joint) if joint is not None else -1
