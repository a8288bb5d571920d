"""The table of all effects that the twin can be given: stage, joints, parameters, physics, source.

Each effect is a deviation from the machine's present twin profile, and its value 0 is no effect at all.
This table only describes; what an effect does stands in valve.py, body.py, load.py and sensor.py
beside it.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal, NamedTuple

from machine.conventions import ACTIVE_JOINTS

StageName = Literal["actuation", "swing", "release", "flight", "aim"]
DRIFT = "warm_up_drift"


class ParameterSpec(NamedTuple):
    """One number of an effect; unit as its name ends (``_rad_m``: metres for the telescope)."""

    name: str
    low: float
    high: float
    tolerance: float
    """Standard deviation that a machine's own scatter explains: less than this is no cause."""
    prior_sd: float
    """Standard deviation of the effect where it is a cause."""
    step: float
    """Finite difference for sensitivities. Effects with a threshold have a large one: a secant."""


class EffectSpec(NamedTuple):
    """One effect of the library."""

    effect: str
    stage: StageName
    joints: tuple[str, ...]
    """Joints that it may act on; empty for an effect of the whole machine."""
    parameters: tuple[ParameterSpec, ...]
    physics: str
    source: str

    def parameter(self, name: str) -> ParameterSpec:
        """The specification of a parameter.

        Raises:
            KeyError: the effect has no such parameter.
        """
        return next((p for p in self.parameters if p.name == name), None) or _missing(self, name)


def _missing(spec: EffectSpec, name: str) -> ParameterSpec:
    known = ", ".join(p.name for p in spec.parameters)
    raise KeyError(f"effect '{spec.effect}' has no parameter '{name}'; it has {known}")


P = ParameterSpec
_ACTUATION = (
    EffectSpec(
        "valve_dead_time",
        "actuation",
        ACTIVE_JOINTS,
        (P("extra_dead_time_s", -0.1, 0.3, 0.004, 0.08, 0.01),),
        "Pure delay between valve command and spool: transport, pilot pressure, bus cycles.",
        "phase without amplitude in the step response; stock pilot valves 0.20-0.40 s (docs/machine.md, M)",
    ),
    EffectSpec(
        "valve_lag",
        "actuation",
        ACTIVE_JOINTS,
        (P("extra_lag_s", -0.2, 0.6, 0.006, 0.15, 0.02),),
        "First-order lag of the spool, between its play and its overlap; below 0 the response's own "
        "mean lag 2 z / w gets shorter.",
        "second-order valve and load; 0.05-0.25 s measured on stock valves (docs/machine.md, M)",
    ),
    EffectSpec(
        "valve_dead_band",
        "actuation",
        ACTIVE_JOINTS,
        (
            P("positive_ratio", 0.0, 0.4, 0.005, 0.12, 0.02),
            P("negative_ratio", 0.0, 0.4, 0.005, 0.12, 0.02),
        ),
        "Command lost around zero, beyond the calibration: u -> sign(u) max(|u| - band, 0).",
        "spool overlap; 20-40 % raw, 0-10 % after compensation (docs/machine.md, M and A)",
    ),
    EffectSpec(
        "valve_gain",
        "actuation",
        ACTIVE_JOINTS,
        (
            P("positive_ratio", -0.5, 0.5, 0.012, 0.15, 0.03),
            P("negative_ratio", -0.5, 0.5, 0.012, 0.15, 0.03),
        ),
        "Steady speed times 1 + ratio in that direction: spool wear, oil temperature, supply.",
        "orifice flow Q = Cd A sqrt(2 dp / rho)",
    ),
    EffectSpec(
        "valve_hysteresis",
        "actuation",
        ACTIVE_JOINTS,
        (P("half_width_ratio", 0.0, 0.2, 0.004, 0.06, 0.02),),
        "Play between command and spool: the spool follows once the command has moved by the half "
        "width, and stays on reversal.",
        "spool friction and solenoid remanence; play operator (Krasnosel'skii and Pokrovskii)",
    ),
    EffectSpec(
        "speed_limit",
        "actuation",
        ACTIVE_JOINTS,
        (P("reduction_ratio", 0.0, 0.7, 0.02, 0.25, 0.1),),
        "Speed capped at (1 - r) of the rated joint speed (a twin beyond the rating: of its own).",
        "rated joint speeds of spec.json",
    ),
    EffectSpec(
        "load_dependent_speed",
        "actuation",
        ACTIVE_JOINTS,
        (P("loss_ratio", -0.6, 0.6, 0.02, 0.2, 0.05),),
        "Speed times 1 - k L sign(v), L the gravity moment of the joint over its largest in the "
        "envelope, positive against positive motion; 0 for the slew.",
        "no load compensation: flow falls with the square root of the pressure left for the valve",
    ),
    EffectSpec(
        "backlash",
        "actuation",
        ACTIVE_JOINTS,
        (P("gap_rad_m", 0.0, 0.06, 0.001, 0.02, 0.005),),
        "Lost motion between drive and joint at each reversal: the drive alone crosses it at its "
        "steady speed, the joint stays where it came to rest and moves off from rest. At first the "
        "drive touches the side that carries the load (slew: neither).",
        "play operator; pin and slew-gear clearance (MuJoCo issue 995)",
    ),
    EffectSpec(
        "stiction",
        "actuation",
        ACTIVE_JOINTS,
        (P("breakaway_rad_m_per_s", 0.0, 0.15, 0.003, 0.05, 0.02),),
        "A joint at rest stays until the steady speed of its command exceeds this; valve "
        "and oil go on meanwhile, and it comes up with them within some 0.02 s.",
        "static friction of seals: stationary phase and slip jump (valve-stiction literature)",
    ),
    EffectSpec(
        "pump_flow_sharing",
        "actuation",
        (),
        (P("shortage_ratio", 0.0, 0.6, 0.02, 0.2, 0.1),),
        "The pump gives (1 - x) of its nominal flow; when all joints ask for more, all are scaled "
        "alike, by what the shortage takes away beyond a healthy pump.",
        "volume balance; 220 l/min, 15-25 % loss of early speed with two axes (docs/machine.md, M)",
    ),
)
_SWING = (
    EffectSpec(
        "passive_viscous_friction",
        "swing",
        (),
        (P("extra_viscous_per_s", -0.03, 0.6, 0.005, 0.15, 0.03),),
        "Added to the viscous friction of both free joints, as deceleration per rate.",
        "throwing paper, eq. 3",
    ),
    EffectSpec(
        "passive_coulomb_friction",
        "swing",
        (),
        (P("extra_coulomb_rad_per_s2", -0.1, 0.6, 0.015, 0.15, 0.04),),
        "Added to the dry friction of both free joints, as deceleration.",
        "throwing paper, eq. 3",
    ),
    EffectSpec(
        "gripper_length",
        "swing",
        (),
        (P("extra_length_m", -0.3, 0.3, 0.006, 0.1, 0.02),),
        "Centre of mass and grip centre lower by it, from the roll axis.",
        "physical pendulum; 0.75 / 1.15 m +-0.15 (docs/machine.md, A)",
    ),
    EffectSpec(
        "gripper_inertia",
        "swing",
        (),
        (P("extra_inertia_ratio", -0.5, 0.8, 0.02, 0.25, 0.1),),
        "Moments of inertia of the gripper about its centre of mass times 1 + ratio.",
        "physical pendulum; 50 kg m2 +-30 % (docs/machine.md, A)",
    ),
    EffectSpec(
        "hose_stiffness",
        "swing",
        (),
        (P("stiffness_per_s2", 0.0, 3.0, 0.03, 0.8, 0.1),),
        "Hydraulic hoses pull both free joints back to their angle at the throw's start: angular "
        "acceleration per radian.",
        "linear spring",
    ),
    EffectSpec(
        "payload_mass",
        "swing",
        (),
        (P("extra_mass_kg", -0.5, 5.0, 0.02, 1.6, 0.05),),
        "Mass of the load in the gripper, and drag over mass in the air.",
        "ball_mass_kg of spec.json (FIBA size 7: 0.567-0.650 kg)",
    ),
    EffectSpec(
        "payload_offset",
        "swing",
        (),
        (
            P("offset_x_m", -0.3, 0.3, 0.004, 0.1, 0.02),
            P("offset_y_m", -0.3, 0.3, 0.004, 0.1, 0.02),
        ),
        "Centre of the load beside the grip centre, in the gripper's frame.",
        "rigid-body velocity v + w x r",
    ),
)
_RELEASE = (
    EffectSpec(
        "release_delay",
        "release",
        (),
        (P("extra_delay_s", -0.2, 0.3, 0.004, 0.08, 0.01),),
        "Added to the time between opening command and free load.",
        "throwing paper, section III-F: 0.258 s",
    ),
    EffectSpec(
        "release_jitter",
        "release",
        (),
        (P("extra_sd_s", 0.0, 0.1, 0.003, 0.03, 0.01),),
        "Standard deviation of that time, added in squares: moves the spread, not the mean.",
        "throwing paper, section III-F: 0.015 s",
    ),
    EffectSpec(
        "sticky_release",
        "release",
        (),
        (P("slowdown_ratio", 0.0, 0.4, 0.005, 0.12, 0.02),),
        "The load leaves with (1 - s) of the grip point's velocity: claws drag on it.",
        "impulse of the claws along the way out",
    ),
)
_FLIGHT = (
    EffectSpec(
        "air_drag",
        "flight",
        (),
        (P("extra_drag_coefficient_ratio", -0.5, 2.0, 0.015, 0.65, 0.05),),
        "Added to the drag coefficient.",
        "quadratic drag; Cd 0.47-0.54 of a basketball (docs/machine.md, S)",
    ),
    EffectSpec(
        "wind",
        "flight",
        (),
        (P("x_m_per_s", -10.0, 10.0, 0.1, 3.0, 0.5), P("y_m_per_s", -10.0, 10.0, 0.1, 3.0, 0.5)),
        "Steady horizontal wind, frame `machine`; drag acts on the velocity through the air.",
        "quadratic drag",
    ),
    EffectSpec(
        "release_spin",
        "flight",
        (),
        (P("spin_rad_per_s", -30.0, 30.0, 0.3, 10.0, 2.0),),
        "Backspin (positive) about the horizontal axis across the release velocity; Magnus lift: "
        "C_L = S / (0.4 + 2.32 S), S = r w / v at the speed v through the air.",
        "A. M. Nathan, The effect of spin on the flight of a baseball, Am. J. Phys. 76 (2008)",
    ),
)
_AIM = (
    EffectSpec(
        "joint_sensor_bias",
        "aim",
        ACTIVE_JOINTS,
        (P("bias_rad_m", -0.08, 0.08, 0.001, 0.03, 0.005),),
        "The joint's sensor reports true + bias.",
        "zero setting of encoder or cylinder sensor",
    ),
    EffectSpec(
        "joint_sensor_latency",
        "aim",
        ACTIVE_JOINTS,
        (P("extra_latency_s", 0.0, 0.15, 0.001, 0.04, 0.001),),
        "The joint's sensor reports position and speed of this long ago.",
        "bus cycle and filter of the sensor",
    ),
    EffectSpec(
        "imu_latency",
        "aim",
        (),
        (P("extra_latency_s", 0.0, 0.15, 0.001, 0.04, 0.001),),
        "The IMU's values are this much older than their time stamp says.",
        "radio link and filter of the IMU",
    ),
    EffectSpec(
        "imu_misalignment",
        "aim",
        (),
        (
            P("roll_rad", -0.2, 0.2, 0.003, 0.06, 0.01),
            P("pitch_rad", -0.2, 0.2, 0.003, 0.06, 0.01),
            P("yaw_rad", -0.2, 0.2, 0.003, 0.06, 0.01),
        ),
        "The IMU is mounted turned by Rz(yaw) Ry(pitch) Rx(roll) against the gripper's axes.",
        "mounting tolerance",
    ),
    EffectSpec(
        "base_tilt",
        "aim",
        (),
        (
            P("roll_rad", -0.1, 0.1, 0.002, 0.03, 0.005),
            P("pitch_rad", -0.1, 0.1, 0.002, 0.03, 0.005),
        ),
        "The machine is tilted about its chassis, Ry(pitch) Rx(roll) against level ground (positive "
        "pitch: front down): gravity in frame `machine` leans, and the throw with it.",
        "rigid-body pose",
    ),
    EffectSpec(
        "base_yaw_drift",
        "aim",
        (),
        (P("yaw_rad", -0.15, 0.15, 0.002, 0.05, 0.01),),
        "The machine has turned about the slew axis against the surveyed ground.",
        "wheels and legs creep on soft ground",
    ),
    EffectSpec(
        "base_height",
        "aim",
        (),
        (P("extra_height_m", -0.5, 0.5, 0.01, 0.15, 0.02),),
        "The machine stands higher above the surveyed ground.",
        "base 0.85 m, 0.7-1.1 as the legs move (docs/machine.md, A)",
    ),
    EffectSpec(
        "chassis_compliance",
        "aim",
        (),
        (P("pitch_rad", 0.0, 0.06, 0.001, 0.006, 0.002),),
        "The machine leans towards the arm by this at the arm's largest gravity moment about the slew "
        "axis, and sways on springs (30 % of critical damping) under the arm's weight and inertia.",
        "stiffness of tyres, legs and ground",
    ),
)


def _drift_spec(specs: tuple[EffectSpec, ...]) -> EffectSpec:
    """Drift of any parameter of `specs`: as far as the range allows, half as large as a constant one."""
    parameters = tuple(
        P(
            f"{spec.effect}.{p.name}",
            -(p.high - p.low),
            p.high - p.low,
            p.tolerance,
            0.5 * p.prior_sd,
            p.step,
        )
        for spec in specs
        for p in spec.parameters
    )
    return EffectSpec(
        DRIFT,
        "actuation",
        ACTIVE_JOINTS,
        parameters,
        "Change of another effect's parameter from the first to the last throw of a set, linear in "
        "the throw's number; joint and stage are that effect's.",
        "oil warms up over half an hour; battery, wind and ground change as slowly",
    )


_ALL = (*_ACTUATION, *_SWING, *_RELEASE, *_FLIGHT, *_AIM)
EFFECTS: Mapping[str, EffectSpec] = MappingProxyType(
    {spec.effect: spec for spec in (*_ALL, _drift_spec(_ALL))}
)
"""The library, in the order of the chain."""
