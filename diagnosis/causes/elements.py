"""What is simulated of a throw about a set of effects: itself, one parameter moved, one measurement moved."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from diagnosis.causes.parameters import ROUGH_EFFECTS, Parameter, View, index_of, library
from machine.conventions import ACTIVE_COUNT, Array
from sim_twin.effects.effect import Effect, acting_effect
from sim_twin.effects.table import effects_where
from sim_twin.replay.replay import ReplayElement, ReplayInput
from sim_twin.replay.types import FourFlags

ALL: FourFlags = (True, True, True, True)
NONE: FourFlags = (False, False, False, False)
START_STEP_RAD = 0.01
START_RATE_STEP_RAD_PER_S = 0.02
OPENING_STEP_S = 0.005
SCALE_STEP_RATIO = 0.02
STANDING_RAD_M_PER_S = 0.03
"""Slower than this a joint's measured speed is the noise of its sensors, six standard deviations of it: less
of that is less of what shakes the simulated gripper, and no scale. Healthy machines whose 12 throws were all
2D, with a slew that stood, had a slew's sensor that reports too much (z 46 in the gyro of one set)."""
STRAIGHT_EFFECTS = effects_where(lambda effect: effect.keeps_slopes)
"""They keep the slopes of no effect in swing and flight. A machine's own biases are known as a part of all
that its healthy throws are off: each several standard deviations, that cancel each other along those slopes
(of 10 % other ones a boom's bias of 0.018 rad lost 12 of log evidence, a dipper's of 0.024 rad 29)."""


class Plan:
    """Elements of one batch, and what each of them is for."""

    def __init__(self) -> None:
        self.elements: list[ReplayElement] = []
        self.views: list[View] = []

    def add(self, throw: int, effects: tuple[Effect, ...], view: View) -> int:
        """Index of the new element."""
        flight = view is View.FLIGHT
        self.views.append(view)
        self.elements.append(
            ReplayElement(
                throw=throw,
                effects=effects,
                measured_joints=NONE if view is View.ACTUATION else ALL,
                measured_swing=flight,
                measured_opening=flight,
            )
        )
        return len(self.elements) - 1


Moves = dict[tuple[int, View], tuple[int, float]]
"""(parameter, view) -> (element, step)."""


class MovedInputs(NamedTuple):
    """Elements of a throw that was measured otherwise."""

    start: list[int]
    """With moved start swing (4)."""
    opening: int
    scale: list[tuple[int, int]]
    """With a driven joint's sensor scaled (4): of the swing and of the flight view."""

    def of_view(self, view: View) -> list[int]:
        """All that are simulated in a view."""
        of_scale = [pair[0 if view is View.SWING else 1] for pair in self.scale]
        first = {View.SWING: self.start, View.FLIGHT: [self.opening]}
        return [*first[view], *of_scale] if view in first else []


@dataclass(frozen=True, slots=True)
class Part:
    """Elements of one throw about one set of effects."""

    bases: dict[View, int]
    moves: Moves
    inputs: MovedInputs | None


def moved_parameters(
    plan: Plan,
    throw: int,
    base: tuple[Effect, ...],
    wanted: Sequence[Parameter],
    views: tuple[View, ...],
) -> Moves:
    """Elements that move one parameter each; in the actuation view one moves it at all joints.

    Only single effects have bounds, so that a step beyond one is a sum like any other.
    """
    moves: Moves = {}
    together: dict[str, list[Parameter]] = {}
    for p in wanted:
        for view in (v for v in p.views if v in views):
            if view is View.ACTUATION and p.joint is not None:
                together.setdefault(f"{p.effect}.{p.name}", []).append(p)
                continue
            moved = plan.add(throw, (*base, p.at(p.step)), view)
            moves[index_of()[p.key], view] = (moved, p.step)
    for parameters in together.values():
        effects = tuple(p.at(p.step) for p in parameters)
        element = plan.add(throw, (*base, *effects), View.ACTUATION)
        for p in parameters:
            moves[index_of()[p.key], View.ACTUATION] = (element, p.step)
    return moves


@cache
def _others(view: View) -> tuple[Parameter, ...]:
    """Parameters that slopes show in a view; joints that stand have none."""
    shown = (p for p in library() if view in p.views and p.effect not in ROUGH_EFFECTS)
    return tuple(p for p in shown if _bends(p, view))


@cache
def _views_of(effect: str) -> frozenset[View]:
    """Views in which an effect of the library does anything."""
    return frozenset(view for p in library() if p.effect == effect for view in p.views)


def _bends(parameter: Parameter, view: View) -> bool:
    """Whether a parameter's slopes are taken where a set of effects is."""
    return view is View.ACTUATION or parameter.effect not in STRAIGHT_EFFECTS


Shared = dict[tuple[int, View, tuple[Effect, ...], tuple[str, ...]], tuple[int, Moves]]
"""By throw, view, effects that do anything there and parameters wanted there: the base, what is moved."""


def part_about(
    plan: Plan,
    shared: Shared,
    throw: int,
    effects: tuple[Effect, ...],
    wanted: Sequence[Parameter],
    views: Sequence[View],
    *,
    followed: Collection[View],
) -> Part:
    """Elements of a throw about a set of effects; views that look alike for another set are shared with it.

    Beside the parameters wanted of a view that is `followed` are all others there (`_others`).
    """
    bases: dict[View, int] = {}
    moves: Moves = {}
    for view in views:
        acting = tuple(e for e in effects if view in _views_of(acting_effect(e)))
        # Wanted twice, a parameter would be moved twice, and its slope be twice what it is.
        own = list(dict.fromkeys(p for p in wanted if view in p.views and _bends(p, view)))
        if own and view in followed:
            own += [p for p in _others(view) if p not in own]
        key = throw, view, acting, tuple(p.key for p in own)
        if key not in shared:
            base = plan.add(throw, acting, view)
            shared[key] = base, moved_parameters(plan, throw, acting, own, (view,))
        bases[view], found = shared[key]
        moves |= found
    return Part(bases, moves, None)


def moved_inputs(plan: Plan, inputs: list[ReplayInput], throw: int) -> MovedInputs:
    """Elements of a throw that was measured otherwise; adds the moved inputs."""
    data = inputs[throw]

    def added(moved: ReplayInput, view: View) -> int:
        inputs.append(moved)
        return plan.add(len(inputs) - 1, (), view)

    starts: list[int] = []
    for axis in range(4):
        angle, rate = data.swing_start_rad.copy(), data.swing_rate_start_rad_per_s.copy()
        if axis < 2:
            angle[axis] += START_STEP_RAD
        else:
            rate[axis - 2] += START_RATE_STEP_RAD_PER_S
        moved = data._replace(swing_start_rad=angle, swing_rate_start_rad_per_s=rate)
        starts.append(added(moved, View.SWING))
    late = data._replace(opening_t_s=data.opening_t_s + OPENING_STEP_S)
    scales: list[tuple[int, int]] = []
    for joint in range(ACTIVE_COUNT):
        moved = _unscaled(data, joint)
        scales.append((added(moved, View.SWING), added(moved, View.FLIGHT)))
    return MovedInputs(starts, added(late, View.FLIGHT), scales)


def _unscaled(data: ReplayInput, joint: int) -> ReplayInput:
    """A throw as it was if the joint's sensor reports `SCALE_STEP_RATIO` too much.

    The IMU knows the swing against the vertical: what boom and dipper did not turn, the pitch joint did.
    """
    excess = SCALE_STEP_RATIO / (1.0 + SCALE_STEP_RATIO)
    own = np.eye(ACTIVE_COUNT)[joint]
    is_moving = np.abs(data.velocity_rad_m_per_s) > STANDING_RAD_M_PER_S
    moved: dict[str, Array] = {}
    for driven, free, start in (
        ("position_rad_m", "swing_rad", "swing_start_rad"),
        ("velocity_rad_m_per_s", "swing_rate_rad_per_s", "swing_rate_start_rad_per_s"),
    ):
        track = getattr(data, driven)
        share = excess * own * (is_moving if driven.startswith("velocity") else 1.0)
        moved[driven] = track * (1.0 - share)
        pitch = (track * share)[:, 1:3].sum(axis=1, keepdims=True) * np.array([1.0, 0.0])
        moved[start] = getattr(data, start) + pitch[0]
        if getattr(data, free) is not None:
            moved[free] = getattr(data, free) + pitch
    return data._replace(**moved)
