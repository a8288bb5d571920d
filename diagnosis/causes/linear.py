"""From a batch of simulations to a throw's residual and slopes, not whitened."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from diagnosis.causes.elements import (
    OPENING_STEP_S,
    SCALE_STEP_RATIO,
    START_RATE_STEP_RAD_PER_S,
    START_STEP_RAD,
    Part,
)
from diagnosis.causes.parameters import View, index_of, library
from diagnosis.healthy.filters import HealthyModel
from diagnosis.loading.prepared import PreparedThrow
from diagnosis.predictions import predict, view_of
from diagnosis.simulate import Simulated
from machine.ballistics import drag_per_m, landing
from machine.conventions import (
    ACTIVE_COUNT,
    ACTIVE_JOINTS,
    Array,
)
from machine.spec import load_spec
from sim_twin.effects.effect import Effect, resolve
from sim_twin.twin.profile import TwinProfile

LANDING_STEP = 1e-3
Predicted = Mapping[View, Mapping[int, Array]]
"""What the twin says of the throw's vector, by view and element."""
Known = dict[int, dict[int, Array]]
"""By the base of a throw's view: what the twin says of the throw's vector, by element."""


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


def carried(at: Linear, effects: Sequence[Effect], progress_ratio: float) -> Linear:
    """With the residual carried back from these effects to none, along the slopes where they are."""
    residual = at.residual.copy()
    for key, size in resolve(effects, progress_ratio).items():
        name = ".".join(part for part in key if part is not None)
        residual += at.jacobian[:, index_of()[name]] * size
    return replace(at, residual=residual)


def linear_of(
    prepared: PreparedThrow,
    output: Simulated,
    part: Part,
    effects: tuple[Effect, ...],
    profile: TwinProfile,
    healthy: HealthyModel,
    first: Linear | None,
    known: Known,
) -> Linear:
    """A throw's residual and slopes from the batch; what was not simulated is as in `first`."""
    predicted = _predicted(prepared, output, part, effects, healthy, known)
    velocity = np.zeros((0, ACTIVE_COUNT)) if first is None else first.predicted_velocity
    if View.ACTUATION in part.bases:
        rows = slice(prepared.motion.t_s.size)
        velocity = output.joint_velocity_rad_m_per_s[part.bases[View.ACTUATION], rows]
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
        np.zeros(residual.size),
    )


def _residual(
    prepared: PreparedThrow, predicted: Predicted, part: Part, first: Linear | None
) -> Array:
    """Measured minus twin (n,); what was not simulated is as in `first`."""
    residual = np.full(prepared.measured.size, np.nan) if first is None else first.residual.copy()
    for view, rows in predicted.items():
        for block in (b for b in prepared.blocks if view_of(b) is view):
            own = rows[part.bases[view]][block.rows]
            residual[block.rows] = prepared.measured[block.rows] - own
    return residual


def _jacobian(
    prepared: PreparedThrow,
    predicted: Predicted,
    part: Part,
    effects: tuple[Effect, ...],
    first: Linear | None,
) -> Array:
    """Slopes (n, p) by the parameters that moved; of others as in `first`, late where these effects are."""
    jacobian = np.zeros((prepared.measured.size, len(library())))
    if first is not None:
        jacobian = _reported_late(prepared, effects, first.jacobian)
    for (parameter, view), (element, step) in part.moves.items():
        slope = (predicted[view][element] - predicted[view][part.bases[view]]) / step
        joint = library()[parameter].joint
        for block in (b for b in prepared.blocks if view_of(b) is view):
            # Behind its valve a joint moves alone; only the IMU and the load feel the others.
            own = view is not View.ACTUATION or joint is None or block.name.endswith(joint)
            jacobian[block.rows, parameter] = np.nan_to_num(slope[block.rows]) if own else 0.0
    return jacobian


def _reported_late(prepared: PreparedThrow, effects: tuple[Effect, ...], slopes: Array) -> Array:
    """Slopes (n, p), those of the swing as an IMU reports them that these effects make late."""
    slopes = slopes.copy()
    sizes = resolve(effects, prepared.input.progress_ratio)
    latency_s = sizes.get(("imu_latency", None, "extra_latency_s"), 0.0)
    for block in prepared.blocks if latency_s > 0.0 else ():
        if view_of(block) is View.SWING:
            at_s = np.maximum(block.t_s - latency_s, block.t_s[0])
            rows = slopes[block.rows]
            known = rows.any(axis=0)
            rows[:, known] = CubicSpline(block.t_s, rows[:, known])(at_s)
    return slopes


def _input_slopes(
    prepared: PreparedThrow, predicted: Predicted, part: Part
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
    part: Part,
    effects: Sequence[Effect],
    healthy: HealthyModel,
    known: Known,
) -> dict[View, dict[int, Array]]:
    """What the twin says of the throw's vector (n,) in each simulated view, by element; adds to `known`."""
    elements: dict[View, list[int]] = {view: [base] for view, base in part.bases.items()}
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
    """Fill in, in place, what a delay of the opening does: delays add up without a simulation.

    Where no switch says when the load left, it is taken to leave when the profile says, and `opening` (n,)
    tells what the flight would be if it left later.
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
    """Impact (2,) by release position and velocity (6,), numerically, with the nominal drag."""
    ball = load_spec().ball
    state = np.concatenate([position_m, velocity_m_per_s])
    states = state + LANDING_STEP * np.vstack([np.zeros(6), np.eye(6)])
    end = landing(states[:, :3], states[:, 3:], height_m + ball.radius_m, drag_per_m(ball))
    return np.nan_to_num((end.position_m[1:, :2] - end.position_m[0, :2]).T / LANDING_STEP)
