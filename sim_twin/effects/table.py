"""The table of effects: everything that anyone needs to know of each, in one place.

An effect is a deviation of one machine from its twin profile; its value 0 is no effect.

To add an effect:

1. A row here. schema.py explains the columns, tests/sim_twin/effects/test_effects.py checks them.
2. Its physics in the twin: valve_effects.py, body_effects.py, load_effects.py or sensor_effects.py beside
   this file, or sim_twin/twin/base_pose.py; preview and diagnosis simulate with the twin. A test in
   tests/sim_twin/effects; test_effects_in_twin.py there fails for a row without physics.
3. Its physics in the virtual machine, independent of the twin's: sim_twin/faults. It reads the same row, so a
   fault of the virtual machine has the name, joints and parameters of the effect that it realises. A test in
   tests/sim_twin/faults; one there fails for a row without physics.
4. What it is easily taken for: rows in pairs.py.
5. Where a record of one stage shows it: an option in diagnosis/single_stage (joint_response.py,
   swing_problem.py or flight_problem.py), and what tells it from others (SEPARATING_RECORDS in
   the *_diagnosis.py beside them).
6. What it does and where to look for it, for people: diagnosis/report/effect_sentences.py; its test fails for
   a parameter without words.
7. The data that lists all parameters: ``python -m diagnosis.population.estimation FOLDER...`` writes
   diagnosis/healthy/noise.json and filters.json from healthy sets of many machines
   (``downrange challenge make --tiers null``), ``python -m challenge.limit_measurement`` writes
   challenge/detection_limits.json. Until then the diagnosis ends with the missing parameter's name.
8. Where benchmarks/plants or sim_twin/faults/fault_tables.py has it among the unknown or unlisted effects:
   move it to the known ones. No test notices 4, 5 and this.
9. ``make tables`` writes docs/effects.md. Special meanings, and the order of effects on a drive
   (docs/plants.md), are written by hand.

This module only describes: it imports no physics.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final

from machine.conventions import ACTIVE_JOINTS
from sim_twin.effects.schema import DRIFT, EffectSpec
from sim_twin.effects.schema import ParameterSpec as P

LOADED_JOINTS: Final = ("boom", "dipper", "telescope")
"""Driven joints that carry the arm's weight."""

_ACTUATION = (
    EffectSpec(
        name="valve_dead_time",
        stage="actuation",
        part="drive",
        joints=ACTIVE_JOINTS,
        parameters=(P("extra_dead_time_s", -0.1, 0.3, 0.004, 0.08, 0.01, virtual_low=-0.05),),
        replays=("actuation",),
        growth="delay",
        can_drift=True,
        varies_widely=True,
        least_shortening_ratio=0.12,
        unit_field="dead_time_s",
        hides_drift=True,
        physics="Pure delay between valve command and spool: transport, pilot pressure, bus cycles.",
        source="phase, not amplitude, of the step response; pilot valves 0.20-0.40 s (docs/machine.md, M)",
    ),
    EffectSpec(
        name="valve_lag",
        stage="actuation",
        part="drive",
        joints=ACTIVE_JOINTS,
        parameters=(P("extra_lag_s", -0.2, 0.6, 0.006, 0.15, 0.02, virtual_low=-0.04),),
        replays=("actuation",),
        growth="delay",
        can_drift=True,
        varies_widely=True,
        least_shortening_ratio=0.2,
        unit_field="spool_lag_s",
        hides_drift=True,
        physics="First-order lag of the spool, between its play and its overlap; below 0 the response's own "
        "mean lag 2 z / w gets shorter.",
        source="second-order valve and load; 0.05-0.25 s measured on stock valves (docs/machine.md, M)",
    ),
    EffectSpec(
        name="valve_dead_band",
        stage="actuation",
        part="drive",
        joints=ACTIVE_JOINTS,
        parameters=(
            P("positive_ratio", 0.0, 0.4, 0.005, 0.12, 0.02),
            P("negative_ratio", 0.0, 0.4, 0.005, 0.12, 0.02),
        ),
        replays=("actuation",),
        growth="threshold",
        can_drift=True,
        shapes_speed=True,
        hides_drift=True,
        physics="Command lost around zero, beyond the calibration: u -> sign(u) max(|u| - band, 0).",
        source="spool overlap; 20-40 % raw, 0-10 % after compensation (docs/machine.md, M and A)",
    ),
    EffectSpec(
        name="valve_gain",
        stage="actuation",
        part="drive",
        joints=ACTIVE_JOINTS,
        parameters=(
            P("positive_ratio", -0.5, 0.5, 0.012, 0.15, 0.03),
            P("negative_ratio", -0.5, 0.5, 0.012, 0.15, 0.03),
        ),
        replays=("actuation",),
        can_drift=True,
        shapes_speed=True,
        varies_widely=True,
        unit_field="valve_gain_positive_ratio",
        hides_drift=True,
        physics="Steady speed times 1 + ratio in that direction: spool wear, oil temperature, supply.",
        source="orifice flow Q = Cd A sqrt(2 dp / rho)",
    ),
    EffectSpec(
        name="valve_hysteresis",
        stage="actuation",
        part="drive",
        joints=ACTIVE_JOINTS,
        parameters=(P("half_width_ratio", 0.0, 0.2, 0.004, 0.06, 0.02),),
        replays=("actuation",),
        growth="jumps",
        least_beside_ratio=0.35,
        physics="Play between command and spool: the spool follows once the command has moved by the half "
        "width, and stays on reversal.",
        source="spool friction and solenoid remanence; play operator (Krasnosel'skii and Pokrovskii)",
    ),
    EffectSpec(
        name="speed_limit",
        stage="actuation",
        part="drive",
        joints=ACTIVE_JOINTS,
        parameters=(P("reduction_ratio", 0.0, 0.7, 0.02, 0.25, 0.1),),
        replays=("actuation",),
        growth="jumps",
        least_beside_ratio=1.3,
        physics="Speed capped at (1 - r) of the rated joint speed, or of the twin's where that is higher.",
        source="rated joint speeds of spec.json",
    ),
    EffectSpec(
        name="load_dependent_speed",
        stage="actuation",
        part="drive",
        joints=LOADED_JOINTS,
        parameters=(P("loss_ratio", -0.6, 0.6, 0.02, 0.2, 0.05),),
        replays=("actuation",),
        varies_widely=True,
        physics="Speed times 1 - k L sign(v), L the gravity moment of the joint over its largest in the "
        "envelope, positive against positive motion; 0 for the slew.",
        source="no load compensation: flow falls with the square root of the pressure left for the valve",
    ),
    EffectSpec(
        name="backlash",
        stage="actuation",
        part="drive",
        joints=ACTIVE_JOINTS,
        parameters=(P("gap_rad_m", 0.0, 0.06, 0.001, 0.02, 0.005),),
        replays=("actuation",),
        growth="jumps",
        stops_joint=True,
        least_beside_ratio=0.15,
        physics="Lost motion between drive and joint at each reversal: the drive alone crosses it at its "
        "steady speed, the joint stays where it came to rest and moves off from rest. At first the "
        "drive touches the side that carries the load (slew: neither).",
        source="play operator; pin and slew-gear clearance (MuJoCo issue 995)",
    ),
    EffectSpec(
        name="stiction",
        stage="actuation",
        part="drive",
        joints=ACTIVE_JOINTS,
        parameters=(P("breakaway_rad_m_per_s", 0.0, 0.15, 0.003, 0.05, 0.02),),
        replays=("actuation",),
        growth="jumps",
        stops_joint=True,
        least_beside_ratio=0.85,
        physics="A joint at rest stays until the steady speed of its command exceeds this; valve "
        "and oil go on meanwhile, and it comes up with them within some 0.02 s.",
        source="static friction of seals: stationary phase and slip jump (valve-stiction literature)",
    ),
    EffectSpec(
        name="pump_flow_sharing",
        stage="actuation",
        part="drive",
        parameters=(P("shortage_ratio", 0.0, 0.6, 0.02, 0.2, 0.1),),
        replays=("actuation",),
        growth="threshold",
        can_drift=True,
        unit_field="pump_flow_m3_per_s",
        hides_drift=True,
        physics="The pump gives (1 - x) of its nominal flow; when all joints ask for more, all are scaled "
        "alike, by what the shortage takes away beyond a healthy pump.",
        source="volume balance; 220 l/min, 15-25 % loss of early speed with two axes (docs/machine.md, M)",
    ),
)
_SWING = (
    EffectSpec(
        name="passive_viscous_friction",
        stage="swing",
        part="free_joint",
        parameters=(P("extra_viscous_per_s", -0.03, 0.6, 0.005, 0.15, 0.03),),
        replays=("swing",),
        can_drift=True,
        hides_drift=True,
        physics="Added to the viscous friction of both free joints, as deceleration per rate.",
        source="throwing paper, eq. 3",
    ),
    EffectSpec(
        name="passive_coulomb_friction",
        stage="swing",
        part="free_joint",
        parameters=(P("extra_coulomb_rad_per_s2", -0.1, 0.6, 0.015, 0.15, 0.04),),
        replays=("swing",),
        can_drift=True,
        physics="Added to the dry friction of both free joints, as deceleration.",
        source="throwing paper, eq. 3",
    ),
    EffectSpec(
        name="gripper_length",
        stage="swing",
        part="tool",
        parameters=(P("extra_length_m", -0.3, 0.3, 0.006, 0.1, 0.02),),
        replays=("swing", "flight"),
        unit_field="roll_to_grip_centre_m",
        physics="Centre of mass and grip centre lower by it, from the roll axis.",
        source="physical pendulum; 0.75 / 1.15 m +-0.15 (docs/machine.md, A)",
    ),
    EffectSpec(
        name="gripper_inertia",
        stage="swing",
        part="tool",
        parameters=(P("extra_inertia_ratio", -0.5, 0.8, 0.02, 0.25, 0.1),),
        replays=("swing",),
        unit_field="gripper_inertia_ratio",
        physics="Moments of inertia of the gripper about its centre of mass times 1 + ratio.",
        source="physical pendulum; 50 kg m2 +-30 % (docs/machine.md, A)",
    ),
    EffectSpec(
        name="hose_stiffness",
        stage="swing",
        part="free_joint",
        parameters=(P("stiffness_per_s2", 0.0, 3.0, 0.03, 0.8, 0.1),),
        replays=("swing",),
        physics="Hydraulic hoses pull both free joints back to their angle at the throw's start: angular "
        "acceleration per radian.",
        source="linear spring",
    ),
    EffectSpec(
        name="payload_mass",
        stage="swing",
        part="tool",
        parameters=(P("extra_mass_kg", -0.5, 5.0, 0.02, 1.6, 0.05),),
        replays=("swing", "flight"),
        is_of_load=True,
        growth="curved",
        unit_field="ball_mass_kg",
        physics="Mass of the load in the gripper, and drag over mass in the air.",
        source="ball_mass_kg of spec.json (FIBA size 7: 0.567-0.650 kg)",
    ),
    EffectSpec(
        name="payload_offset",
        stage="swing",
        part="grasp",
        parameters=(
            P("offset_x_m", -0.3, 0.3, 0.004, 0.1, 0.02),
            P("offset_y_m", -0.3, 0.3, 0.004, 0.1, 0.02),
        ),
        replays=("swing", "flight"),
        is_of_load=True,
        physics="Centre of the load beside the grip centre, in the gripper's frame.",
        source="rigid-body velocity v + w x r",
    ),
)
_RELEASE = (
    EffectSpec(
        name="release_delay",
        stage="release",
        part="grasp",
        parameters=(P("extra_delay_s", -0.2, 0.3, 0.004, 0.08, 0.01),),
        replays=(),
        can_drift=True,
        unit_field="release_delay_s",
        hides_drift=True,
        physics="Added to the time between opening command and free load.",
        source="throwing paper, section III-F: 0.258 s",
    ),
    EffectSpec(
        name="release_jitter",
        stage="release",
        part="grasp",
        parameters=(P("extra_sd_s", 0.0, 0.1, 0.003, 0.03, 0.01),),
        replays=(),
        is_random=True,
        physics="Standard deviation of that time, added in squares: moves the spread, not the mean.",
        source="throwing paper, section III-F: 0.015 s",
    ),
    EffectSpec(
        name="sticky_release",
        stage="release",
        part="grasp",
        parameters=(P("slowdown_ratio", 0.0, 0.4, 0.005, 0.12, 0.02),),
        replays=("flight",),
        can_drift=True,
        hides_drift=True,
        physics="The load leaves with (1 - s) of the grip point's velocity: claws drag on it.",
        source="impulse of the claws along the way out",
    ),
)
_FLIGHT = (
    EffectSpec(
        name="air_drag",
        stage="flight",
        part="air",
        parameters=(P("extra_drag_coefficient_ratio", -0.5, 2.0, 0.015, 0.65, 0.05),),
        replays=("flight",),
        is_of_load=True,
        unit_field="drag_coefficient_ratio",
        physics="Added to the drag coefficient.",
        source="quadratic drag; Cd 0.47-0.54 of a basketball (docs/machine.md, S)",
    ),
    EffectSpec(
        name="wind",
        stage="flight",
        part="air",
        parameters=(
            P("x_m_per_s", -10.0, 10.0, 0.1, 3.0, 0.5),
            P("y_m_per_s", -10.0, 10.0, 0.1, 3.0, 0.5),
        ),
        replays=("flight",),
        is_of_load=True,
        can_drift=True,
        physics="Steady horizontal wind, frame `machine`; drag acts on the velocity through the air.",
        source="quadratic drag",
    ),
    EffectSpec(
        name="release_spin",
        stage="flight",
        part="air",
        parameters=(P("spin_rad_per_s", -30.0, 30.0, 0.3, 10.0, 2.0),),
        replays=("flight",),
        is_of_load=True,
        growth="curved",
        physics=(
            "Backspin (positive) about the horizontal axis across the release velocity; Magnus lift: "
            "C_L = S / (0.4 + 2.32 S), S = r w / v at the speed v through the air."
        ),
        source="A. M. Nathan, The effect of spin on the flight of a baseball, Am. J. Phys. 76 (2008)",
    ),
)
_AIM = (
    EffectSpec(
        name="joint_sensor_bias",
        stage="aim",
        part="joint_sensor",
        joints=ACTIVE_JOINTS,
        parameters=(P("bias_rad_m", -0.08, 0.08, 0.001, 0.03, 0.005),),
        replays=("actuation", "swing", "flight"),
        can_drift=True,
        keeps_slopes=True,
        unit_field="joint_bias_rad_m",
        hides_drift=True,
        physics="The joint's sensor reports true + bias.",
        source="zero setting of encoder or cylinder sensor",
    ),
    EffectSpec(
        name="joint_sensor_latency",
        stage="aim",
        part="joint_sensor",
        joints=ACTIVE_JOINTS,
        parameters=(P("extra_latency_s", 0.0, 0.15, 0.001, 0.04, 0.001),),
        replays=("actuation", "swing", "flight"),
        growth="delay",
        physics="The joint's sensor reports position and speed of this long ago.",
        source="bus cycle and filter of the sensor",
    ),
    EffectSpec(
        name="imu_latency",
        stage="aim",
        part="imu",
        parameters=(P("extra_latency_s", 0.0, 0.15, 0.001, 0.04, 0.001),),
        replays=("swing", "flight"),
        growth="delay",
        physics="The IMU's values are this much older than their time stamp says.",
        source="radio link and filter of the IMU",
    ),
    EffectSpec(
        name="imu_misalignment",
        stage="aim",
        part="imu",
        parameters=(
            P("roll_rad", -0.2, 0.2, 0.003, 0.06, 0.01),
            P("pitch_rad", -0.2, 0.2, 0.003, 0.06, 0.01),
            P("yaw_rad", -0.2, 0.2, 0.003, 0.06, 0.01),
        ),
        replays=("swing", "flight"),
        has_memory=True,
        unit_field="imu_misalignment_rad",
        physics="The IMU is mounted turned by Rz(yaw) Ry(pitch) Rx(roll) against the gripper's axes.",
        source="mounting tolerance",
    ),
    EffectSpec(
        name="base_tilt",
        stage="aim",
        part="base",
        parameters=(
            P("roll_rad", -0.1, 0.1, 0.002, 0.03, 0.005),
            P("pitch_rad", -0.1, 0.1, 0.002, 0.03, 0.005),
        ),
        replays=("swing", "flight"),
        can_drift=True,
        unit_field="base_tilt_rad",
        physics="The machine is tilted about its chassis, Ry(pitch) Rx(roll) against level ground (positive "
        "pitch: front down): gravity in frame `machine` leans, and the throw with it.",
        source="rigid-body pose",
    ),
    EffectSpec(
        name="base_yaw_drift",
        stage="aim",
        part="base",
        parameters=(P("yaw_rad", -0.15, 0.15, 0.002, 0.05, 0.01),),
        replays=("flight",),
        can_drift=True,
        physics="The machine has turned about the slew axis against the surveyed ground.",
        source="wheels and legs creep on soft ground",
    ),
    EffectSpec(
        name="base_height",
        stage="aim",
        part="base",
        parameters=(P("extra_height_m", -0.5, 0.5, 0.01, 0.15, 0.02),),
        replays=("flight",),
        unit_field="base_height_error_m",
        physics="The machine stands higher above the surveyed ground.",
        source="base 0.85 m, 0.7-1.1 as the legs move (docs/machine.md, A)",
    ),
    EffectSpec(
        name="chassis_compliance",
        stage="aim",
        part="base",
        parameters=(P("pitch_rad", 0.0, 0.06, 0.001, 0.006, 0.002),),
        replays=("swing", "flight"),
        growth="frequency",
        has_memory=True,
        physics="The machine leans towards the arm by this at the arm's largest gravity moment about the "
        "slew axis, and sways on springs (30 % of critical damping) under the arm's weight and inertia.",
        source="stiffness of tyres, legs and ground",
    ),
)

_ALL = (*_ACTUATION, *_SWING, *_RELEASE, *_FLIGHT, *_AIM)


def _drift() -> EffectSpec:
    """Drift of any parameter: as far as the range allows, half as large as a constant one."""
    return EffectSpec(
        name=DRIFT,
        stage="actuation",
        part="drive",
        joints=ACTIVE_JOINTS,
        parameters=tuple(
            P(
                f"{spec.name}.{p.name}",
                -(p.high - p.low),
                p.high - p.low,
                p.tolerance,
                0.5 * p.prior_sd,
                p.step,
            )
            for spec in _ALL
            for p in spec.parameters
        ),
        replays=(),
        physics="Change of another effect's parameter from the first to the last throw of a set, linear in "
        "the throw's number; joint, part and stage are that effect's.",
        source="oil warms up over half an hour; battery, wind and ground change as slowly",
    )


EFFECTS: Mapping[str, EffectSpec] = MappingProxyType({s.name: s for s in (*_ALL, _drift())})
"""All effects by name in the order of the chain, and the drift of any of them."""


def effects_where(matches: Callable[[EffectSpec], bool]) -> tuple[str, ...]:
    """Names of the effects whose row matches, in the order of the table; without `DRIFT`."""
    return tuple(spec.name for spec in _ALL if matches(spec))
