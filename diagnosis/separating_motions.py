"""Motions that separate two causes which the present throws cannot: each pair, its physics and the motion.

Source: the table of confounded pairs in docs/diagnosis.md.
"""

from collections.abc import Mapping
from typing import Any

from sim_twin.effects.effect import Effect, acting_effect, effect_stage
from sim_twin.effects.schema import DRIFT

_STEPS = {
    "kind": "valve_steps",
    "valve_ratio": [0.15, 0.3, 0.6, 1.0],
    "directions": ["positive", "negative"],
    "hold_s": 1.5,
}
_RAMPS = {
    "kind": "valve_ramps",
    "slope_per_s": [0.25, 0.5, 1.0, 2.0],
    "directions": ["positive", "negative"],
}
_REVERSALS = {
    "kind": "valve_reversals",
    "valve_ratio": [0.2, 0.4],
    "period_s": 1.5,
    "cycles_count": 6,
}
_POSTURES = {
    "kind": "valve_steps_in_postures",
    "valve_ratio": [0.4, 0.8],
    "reach_m": [3.8, 5.2, 6.8],
}
_SWING = {"kind": "free_swing", "start_rad": [0.1, 0.3, 0.6], "seconds_s": 20.0}
_HOLDS = {"kind": "static_holds", "postures_count": 6, "seconds_s": 5.0}
_SPREAD = {
    "kind": "throws",
    "azimuth_rad": [-1.5, 0.0, 1.5],
    "range_m": [7.5, 9.0, 10.5],
    "count": 12,
}
_SLOW_FAST = {"kind": "throws", "range_m": [7.0, 11.0], "count": 12}
_TWO_LOADS = {"kind": "throws_with_two_loads", "mass_kg": [0.6, 2.0], "count": 12}

_PAIRS: Mapping[frozenset[str], tuple[dict[str, Any], str]] = {
    frozenset(("valve_dead_time", "valve_lag")): (
        _STEPS,
        "a delay shifts the whole step, a lag rounds it off: steps of several sizes",
    ),
    frozenset(("valve_dead_time", "valve_dead_band")): (
        _RAMPS,
        "onset time over 1 / slope: the intercept is the delay, the slope the dead band",
    ),
    frozenset(("valve_dead_band", "stiction")): (
        _REVERSALS,
        "stiction holds the joint only from rest and then jumps; a dead band is lost in every reversal",
    ),
    frozenset(("valve_dead_band", "valve_gain")): (
        _STEPS,
        "over the command, a dead band is an offset of the steady speed and a gain its slope",
    ),
    frozenset(("valve_dead_band", "valve_hysteresis")): (
        _REVERSALS,
        "hysteresis is lost on every reversal at any speed, a dead band only around zero",
    ),
    frozenset(("backlash", "valve_hysteresis")): (
        _REVERSALS,
        "backlash is a fixed lost motion whatever the speed, hysteresis a fixed lost command",
    ),
    frozenset(("speed_limit", "valve_gain")): (
        _STEPS,
        "a limit leaves small commands alone, a gain does not",
    ),
    frozenset(("load_dependent_speed", "valve_gain")): (
        _POSTURES,
        "the same step with the arm drawn in and stretched out: only the load's effect changes",
    ),
    frozenset(("joint_sensor_latency", "valve_dead_time")): (
        {**_STEPS, "kind": "valve_steps_with_imu"},
        "steps felt by the gripper's IMU, whose clock is its own: a late valve moves the gripper late, "
        "a late sensor does not",
    ),
    frozenset(("passive_coulomb_friction", "passive_viscous_friction")): (
        _SWING,
        "swings of several sizes: dry friction takes the same angle off each, viscous the same share",
    ),
    frozenset(("passive_viscous_friction", "imu_latency")): (
        _SWING,
        "a long free swing: friction decays, latency is a constant phase against the joints",
    ),
    frozenset(("air_drag", "wind")): (
        _SPREAD,
        "throws in several directions: wind turns against them, drag does not",
    ),
    frozenset(("joint_sensor_bias", "base_tilt")): (
        _HOLDS,
        "static holds in several postures and slew angles: tilt turns with the slew, a bias does not",
    ),
    frozenset(("joint_sensor_bias", "gripper_length")): (
        _HOLDS,
        "survey the grip centre in several postures: an angle's error grows with the reach",
    ),
    frozenset(("base_tilt", "imu_misalignment")): (
        _HOLDS,
        "static holds at several slew angles: the mounting turns with the gripper, the tilt does not",
    ),
    frozenset(("payload_mass", "passive_viscous_friction")): (
        _TWO_LOADS,
        "throws with two loads: only the mass changes with them",
    ),
    frozenset(("gripper_length", "gripper_inertia")): (
        _SWING,
        "swing period plus the surveyed height of the grip: length moves both, inertia the period alone",
    ),
    frozenset(("gripper_length", "hose_stiffness")): (
        _SWING,
        "swings from several start angles: hoses pull towards where the gripper hung, gravity down",
    ),
    frozenset(("release_delay", "air_drag")): (
        _SLOW_FAST,
        "near and far throws: drag grows with the square of the speed, a delay with the speed",
    ),
    frozenset(("sticky_release", "air_drag")): (
        _SLOW_FAST,
        "near and far throws with the ball tracked: a drag acts along the flight, a claw at its start",
    ),
}

_STAGES: Mapping[str, tuple[dict[str, Any], str]] = {
    "actuation": (_STEPS, "valve steps of several sizes in both directions, this joint alone"),
    "swing": (_SWING, "free swings of several sizes with the arm at rest"),
    "release": (_SLOW_FAST, "throws at several speeds with the ball tracked"),
    "flight": (
        _SPREAD,
        "throws in several directions and over several ranges with the ball tracked",
    ),
    "aim": (_HOLDS, "static holds in several postures and slew angles, the grip centre surveyed"),
}


def detecting_motion(effect: Effect) -> dict[str, Any]:
    """What to record next to distinguish an effect from none; ``words`` for people."""
    motion, words = _STAGES[effect_stage(effect)]
    return {**motion, **({} if effect.joint is None else {"joint": effect.joint}), "words": words}


def separating_motion(first: Effect, second: Effect) -> dict[str, Any]:
    """What to record next to distinguish two causes; ``words`` for people."""
    names = frozenset((acting_effect(first), acting_effect(second)))
    if DRIFT in (first.effect, second.effect) and len(names) == 1:
        motion, words = (
            {"kind": "throws", "count": 12, "pause_s": 1800.0},
            "the same throws after a pause: a drift has gone back or on, a constant has stayed",
        )
    elif first.effect == second.effect and first.joint != second.joint:
        motion, words = _STAGES[effect_stage(first)]
        words = f"one joint at a time: {words}"
    else:
        motion, words = _PAIRS.get(names, _STAGES[effect_stage(first)])
    joint = first.joint or second.joint
    return {**motion, **({} if joint is None else {"joint": joint}), "words": words}
