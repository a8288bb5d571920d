"""Motions that separate two causes which the present throws cannot (sim_twin/effects/pairs.py names them)."""

from collections.abc import Mapping
from typing import Any

from sim_twin.effects.effect import Effect, acting_effect, effect_stage
from sim_twin.effects.pairs import MotionName, pair_of
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

_MOTIONS: Mapping[MotionName, dict[str, Any]] = {
    "valve_steps": _STEPS,
    "valve_ramps": _RAMPS,
    "valve_reversals": _REVERSALS,
    "valve_steps_in_postures": _POSTURES,
    "valve_steps_with_imu": {**_STEPS, "kind": "valve_steps_with_imu"},
    "free_swings": _SWING,
    "static_holds": _HOLDS,
    "throws_around": _SPREAD,
    "near_and_far_throws": _SLOW_FAST,
    "throws_with_two_loads": _TWO_LOADS,
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


def stage_motion_words(stage: str) -> str:
    """What to record to see a stage alone; empty for an unknown stage."""
    return _STAGES[stage][1] if stage in _STAGES else ""


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
        pair = pair_of(acting_effect(first), acting_effect(second))
        motion, words = _STAGES[effect_stage(first)]
        if pair is not None and pair.motion is not None:
            motion, words = _MOTIONS[pair.motion], pair.difference
    joint = first.joint or second.joint
    return {**motion, **({} if joint is None else {"joint": joint}), "words": words}
