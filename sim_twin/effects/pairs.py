"""Pairs of effects that throws hardly tell apart, and the motion that does. Reasons: docs/diagnosis.md."""

from collections.abc import Mapping
from typing import Final, Literal, NamedTuple

MotionName = Literal[
    "valve_steps",
    "valve_ramps",
    "valve_reversals",
    "valve_steps_in_postures",
    "valve_steps_with_imu",
    "free_swings",
    "static_holds",
    "throws_around",
    "near_and_far_throws",
    "throws_with_two_loads",
]
"""Motions to record; diagnosis/separating_motions.py has their sizes."""


class ConfusablePair(NamedTuple):
    """Two effects that look alike in throws; effects of joints at the same joint."""

    first: str
    second: str
    motion: MotionName | None = None
    """The motion in which they differ; None: the motion that shows their stage best."""
    difference: str = ""
    """What differs between them in that motion."""
    is_hidden: bool = True
    """Whether a blind challenge may hide both in one set."""
    is_exchanged: bool = False
    """Whether a search simulates each in place of the other before it names one."""


CONFUSABLE_PAIRS: Final = (
    ConfusablePair(
        "valve_dead_time",
        "valve_lag",
        "valve_steps",
        "a delay shifts the whole step, a lag rounds it off: steps of several sizes",
        is_exchanged=True,
    ),
    ConfusablePair(
        "valve_dead_time",
        "valve_dead_band",
        "valve_ramps",
        "onset time over 1 / slope: the intercept is the delay, the slope the dead band",
    ),
    ConfusablePair(
        "valve_dead_band",
        "stiction",
        "valve_reversals",
        "stiction holds the joint only from rest and then jumps; a dead band is lost in every reversal",
    ),
    ConfusablePair(
        "valve_dead_band",
        "valve_gain",
        "valve_steps",
        "over the command, a dead band is an offset of the steady speed and a gain its slope",
    ),
    ConfusablePair(
        "valve_dead_band",
        "valve_hysteresis",
        "valve_reversals",
        "hysteresis is lost on every reversal at any speed, a dead band only around zero",
    ),
    ConfusablePair(
        "backlash",
        "valve_hysteresis",
        "valve_reversals",
        "backlash is a fixed lost motion whatever the speed, hysteresis a fixed lost command",
    ),
    ConfusablePair(
        "speed_limit",
        "valve_gain",
        "valve_steps",
        "a limit leaves small commands alone, a gain does not",
    ),
    ConfusablePair(
        "load_dependent_speed",
        "valve_gain",
        "valve_steps_in_postures",
        "the same step with the arm drawn in and stretched out: only the load's effect changes",
        is_exchanged=True,
    ),
    ConfusablePair(
        "joint_sensor_latency",
        "valve_dead_time",
        "valve_steps_with_imu",
        "steps felt by the gripper's IMU, whose clock is its own: a late valve moves the gripper late, "
        "a late sensor does not",
    ),
    ConfusablePair(
        "passive_coulomb_friction",
        "passive_viscous_friction",
        "free_swings",
        "swings of several sizes: dry friction takes the same angle off each, viscous the same share",
    ),
    ConfusablePair(
        "passive_viscous_friction",
        "imu_latency",
        "free_swings",
        "a long free swing: friction decays, latency is a constant phase against the joints",
    ),
    ConfusablePair(
        "payload_mass",
        "passive_viscous_friction",
        "throws_with_two_loads",
        "throws with two loads: only the mass changes with them",
    ),
    ConfusablePair(
        "release_delay",
        "air_drag",
        "near_and_far_throws",
        "near and far throws: drag grows with the square of the speed, a delay with the speed",
    ),
    ConfusablePair(
        "release_delay",
        "base_yaw_drift",
    ),
    ConfusablePair(
        "release_delay",
        "payload_offset",
    ),
    ConfusablePair(
        "air_drag",
        "wind",
        "throws_around",
        "throws in several directions: wind turns against them, drag does not",
    ),
    ConfusablePair(
        "joint_sensor_bias",
        "base_tilt",
        "static_holds",
        "static holds in several postures and slew angles: tilt turns with the slew, a bias does not",
    ),
    ConfusablePair(
        "joint_sensor_bias",
        "gripper_length",
        "static_holds",
        "survey the grip centre in several postures: an angle's error grows with the reach",
    ),
    ConfusablePair(
        "base_tilt",
        "imu_misalignment",
        "static_holds",
        "static holds at several slew angles: the mounting turns with the gripper, the tilt does not",
    ),
    ConfusablePair(
        "gripper_length",
        "gripper_inertia",
        "free_swings",
        "swing period plus the surveyed height of the grip: length moves both, inertia the period alone",
        is_hidden=False,
    ),
    ConfusablePair(
        "gripper_length",
        "hose_stiffness",
        "free_swings",
        "swings from several start angles: hoses pull towards where the gripper hung, gravity down",
        is_hidden=False,
    ),
    ConfusablePair(
        "sticky_release",
        "air_drag",
        "near_and_far_throws",
        "near and far throws with the ball tracked: a drag acts along the flight, a claw at its start",
        is_hidden=False,
    ),
    ConfusablePair(
        "payload_mass",
        "air_drag",
        is_hidden=False,
        is_exchanged=True,
    ),
)
_BY_EFFECTS: Final[Mapping[frozenset[str], ConfusablePair]] = {
    frozenset((pair.first, pair.second)): pair for pair in CONFUSABLE_PAIRS
}


def pair_of(first: str, second: str) -> ConfusablePair | None:
    """The pair of two effects, in either order; None if throws tell them apart."""
    return _BY_EFFECTS.get(frozenset((first, second)))
