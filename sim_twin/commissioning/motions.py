"""The tests by which a machine is identified: valve steps, openings at rest, free swings after a push.

Each is a program of valve commands and an opening at its end, as an engineer would run it on a machine;
nothing here knows how the machine answers.
"""

from typing import Literal, NamedTuple

import numpy as np

from machine.conventions import ACTIVE_COUNT, CONTROL_PERIOD_S, JOINT_COUNT, Array
from machine.kinematics import hanging_pitch_rad
from machine.starts import safe_pose

TestKind = Literal["response", "release", "swing"]

RELEASE_COUNT = 39
"""Openings of a release test (paper, section III-F)."""
RELEASE_AFTER_S = 1.0
RESPONSE_REPEATS = 2
LEVELS_RATIO = (0.15, 0.30, 0.50, 0.75, 1.0, 1.0)
"""Valve steps of a response test, each in both directions; the last ones show the speed limit."""
HOLD_S = (2.2, 0.55, 0.50, 0.80)
"""How long a step lasts, per joint: to a steady speed, within the joint's range at full valve."""
REST_S = 0.5
"""Before a step."""
RESPONSE_S = 3.7
"""Of the whole program: the longest step and its stop."""
RESPONSE_START_RAD_M = (
    (0.0, 0.80, 0.0, 0.50),
    (0.0, 0.80, 0.1, 0.40),
    (0.0, 0.85, -0.1, 0.30),
    (0.0, 0.95, 0.05, 0.80),
)
"""In the middle of each joint's range, load clear of the ground."""
START_SPREAD_RAD_M = (0.0, 0.08, 0.1, 0.1)
SWING_REPEATS = 4
SWING_S = 22.0
"""Dry friction of 0.1 rad/s2 (paper, III-F) takes 0.04 rad off the amplitude a period of 2 s."""
PUSH_S = 0.45
"""About a quarter of the swing's period there, and the same back."""
PUSH_RATIO = ((0.55, 0.90), (0.11, 0.17))
"""Valve of the push: dipper for a swing in pitch, slew for one in roll; 0.3 to 0.8 rad."""
SLEW_PUSH_S = 0.9
SETTLE_S = 1.2
"""Arm and oil ring on after a push; the swing that is looked at begins later."""


class MotionProgram(NamedTuple):
    """What N machines are told, side by side."""

    start_rad_m: Array
    """(N, 6)"""
    valve_ratio: Array
    """(T, N, 4) per control tick."""
    open_s: Array
    """(N,) when the gripper is told to open; the program ends later."""


def motion_program(kind: TestKind, seed: int) -> MotionProgram:
    """The program of a test; `seed` draws sizes, times and poses."""
    rng = np.random.default_rng((seed, 0x1D))
    return {"response": _steps, "release": _openings, "swing": _swings}[kind](rng)


def _poses(active_rad_m: Array) -> Array:
    """Poses (N, 6) with a plumb gripper."""
    poses = np.zeros((active_rad_m.shape[0], JOINT_COUNT))
    poses[:, :ACTIVE_COUNT] = active_rad_m
    poses[:, 4] = hanging_pitch_rad(active_rad_m)
    return poses


def _scattered(middle: tuple[float, ...], count: int, rng: np.random.Generator) -> Array:
    return np.asarray(middle) + np.asarray(START_SPREAD_RAD_M) * rng.uniform(-1, 1, (count, 4))


def _steps(rng: np.random.Generator) -> MotionProgram:
    """One step of one joint a log, from rest: a train of steps would shake the gripper round."""
    cases = [
        (joint, sign * level)
        for joint in range(ACTIVE_COUNT)
        for level in LEVELS_RATIO
        for sign in (1.0, -1.0)
        for _ in range(RESPONSE_REPEATS)
    ]
    valve = np.zeros((round(RESPONSE_S / CONTROL_PERIOD_S), len(cases), ACTIVE_COUNT))
    starts = np.empty((len(cases), ACTIVE_COUNT))
    for number, (joint, level) in enumerate(cases):
        first = round((REST_S + rng.uniform(0.0, 0.2)) / CONTROL_PERIOD_S)
        last = first + round(HOLD_S[joint] / CONTROL_PERIOD_S)
        valve[first:last, number, joint] = level
        starts[number] = _scattered(RESPONSE_START_RAD_M[joint], 1, rng)[0]
    return MotionProgram(_poses(starts), valve, np.full(len(cases), RESPONSE_S))


def _openings(rng: np.random.Generator) -> MotionProgram:
    """Nothing moves; the gripper opens at a time that no cycle of the machine knows."""
    starts = _poses(_scattered(tuple(safe_pose()[:4].tolist()), RELEASE_COUNT, rng))
    open_s = RELEASE_AFTER_S + rng.uniform(0.0, 0.2, RELEASE_COUNT)
    ticks = round(float(open_s.max()) / CONTROL_PERIOD_S) + 1
    return MotionProgram(starts, np.zeros((ticks, RELEASE_COUNT, ACTIVE_COUNT)), open_s)


def _swings(rng: np.random.Generator) -> MotionProgram:
    """A push to and fro, then nothing; every other machine swings in pitch, the rest in roll."""
    count = 2 * SWING_REPEATS
    rest = round(0.5 / CONTROL_PERIOD_S)
    ticks = rest + round((2.0 * SLEW_PUSH_S + SETTLE_S + SWING_S) / CONTROL_PERIOD_S)
    valve = np.zeros((ticks, count, ACTIVE_COUNT))
    for number in range(count):
        axis = number % 2
        joint, push_s = ((2, PUSH_S), (0, SLEW_PUSH_S))[axis]
        half = round(push_s / CONTROL_PERIOD_S)
        size = rng.uniform(*PUSH_RATIO[axis]) * rng.choice([-1.0, 1.0])
        valve[rest : rest + half, number, joint] = size
        valve[rest + half : rest + 2 * half, number, joint] = -size
    starts = _poses(_scattered(tuple(safe_pose()[:4].tolist()), count, rng))
    return MotionProgram(starts, valve, np.full(count, ticks * CONTROL_PERIOD_S))
