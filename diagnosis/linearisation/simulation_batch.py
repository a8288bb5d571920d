"""Batch of simulations about a set of effects: base, perturbed parameters, perturbed measurements."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from diagnosis.linearisation.parameters import (
    NONSMOOTH_EFFECTS,
    Parameter,
    ReplayKind,
    index_of,
    library,
)
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
"""Below this speed (rad/s or m/s) a joint's measured speed is sensor noise, six standard deviations of
it. Scaling noise is not a scale error of the sensor."""
FIXED_SLOPE_EFFECTS = effects_where(lambda effect: effect.keeps_slopes)
"""Effects that keep the slopes of "no effect" in swing and flight. The prior of a machine's biases
cancels along those slopes; other slopes break the cancellation."""


class SimulationBatch:
    """Elements of one batch, and the view of each."""

    def __init__(self) -> None:
        self.elements: list[ReplayElement] = []
        self.views: list[ReplayKind] = []

    def add(self, throw: int, effects: tuple[Effect, ...], view: ReplayKind) -> int:
        """Index of the new element."""
        flight = view is ReplayKind.FLIGHT
        self.views.append(view)
        self.elements.append(
            ReplayElement(
                throw=throw,
                effects=effects,
                measured_joints=NONE if view is ReplayKind.ACTUATION else ALL,
                measured_swing=flight,
                measured_opening=flight,
            )
        )
        return len(self.elements) - 1


Perturbations = dict[tuple[int, ReplayKind], tuple[int, float]]
"""(parameter, view) -> (element, step)."""


class PerturbedInputs(NamedTuple):
    """Elements of a throw with perturbed measurements."""

    start: list[int]
    """With perturbed initial swing (4)."""
    opening: int
    scale: list[tuple[int, int]]
    """With a scaled sensor of each driven joint (4): elements of the swing and of the flight view."""

    def of_view(self, view: ReplayKind) -> list[int]:
        """All elements of a view."""
        of_scale = [pair[0 if view is ReplayKind.SWING else 1] for pair in self.scale]
        first = {ReplayKind.SWING: self.start, ReplayKind.FLIGHT: [self.opening]}
        return [*first[view], *of_scale] if view in first else []


@dataclass(frozen=True, slots=True)
class ThrowElements:
    """Elements of one throw about one set of effects."""

    bases: dict[ReplayKind, int]
    moves: Perturbations
    inputs: PerturbedInputs | None


def perturbed_parameters(
    plan: SimulationBatch,
    throw: int,
    base: tuple[Effect, ...],
    wanted: Sequence[Parameter],
    views: tuple[ReplayKind, ...],
) -> Perturbations:
    """Elements that perturb one parameter each.

    Only single effects have bounds, so that a step beyond one is a sum like any other.
    """
    moves: Perturbations = {}
    for p in wanted:
        for view in (v for v in p.views if v in views):
            moved = plan.add(throw, (*base, p.at(p.step)), view)
            moves[index_of()[p.key], view] = (moved, p.step)
    return moves


@cache
def _others(view: ReplayKind) -> tuple[Parameter, ...]:
    """Parameters whose slopes a view shows; joints that stand have none."""
    shown = (p for p in library() if view in p.views and p.effect not in NONSMOOTH_EFFECTS)
    return tuple(p for p in shown if _is_updated(p, view))


@cache
def _views_of(effect: str) -> frozenset[ReplayKind]:
    """Views in which an effect of the library acts."""
    return frozenset(view for p in library() if p.effect == effect for view in p.views)


def _is_updated(parameter: Parameter, view: ReplayKind) -> bool:
    """Whether a parameter's slopes are taken at the set of effects."""
    return view is ReplayKind.ACTUATION or parameter.effect not in FIXED_SLOPE_EFFECTS


Shared = dict[
    tuple[int, ReplayKind, tuple[Effect, ...], tuple[str, ...]], tuple[int, Perturbations]
]
"""By throw, view, effects that act there and parameters wanted there: the base and its perturbations."""


def elements_about(
    plan: SimulationBatch,
    shared: Shared,
    throw: int,
    effects: tuple[Effect, ...],
    wanted: Sequence[Parameter],
    views: Sequence[ReplayKind],
    *,
    followed: Collection[ReplayKind],
) -> ThrowElements:
    """Elements of a throw about a set of effects; views that are equal for another set are shared with it.

    Beside the wanted parameters, a view that is `followed` has all others (`_others`).
    """
    bases: dict[ReplayKind, int] = {}
    moves: Perturbations = {}
    for view in views:
        acting = tuple(e for e in effects if view in _views_of(acting_effect(e)))
        # A parameter that is wanted twice is perturbed once, or its slope would double.
        own = list(dict.fromkeys(p for p in wanted if view in p.views and _is_updated(p, view)))
        if own and view in followed:
            own += [p for p in _others(view) if p not in own]
        key = throw, view, acting, tuple(p.key for p in own)
        if key not in shared:
            base = plan.add(throw, acting, view)
            shared[key] = base, perturbed_parameters(plan, throw, acting, own, (view,))
        bases[view], found = shared[key]
        moves |= found
    return ThrowElements(bases, moves, None)


def perturbed_inputs(
    plan: SimulationBatch, inputs: list[ReplayInput], throw: int
) -> PerturbedInputs:
    """Elements of a throw with perturbed measurements; adds the perturbed inputs."""
    data = inputs[throw]

    def added(moved: ReplayInput, view: ReplayKind) -> int:
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
        starts.append(added(moved, ReplayKind.SWING))
    late = data._replace(opening_t_s=data.opening_t_s + OPENING_STEP_S)
    scales: list[tuple[int, int]] = []
    for joint in range(ACTIVE_COUNT):
        moved = _unscaled(data, joint)
        scales.append((added(moved, ReplayKind.SWING), added(moved, ReplayKind.FLIGHT)))
    return PerturbedInputs(starts, added(late, ReplayKind.FLIGHT), scales)


def _unscaled(data: ReplayInput, joint: int) -> ReplayInput:
    """The throw if the joint's sensor reports `SCALE_STEP_RATIO` too much.

    The IMU measures the swing against the vertical: rotation that boom and dipper did not make belongs to
    the pitch joint.
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
