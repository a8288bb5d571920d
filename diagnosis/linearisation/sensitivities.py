"""Residuals and slopes of throws: measured minus twin, each stage driven by the measured motion before it.

Three simulations of every throw (`ReplayKind`): the joints from their valve commands; the swing from the
measured joints; the flight from the measured joints, swing and opening. Slopes are finite differences of the
same simulations, in one batch. Blocks (channels) of a throw:

    actuation.<joint>   joint velocity, rad/s or m/s, given the valve commands
    swing.gyro.<axis>, swing.accel.<axis>   IMU, given the measured joints
    release.switch      time of the opening given the command, s
    flight.ball, flight.impact    tracked and surveyed positions given the measured motion of the gripper, m
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from diagnosis.healthy.filters import HealthyModel
from diagnosis.linearisation.parameters import Parameter, ReplayKind, index_of, library
from diagnosis.linearisation.predictions import predict, view_of
from diagnosis.linearisation.simulation import Simulated, simulate
from diagnosis.linearisation.simulation_batch import (
    OPENING_STEP_S,
    SCALE_STEP_RATIO,
    START_RATE_STEP_RAD_PER_S,
    START_STEP_RAD,
    Shared,
    SimulationBatch,
    ThrowElements,
    elements_about,
    perturbed_inputs,
    perturbed_parameters,
)
from diagnosis.loading.prepared import PreparedThrow
from machine.ballistics import drag_per_m, landing
from machine.calibration import ValveCalibration
from machine.conventions import (
    ACTIVE_COUNT,
    ACTIVE_JOINTS,
    Array,
)
from machine.spec import load_spec
from sim_twin.effects.effect import Effect, resolve
from sim_twin.twin.profile import TwinProfile

LANDING_STEP = 1e-3
Predicted = Mapping[ReplayKind, Mapping[int, Array]]
"""The twin's prediction of the throw's vector, by view and element."""
Known = dict[int, dict[int, Array]]
"""Predictions of the throw's vector by element, for the base of each view that was already evaluated."""


@dataclass(frozen=True, slots=True)
class LinearThrow:
    """Residual and slopes of a throw about a set of effects, before whitening.

    residual(theta) = residual - jacobian @ (theta - where it was linearised).
    """

    residual: Array
    """(n,) measured minus twin; the whitening removes NaN rows."""
    jacobian: Array
    """(n, p) of the twin's prediction, in the order of `library()`."""
    start: Array
    """(n, 4) slopes with respect to the passive joints' initial angles and rates."""
    opening: Array
    """(n,) slope with respect to the moment of opening."""
    scale: Array
    """(n, 4) slopes with respect to a driven joint sensor's scale error, in position and speed."""
    release_t_s: float
    """Of the flight view."""
    landing_slope: Array
    """(2, 6) of the impact with respect to position and velocity at the release."""
    predicted_velocity: Array
    """(T, 4) driven joints from their valve commands, without correction."""
    change: Array
    """(n,) change of the twin's prediction by the effects."""


def linear_throw(
    prepared: PreparedThrow,
    output: Simulated,
    part: ThrowElements,
    effects: tuple[Effect, ...],
    profile: TwinProfile,
    healthy: HealthyModel,
    first: LinearThrow | None,
    known: Known,
) -> LinearThrow:
    """A throw's residual and slopes from the batch; views that were not simulated are as in `first`."""
    predicted = _predicted(prepared, output, part, effects, healthy, known)
    velocity = np.zeros((0, ACTIVE_COUNT)) if first is None else first.predicted_velocity
    if ReplayKind.ACTUATION in part.bases:
        rows = slice(prepared.motion.t_s.size)
        velocity = output.joint_velocity_rad_m_per_s[part.bases[ReplayKind.ACTUATION], rows]
    residual = _residual(prepared, predicted, part, first)
    jacobian = _jacobian(prepared, predicted, part, effects, first)
    start, opening, scale = (
        _input_slopes(prepared, predicted, part)
        if first is None
        else (first.start, first.opening, first.scale)
    )
    _compare_opening(prepared, effects, profile, opening, residual, jacobian)
    if first is not None:
        return replace(
            first,
            residual=residual,
            jacobian=jacobian,
            predicted_velocity=velocity,
            change=np.nan_to_num(first.residual - residual),
        )
    flight = part.bases[ReplayKind.FLIGHT]
    slope = _landing_slope(
        output.release_position_m[flight],
        output.release_velocity_m_per_s[flight],
        prepared.input.surface_height_m,
    )
    return LinearThrow(
        residual,
        jacobian,
        start,
        opening,
        scale,
        float(output.release_t_s[flight]),
        slope,
        velocity,
        np.zeros(residual.size),
    )


def _residual(
    prepared: PreparedThrow, predicted: Predicted, part: ThrowElements, first: LinearThrow | None
) -> Array:
    """Measured minus twin (n,); views that were not simulated are as in `first`."""
    residual = np.full(prepared.measured.size, np.nan) if first is None else first.residual.copy()
    for view, rows in predicted.items():
        for block in (b for b in prepared.blocks if view_of(b) is view):
            own = rows[part.bases[view]][block.rows]
            residual[block.rows] = prepared.measured[block.rows] - own
    return residual


def _jacobian(
    prepared: PreparedThrow,
    predicted: Predicted,
    part: ThrowElements,
    effects: tuple[Effect, ...],
    first: LinearThrow | None,
) -> Array:
    """Slopes (n, p) of the perturbed parameters; others as in `first`, delayed by these effects."""
    jacobian = np.zeros((prepared.measured.size, len(library())))
    if first is not None:
        jacobian = _reported_late(prepared, effects, first.jacobian)
    for (parameter, view), (element, step) in part.moves.items():
        slope = (predicted[view][element] - predicted[view][part.bases[view]]) / step
        joint = library()[parameter].joint
        for block in (b for b in prepared.blocks if view_of(b) is view):
            # A joint follows its own valve alone; only IMU and load follow all joints.
            own = view is not ReplayKind.ACTUATION or joint is None or block.name.endswith(joint)
            jacobian[block.rows, parameter] = np.nan_to_num(slope[block.rows]) if own else 0.0
    return jacobian


def _reported_late(prepared: PreparedThrow, effects: tuple[Effect, ...], slopes: Array) -> Array:
    """Slopes (n, p), those of the swing delayed by the effects' IMU latency."""
    slopes = slopes.copy()
    sizes = resolve(effects, prepared.input.progress_ratio)
    latency_s = sizes.get(("imu_latency", None, "extra_latency_s"), 0.0)
    for block in prepared.blocks if latency_s > 0.0 else ():
        if view_of(block) is ReplayKind.SWING:
            at_s = np.maximum(block.t_s - latency_s, block.t_s[0])
            rows = slopes[block.rows]
            known = rows.any(axis=0)
            rows[:, known] = CubicSpline(block.t_s, rows[:, known])(at_s)
    return slopes


def _input_slopes(
    prepared: PreparedThrow, predicted: Predicted, part: ThrowElements
) -> tuple[Array, Array, Array]:
    """Slopes with respect to the initial swing (n, 4), the opening (n,) and the sensors' scale (n, 4)."""
    n, moved = prepared.measured.size, part.inputs
    if moved is None:
        raise ValueError("slopes by what was measured need their elements")
    base = {view: rows[part.bases[view]] for view, rows in predicted.items()}

    def slope(view: ReplayKind, element: int, step: float) -> Array:
        return np.nan_to_num((predicted[view][element] - base[view]) / step)

    steps = (START_STEP_RAD,) * 2 + (START_RATE_STEP_RAD_PER_S,) * 2
    starts = [slope(ReplayKind.SWING, e, step) for e, step in zip(moved.start, steps, strict=True)]
    scale = np.zeros((n, ACTIVE_COUNT))
    for joint, (swing, flight) in enumerate(moved.scale):
        scale[:, joint] = slope(ReplayKind.SWING, swing, SCALE_STEP_RATIO)
        scale[:, joint] += slope(ReplayKind.FLIGHT, flight, SCALE_STEP_RATIO)
        block = prepared.block(f"{ReplayKind.ACTUATION}.{ACTIVE_JOINTS[joint]}")
        if block is not None:
            scale[block.rows, joint] = np.nan_to_num(base[ReplayKind.ACTUATION][block.rows])
    return np.stack(starts, axis=1), slope(ReplayKind.FLIGHT, moved.opening, OPENING_STEP_S), scale


def _predicted(
    prepared: PreparedThrow,
    output: Simulated,
    part: ThrowElements,
    effects: Sequence[Effect],
    healthy: HealthyModel,
    known: Known,
) -> dict[ReplayKind, dict[int, Array]]:
    """Predictions (n,) of each simulated view by element; adds to `known`."""
    elements: dict[ReplayKind, list[int]] = {view: [base] for view, base in part.bases.items()}
    for (_, view), (element, _) in part.moves.items():
        if element not in elements[view]:
            elements[view].append(element)
    if part.inputs is not None:
        for view, chosen in elements.items():
            chosen += part.inputs.of_view(view)
    for view, chosen in elements.items():
        if chosen[0] not in known:
            rows = predict(prepared, output, np.asarray(chosen), view, effects, healthy)
            known[chosen[0]] = dict(zip(chosen, rows, strict=True))
    return {view: known[chosen[0]] for view, chosen in elements.items()}


def _compare_opening(
    prepared: PreparedThrow,
    effects: tuple[Effect, ...],
    profile: TwinProfile,
    opening: Array,
    residual: Array,
    jacobian: Array,
) -> None:
    """Fill in, in place, the effect of a delayed opening: delays add up without a simulation.

    Without a switch the load is assumed to leave when the profile says; `opening` (n,) then gives the
    flight's dependence on the delay.
    """
    delay_key = ("release_delay", None, "extra_delay_s")
    column = jacobian[:, index_of()["release_delay.extra_delay_s"]]
    switch = prepared.block("release.switch")
    if switch is None:
        residual -= opening * resolve(effects, prepared.input.progress_ratio).get(delay_key, 0.0)
        column[:] = opening
        return
    sizes = resolve((*profile.effects, *effects), prepared.input.progress_ratio)
    delay = profile.release_delay_s + sizes.get(delay_key, 0.0)
    residual[switch.rows] = prepared.measured[switch.rows] - prepared.throw.open_command_t_s - delay
    column[switch.rows] = 1.0


def _landing_slope(position_m: Array, velocity_m_per_s: Array, height_m: float) -> Array:
    """Slope of the impact (2,) by release position and velocity (6,), numerically, with the nominal drag."""
    ball = load_spec().ball
    state = np.concatenate([position_m, velocity_m_per_s])
    states = state + LANDING_STEP * np.vstack([np.zeros(6), np.eye(6)])
    end = landing(states[:, :3], states[:, 3:], height_m + ball.radius_m, drag_per_m(ball))
    return np.nan_to_num((end.position_m[1:, :2] - end.position_m[0, :2]).T / LANDING_STEP)


THROWS_COUNT = 24
"""Throws linearised together; it bounds the memory (14 MiB per throw)."""
BATCH_COUNT = 700
"""Simulations in one batch, beyond which no further set is added."""


def linearise(
    prepared: Sequence[PreparedThrow],
    profile: TwinProfile,
    calibration: ValveCalibration,
    healthy: HealthyModel,
) -> list[LinearThrow]:
    """Residuals and slopes of every throw without effect.

    Args:
        prepared: the throws.
        profile: of the machine.
        calibration: of its valves.
        healthy: known misfit of the twin on every machine.
    """
    found: list[LinearThrow] = []
    for first in range(0, len(prepared), THROWS_COUNT):
        some = prepared[first : first + THROWS_COUNT]
        found += _linearise(some, profile, calibration, healthy)
    return found


def _linearise(
    prepared: Sequence[PreparedThrow],
    profile: TwinProfile,
    calibration: ValveCalibration,
    healthy: HealthyModel,
) -> list[LinearThrow]:
    inputs = [p.input for p in prepared]
    plan = SimulationBatch()
    parts: list[ThrowElements] = []
    for i in range(len(prepared)):
        bases = {view: plan.add(i, (), view) for view in ReplayKind}
        moves = perturbed_parameters(plan, i, (), library(), tuple(ReplayKind))
        parts.append(ThrowElements(bases, moves, perturbed_inputs(plan, inputs, i)))
    output = simulate(inputs, plan.elements, plan.views, profile, calibration)
    return [
        linear_throw(p, output, part, (), profile, healthy, None, {})
        for p, part in zip(prepared, parts, strict=True)
    ]


def relinearise(
    prepared: Sequence[PreparedThrow],
    profile: TwinProfile,
    calibration: ValveCalibration,
    healthy: HealthyModel,
    first: Sequence[LinearThrow],
    requests: Sequence[tuple[tuple[Effect, ...], Sequence[Parameter]]],
    views: Sequence[ReplayKind] | None = None,
    *,
    followed: Collection[ReplayKind] = (ReplayKind.ACTUATION,),
) -> Iterator[list[LinearThrow]]:
    """Every throw about several sets of effects, set after set, simulated together.

    Only the views that a set moves are simulated; the others are as in `first`. So are the slopes of
    parameters that are not wanted, except for those that follow the motion: behind valves that answer later
    or weaker the whole motion of the joint is later or weaker, and a late IMU reports the whole swing late.

    Args:
        prepared: the throws.
        profile: of the machine.
        calibration: of its valves.
        healthy: known misfit of the twin on every machine.
        first: linearised without effect.
        requests: effects about which to linearise, and the parameters whose slopes are wanted.
        views: to simulate; those that the wanted parameters move if left out.
        followed: views in which all slopes are taken about the set, where it moves them. Those of the swing
            cost some seconds per set.
    """
    inputs = [p.input for p in prepared]
    waiting = list(requests)
    while waiting:
        plan = SimulationBatch()
        shared: Shared = {}
        parts: list[list[ThrowElements]] = []
        while len(parts) < len(waiting) and len(plan.elements) < BATCH_COUNT:
            effects, wanted = waiting[len(parts)]
            moved = tuple(view for view in ReplayKind if any(view in p.views for p in wanted))
            about = effects, wanted, moved if views is None else tuple(views)
            throws = range(len(prepared))
            parts.append(
                [elements_about(plan, shared, i, *about, followed=followed) for i in throws]
            )
        output = simulate(inputs, plan.elements, plan.views, profile, calibration)
        known: Known = {}
        for (effects, _), row in zip(waiting, parts, strict=False):
            yield [
                linear_throw(p, output, part, effects, profile, healthy, before, known)
                for p, part, before in zip(prepared, row, first, strict=True)
            ]
        waiting = waiting[len(parts) :]
