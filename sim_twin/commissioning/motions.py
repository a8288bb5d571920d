"""Identification tests: valve steps, gripper openings at rest, free swings after a push.

Each is an open-loop program of valve commands with a gripper opening at its end.
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
"""Earliest opening in a release test."""
RESPONSE_REPEATS = 2
"""Repetitions of each step."""
LEVELS_RATIO = (0.15, 0.30, 0.50, 0.75, 1.0, 1.0)
"""Valve steps of a response test, each in both directions; full steps reach the speed limit."""
HOLD_S = (2.2, 0.55, 0.50, 0.80)
"""Duration of a step, per joint: long enough for a steady speed, within the joint's range at full valve."""
REST_S = 0.5
"""Rest before a step."""
RESPONSE_S = 3.7
"""Duration of the program: the longest step and its stop."""
RESPONSE_START_RAD_M = (
    (0.0, 0.80, 0.0, 0.50),
    (0.0, 0.80, 0.1, 0.40),
    (0.0, 0.85, -0.1, 0.30),
    (0.0, 0.95, 0.05, 0.80),
)
"""Start positions, by moved joint: the middle of its range, load clear of the ground."""
START_SPREAD_RAD_M = (0.0, 0.08, 0.1, 0.1)
"""Half width of the uniform scatter of start positions."""
SWING_REPEATS = 4
"""Repetitions of each kind of swing."""
SWING_S = 22.0
"""Duration of a swing test. Dry friction of 0.1 rad/s2 (paper, III-F) reduces the amplitude by 0.04 rad per
period of 2 s."""
PUSH_S = 0.45
"""Duration of a push in each direction: about a quarter of the swing's period."""
PUSH_RATIO = ((0.55, 0.90), (0.11, 0.17))
"""Range of the push's valve command: dipper for a swing in pitch, slew for one in roll; 0.3 to 0.8 rad."""
SLEW_PUSH_S = 0.9
"""Duration of a push with the slew."""
SETTLE_S = 1.2
"""Time after a push in which arm and oil still oscillate; it is not evaluated."""


class MotionProgram(NamedTuple):
    """Commands of N machines side by side."""

    start_rad_m: Array
    """(N, 6) start poses."""
    valve_ratio: Array
    """(T, N, 4) valve commands per control tick."""
    open_s: Array
    """(N,) time of the opening command; the program ends later."""


def motion_program(kind: TestKind, seed: int) -> MotionProgram:
    """Program of a test; `seed` draws sizes, times and poses."""
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
    """One step of one joint per log, from rest: a sequence of steps would excite the gripper's swing."""
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
    """No motion; the gripper opens at a random time, independent of the machine's control cycle."""
    starts = _poses(_scattered(tuple(safe_pose()[:4].tolist()), RELEASE_COUNT, rng))
    open_s = RELEASE_AFTER_S + rng.uniform(0.0, 0.2, RELEASE_COUNT)
    ticks = round(float(open_s.max()) / CONTROL_PERIOD_S) + 1
    return MotionProgram(starts, np.zeros((ticks, RELEASE_COUNT, ACTIVE_COUNT)), open_s)


def _swings(rng: np.random.Generator) -> MotionProgram:
    """A push forth and back, then no motion; machines alternate between pitch and roll."""
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
