"""Columns of the table of effects (table.py): what is known of an effect and of its parameters."""

from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

StageName = Literal["actuation", "swing", "release", "flight", "aim"]
PartName = Literal["drive", "free_joint", "tool", "grasp", "air", "joint_sensor", "imu", "base"]
"""What an effect acts on: valve and actuator, friction and hoses of the two free joints, rigid bodies in the
gripper, how the load is held and let go, its flight, a sensor, or the ground under the machine."""
ReplayName = Literal["actuation", "swing", "flight"]
"""Replays of a recorded throw: with nothing taken as measured; with measured driven joints; with measured
driven joints, free joints and moment of opening."""
Growth = Literal["linear", "curved", "threshold", "jumps", "delay", "frequency"]
"""How what an effect changes grows with its size.

linear: in proportion.
curved: smoothly, not in proportion.
threshold: a command or flow below it does nothing.
jumps: joints stand, valves hang in their play or speeds are cut for a time that grows in jumps.
delay: a shift in time; a large one is no multiple of a small one's sensitivity.
frequency: by a natural frequency.
"""
DRIFT: Final = "warm_up_drift"
"""Its one parameter ``<effect>.<parameter>`` is the change from the first to the last throw of a set."""


class ParameterSpec(NamedTuple):
    """One number of an effect; unit as its name ends (``_rad_m``: metres for the telescope)."""

    name: str
    low: float
    high: float
    tolerance: float
    """Standard deviation among healthy machines: less than this is no cause."""
    prior_sd: float
    """Standard deviation of the effect where it is a cause."""
    step: float
    """Finite difference for sensitivities. Effects with a threshold have a large one: a secant."""
    virtual_low: float | None = None
    """Lower bound on the virtual machine, where its nominal dead time or lag ends the range before `low`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EffectSpec:
    """One effect: a row of the table."""

    name: str
    stage: StageName
    part: PartName
    joints: tuple[str, ...] = ()
    """Joints that it may act on; empty for an effect of the whole machine."""
    parameters: tuple[ParameterSpec, ...]
    replays: tuple[ReplayName, ...]
    """Replays in which it shows. Release times are compared with the switch, without a replay."""
    physics: str
    source: str

    growth: Growth = "linear"
    can_drift: bool = False
    """Whether it warms up, wears in, blows or creeps within an hour; lengths, masses and clocks do not."""
    is_random: bool = False
    """Whether it moves the spread of throws and not their mean."""
    has_memory: bool = False
    """Whether its state at the opening follows from the whole throw even where all joints are measured."""
    stops_joint: bool = False
    """Whether its joint stands while the valve is open, and breaks loose by forces the twin does not have."""
    shapes_speed: bool = False
    """Whether it changes how the steady speed grows with the command."""
    varies_widely: bool = False
    """Whether healthy machines differ in it by more than sensitivities at the twin profile hold for."""
    keeps_slopes: bool = False
    """Whether its sensitivities in the swing and flight replays stay those of no effect under every
    hypothesis: healthy throws measure the machine's own values along those sensitivities."""
    least_beside_ratio: float = 0.0
    """Least size that counts beside another effect, as a share of `prior_sd`: less is its form error."""
    least_shortening_ratio: float = 0.0
    """Least negative size that counts, as a share of the joint's mean lag 2 z / w."""
    is_of_load: bool = False
    """Whether it belongs to the load or the air, and not to the machine."""
    unit_field: str | None = None
    """Field of a virtual machine's unit (sim_twin.virtual.units) that the same effect changes."""
    hides_drift: bool = False
    """Whether a blind challenge may hide a drift of it."""

    @property
    def is_smooth(self) -> bool:
        """Whether it has a sensitivity at size 0."""
        return self.growth != "jumps"

    def parameter(self, name: str) -> ParameterSpec:
        """The specification of a parameter.

        Raises:
            KeyError: the effect has no such parameter.
        """
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        known = ", ".join(p.name for p in self.parameters)
        raise KeyError(f"effect '{self.name}' has no parameter '{name}'; it has {known}")


_UNITS: Final = (
    ("_rad_m_per_s", "rad/s"),
    ("_rad_per_s2", "rad/s2"),
    ("_rad_per_s", "rad/s"),
    ("_m_per_s", "m/s"),
    ("_per_s2", "1/s2"),
    ("_per_s", "1/s"),
    ("_rad_m", "rad"),
    ("_rad", "rad"),
    ("_kg", "kg"),
    ("_m", "m"),
    ("_s", "s"),
)


def parameter_unit(name: str, joint: str | None = None) -> str:
    """Unit of a parameter, from its name; that of the telescope is linear. Ratios have none: ``1``.

    Raises:
        KeyError: no unit is known for the end of the name.
    """
    if name.endswith("_ratio"):
        return "1"
    for suffix, unit in _UNITS:
        if name.endswith(suffix):
            linear = joint == "telescope" and "_rad_m" in suffix
            return unit.replace("rad", "m") if linear else unit
    raise KeyError(f"the name '{name}' ends with no known unit")
