"""Measured minus twin, channel by channel, each stage driven by the measured motion above it; and its slopes.

Three simulations of every throw (`View`): the joints from their valve commands; the swing from the measured
joints; the flight from the measured joints, swing and opening. Slopes are finite differences of the very
same simulations, all in one batch. Blocks (channels) of a throw:

    actuation.<joint>   joint velocity, rad/s or m/s, given the valve commands
    swing.gyro.<axis>, swing.accel.<axis>   IMU, given the measured joints
    release.switch      time of the opening given the command, s
    flight.ball, flight.impact    tracked and surveyed positions given the measured motion of the gripper, m
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from diagnosis.causes.parameters import Parameter, View, index_of, library
from diagnosis.healthy.filters import HealthyModel
from diagnosis.loading.prepared import PreparedThrow
from diagnosis.predictions import predict, view_of
from diagnosis.simulate import Simulated, simulate
from machine.ballistics import drag_per_m, landing
from machine.calibration import ValveCalibration
from machine.conventions import (
    ACTIVE_COUNT,
    ACTIVE_JOINTS,
    Array,
)
from machine.spec import load_spec
from sim_twin.effects.effect import Effect, resolve
from sim_twin.replay.replay import ReplayElement, ReplayInput
from sim_twin.replay.types import FourFlags
from sim_twin.twin.profile import TwinProfile

ALL: FourFlags = (True, True, True, True)
NONE: FourFlags = (False, False, False, False)
START_STEP_RAD = 0.01
START_RATE_STEP_RAD_PER_S = 0.02
OPENING_STEP_S = 0.005
SCALE_STEP_RATIO = 0.02
LANDING_STEP = 1e-3


@dataclass(frozen=True, slots=True)
class Linear:
    """A throw about a set of effects: residual and slopes, not whitened.

    residual(theta) = residual - jacobian @ (theta - where it was linearised).
    """

    residual: Array
    """(n,) measured minus twin; NaN rows are taken out by the whitening."""
    jacobian: Array
    """(n, p) of the twin's prediction, in the order of `library()`."""
    start: Array
    """(n, 4) slopes by the free joints' start angles and rates."""
    opening: Array
    """(n,) slope by the moment of opening."""
    scale: Array
    """(n, 4) slopes by the share that a driven joint's sensor reports too much of position and speed."""
    release_t_s: float
    """Of the flight view."""
    landing_slope: Array
    """(2, 6) of the impact by position and velocity at the release."""
    predicted_velocity: Array
    """(T, 4) driven joints from their valve commands, without any correction."""
    change: Array
    """(n,) what the effects change in the twin's prediction."""


class _Plan:
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


def linearise(
    prepared: Sequence[PreparedThrow],
    profile: TwinProfile,
    calibration: ValveCalibration,
    healthy: HealthyModel,
) -> list[Linear]:
    """Residuals and slopes of every throw without any effect, in one batched simulation.

    Args:
        prepared: the throws.
        profile: of the machine.
        calibration: of its valves.
        healthy: what the twin misses on every machine.
    """
    inputs = [p.input for p in prepared]
    plan = _Plan()
    parts: list[_Part] = []
    for i in range(len(prepared)):
        bases = {view: plan.add(i, (), view) for view in View}
        moves = _moved(plan, i, (), library(), tuple(View))
        parts.append(_Part(bases, moves, _moved_inputs(plan, inputs, i)))
    output = simulate(inputs, plan.elements, plan.views, profile, calibration)
    return [
        _linear(p, output, part, (), profile, healthy, None)
        for p, part in zip(prepared, parts, strict=True)
    ]


def relinearise(
    prepared: Sequence[PreparedThrow],
    profile: TwinProfile,
    calibration: ValveCalibration,
    healthy: HealthyModel,
    first: Sequence[Linear],
    requests: Sequence[tuple[tuple[Effect, ...], Sequence[Parameter]]],
    views: Sequence[View] | None = None,
) -> list[list[Linear]]:
    """Every throw about several sets of effects, in one batched simulation.

    Only the views that a set moves are simulated; everything else is as in `first`. Columns of other
    parameters than those wanted are those of `first`, too.

    Args:
        prepared: the throws.
        profile: of the machine.
        calibration: of its valves.
        healthy: what the twin misses on every machine.
        first: linearised without any effect.
        requests: effects about which to linearise, and the parameters whose slopes are wanted.
        views: to simulate; those that the wanted parameters move if left out.
    """
    inputs = [p.input for p in prepared]
    plan = _Plan()
    parts: list[list[_Part]] = []
    for effects, wanted in requests:
        moved = tuple(view for view in View if any(view in p.views for p in wanted))
        chosen = moved if views is None else tuple(views)
        row: list[_Part] = []
        for i in range(len(prepared)):
            bases = {view: plan.add(i, effects, view) for view in chosen}
            row.append(_Part(bases, _moved(plan, i, effects, wanted, chosen), None))
        parts.append(row)
    output = simulate(inputs, plan.elements, plan.views, profile, calibration)
    return [
        [
            _linear(p, output, part, effects, profile, healthy, before)
            for p, part, before in zip(prepared, row, first, strict=True)
        ]
        for (effects, _), row in zip(requests, parts, strict=True)
    ]


_Moves = dict[tuple[int, View], tuple[int, float]]
"""(parameter, view) -> (element, step)."""


@dataclass(frozen=True, slots=True)
class _Part:
    """Elements of one throw about one set of effects."""

    bases: dict[View, int]
    moves: _Moves
    inputs: "_MovedInputs | None"


class _MovedInputs(NamedTuple):
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


def _moved(
    plan: _Plan,
    throw: int,
    base: tuple[Effect, ...],
    wanted: Sequence[Parameter],
    views: tuple[View, ...],
) -> _Moves:
    """Elements that move one parameter each; in the actuation view one moves it at all joints.

    Only single effects have bounds, so that a step beyond one is a sum like any other.
    """
    moves: _Moves = {}
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


def _moved_inputs(plan: _Plan, inputs: list[ReplayInput], throw: int) -> _MovedInputs:
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
    return _MovedInputs(starts, added(late, View.FLIGHT), scales)


def _unscaled(data: ReplayInput, joint: int) -> ReplayInput:
    """A throw as it was if the joint's sensor reports `SCALE_STEP_RATIO` too much.

    The IMU knows the swing against the vertical: what boom and dipper did not turn, the pitch joint did.
    """
    excess = SCALE_STEP_RATIO / (1.0 + SCALE_STEP_RATIO)
    own = np.eye(ACTIVE_COUNT)[joint]
    moved: dict[str, Array] = {}
    for driven, free, start in (
        ("position_rad_m", "swing_rad", "swing_start_rad"),
        ("velocity_rad_m_per_s", "swing_rate_rad_per_s", "swing_rate_start_rad_per_s"),
    ):
        track = getattr(data, driven)
        moved[driven] = track * (1.0 - excess * own)
        pitch = excess * (own[1] + own[2]) * track[:, [joint]] * np.array([1.0, 0.0])
        moved[start] = getattr(data, start) + pitch[0]
        if getattr(data, free) is not None:
            moved[free] = getattr(data, free) + pitch
    return data._replace(**moved)


# --- from simulations to the residual vector -------------------------------------------------------


def _linear(
    prepared: PreparedThrow,
    output: Simulated,
    part: _Part,
    effects: tuple[Effect, ...],
    profile: TwinProfile,
    healthy: HealthyModel,
    first: Linear | None,
) -> Linear:
    """A throw's residual and slopes from the batch; what was not simulated is as in `first`."""
    n = prepared.measured.size
    predicted = _predicted(prepared, output, part, effects, healthy)
    residual = np.full(n, np.nan) if first is None else first.residual.copy()
    jacobian = np.zeros((n, len(library()))) if first is None else first.jacobian.copy()
    velocity = np.zeros((0, ACTIVE_COUNT)) if first is None else first.predicted_velocity
    for view, rows in predicted.items():
        for block in prepared.blocks:
            if view_of(block) is view:
                residual[block.rows] = (
                    prepared.measured[block.rows] - rows[part.bases[view]][block.rows]
                )
    if View.ACTUATION in part.bases:
        velocity = output.joint_velocity_rad_m_per_s[
            part.bases[View.ACTUATION], : prepared.motion.t_s.size
        ]
    for parameter in {parameter for parameter, _ in part.moves}:
        jacobian[:, parameter] = 0.0
    for (parameter, view), (element, step) in part.moves.items():
        slope = (predicted[view][element] - predicted[view][part.bases[view]]) / step
        joint = library()[parameter].joint
        for block in prepared.blocks:
            # Behind its valve a joint moves alone; only the IMU and the load feel the others.
            own = view is not View.ACTUATION or joint is None or block.name.endswith(joint)
            if own and view_of(block) is view:
                jacobian[block.rows, parameter] = np.nan_to_num(slope[block.rows], nan=0.0)
    _compare_switch(prepared, effects, profile, residual, jacobian)
    if first is not None:
        return replace(
            first,
            residual=residual,
            jacobian=jacobian,
            predicted_velocity=velocity,
            change=np.nan_to_num(first.residual - residual),
        )
    start, opening, scale = _input_slopes(prepared, predicted, part)
    flight = part.bases[View.FLIGHT]
    slope = _landing_slope(
        output.release_position_m[flight],
        output.release_velocity_m_per_s[flight],
        prepared.input.surface_height_m,
    )
    return Linear(
        residual,
        jacobian,
        start,
        opening,
        scale,
        float(output.release_t_s[flight]),
        slope,
        velocity,
        np.zeros(n),
    )


def _input_slopes(
    prepared: PreparedThrow, predicted: Mapping[View, Mapping[int, Array]], part: _Part
) -> tuple[Array, Array, Array]:
    """Slopes by the swing's start (n, 4), the opening (n,) and the scale of the joint sensors (n, 4)."""
    n, moved = prepared.measured.size, part.inputs
    if moved is None:
        raise ValueError("slopes by what was measured need their elements")
    base = {view: rows[part.bases[view]] for view, rows in predicted.items()}

    def slope(view: View, element: int, step: float) -> Array:
        return np.nan_to_num((predicted[view][element] - base[view]) / step)

    steps = (START_STEP_RAD,) * 2 + (START_RATE_STEP_RAD_PER_S,) * 2
    starts = [slope(View.SWING, e, step) for e, step in zip(moved.start, steps, strict=True)]
    scale = np.zeros((n, ACTIVE_COUNT))
    for joint, (swing, flight) in enumerate(moved.scale):
        scale[:, joint] = slope(View.SWING, swing, SCALE_STEP_RATIO)
        scale[:, joint] += slope(View.FLIGHT, flight, SCALE_STEP_RATIO)
        block = prepared.block(f"{View.ACTUATION}.{ACTIVE_JOINTS[joint]}")
        if block is not None:
            scale[block.rows, joint] = np.nan_to_num(base[View.ACTUATION][block.rows])
    return np.stack(starts, axis=1), slope(View.FLIGHT, moved.opening, OPENING_STEP_S), scale


def _predicted(
    prepared: PreparedThrow,
    output: Simulated,
    part: _Part,
    effects: Sequence[Effect],
    healthy: HealthyModel,
) -> dict[View, dict[int, Array]]:
    """What the twin says of the throw's vector (n,) in each simulated view, by element."""
    elements: dict[View, list[int]] = {view: [base] for view, base in part.bases.items()}
    for (_, view), (element, _) in part.moves.items():
        if element not in elements[view]:
            elements[view].append(element)
    if part.inputs is not None:
        for view, chosen in elements.items():
            chosen += part.inputs.of_view(view)
    return {
        view: dict(
            zip(
                chosen,
                predict(prepared, output, np.asarray(chosen), view, effects, healthy),
                strict=True,
            )
        )
        for view, chosen in elements.items()
    }


def _compare_switch(
    prepared: PreparedThrow,
    effects: tuple[Effect, ...],
    profile: TwinProfile,
    residual: Array,
    jacobian: Array,
) -> None:
    """Fill in, in place, the opening's row: delays add up without a simulation."""
    switch = prepared.block("release.switch")
    if switch is None:
        return
    sizes = resolve((*profile.effects, *effects), prepared.input.progress_ratio)
    delay = profile.release_delay_s + sizes.get(("release_delay", None, "extra_delay_s"), 0.0)
    residual[switch.rows] = prepared.measured[switch.rows] - prepared.throw.open_command_t_s - delay
    jacobian[switch.rows, index_of()["release_delay.extra_delay_s"]] = 1.0


def _landing_slope(position_m: Array, velocity_m_per_s: Array, height_m: float) -> Array:
    """Impact (2,) by release position and velocity (6,), numerically, with the nominal drag."""
    ball = load_spec().ball
    state = np.concatenate([position_m, velocity_m_per_s])
    states = state + LANDING_STEP * np.vstack([np.zeros(6), np.eye(6)])
    end = landing(states[:, :3], states[:, 3:], height_m + ball.radius_m, drag_per_m(ball))
    return np.nan_to_num((end.position_m[1:, :2] - end.position_m[0, :2]).T / LANDING_STEP)
