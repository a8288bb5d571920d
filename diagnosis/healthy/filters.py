"""Known misfit of the twin on a healthy machine: a learned correction of the driven joints' velocities.

The twin's drives have neither pressures nor a shared pump. What that leaves between twin and machine is the
same on all machines of the type and would look like an effect. It is learned as a linear filter (ridge
regression) on throws of healthy machines. Inputs are the twin's own prediction, the other joints' motion
and the swing, with delays up to 0.2 s. The joint's own measured motion is not an input, so that an effect
at this joint is not learned. Valve commands are not inputs, so that the correction follows what an effect
makes of the command. The weights are in filters.json; diagnosis/population/estimation.py estimates them.
"""

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict

from diagnosis.loading.measured import MeasuredMotion
from machine.conventions import ACTIVE_COUNT, ACTIVE_JOINTS, CONTROL_PERIOD_S, Array, IntArray

HEALTHY_PATH = Path(__file__).with_name("filters.json")
DELAYS_COUNT = (0, 4, 8, 14, 22)
"""Delays of the inputs, control ticks."""
BREAKAWAY_RAD_M_PER_S = 0.02
SLOW_RAD_M_PER_S = 0.05
RIDGE = 10.0
"""Prior precision of a weight on an input of unit variance, over the squared residual of one sample."""


class JointFilter(BaseModel):
    """Filter of one joint: inputs are centred, scaled and weighted."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    centre: tuple[float, ...]
    scale: tuple[float, ...]
    weight: tuple[float, ...]
    offset: float


class HealthyModel(BaseModel):
    """Filters of all driven joints."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    note: str
    joints: tuple[JointFilter, ...]


@cache
def load_healthy(path: Path = HEALTHY_PATH) -> HealthyModel:
    """Read the learned weights."""
    return HealthyModel.model_validate_json(path.read_text(encoding="utf-8"))


class _Inputs(NamedTuple):
    """Inputs of a joint's filter: each is a function of the twin's velocity times a track of the throw."""

    function: IntArray
    """(k,) which of `_functions`."""
    factor: Array
    """(k, T)"""


_ONE, _VELOCITY, _PUSH, _SQUARE, _SPEED, _MOVING, _DIRECTION = range(7)


def _functions(predicted: Array) -> Array:
    """Functions (7, ..., T) of the twin's velocities (..., T) of a joint."""
    speed = np.abs(predicted)
    return np.stack(
        [
            np.ones_like(predicted),
            predicted,
            np.gradient(predicted, CONTROL_PERIOD_S, axis=-1),
            predicted * speed,
            speed,
            np.clip(predicted / BREAKAWAY_RAD_M_PER_S, -1.0, 1.0),
            np.clip(predicted / SLOW_RAD_M_PER_S, -1.0, 1.0),
        ]
    )


def _inputs(motion: MeasuredMotion, joint: int) -> _Inputs:
    v, a, q = motion.velocity_rad_m_per_s, motion.acceleration_rad_m_per_s2, motion.position_rad_m
    reach = np.sin(q[:, 1] + q[:, 2]) * (2.0 + q[:, 3]) + 3.0 * np.cos(q[:, 1])
    others = [other for other in range(ACTIVE_COUNT) if other != joint]
    demand, alone = np.abs(v[:, others]).sum(axis=1), np.ones_like(reach)
    found = [
        (_VELOCITY, alone),
        (_PUSH, alone),
        (_SQUARE, alone),
        (_SPEED, alone),
        (_VELOCITY, reach),
        (_SPEED, reach),
        (_VELOCITY, demand),
        (_SPEED, demand),
        (_MOVING, alone),
    ]
    for other in others:
        speed = np.abs(v[:, other])
        found += [(_ONE, v[:, other]), (_ONE, a[:, other]), (_ONE, speed)]
        found += [(_VELOCITY, v[:, other]), (_DIRECTION, speed)]
    swing_push = np.gradient(motion.swing_rate_rad_per_s, CONTROL_PERIOD_S, axis=0)
    found += [(_ONE, one) for one in (*motion.swing_rate_rad_per_s.T, *swing_push.T)]
    return _Inputs(np.array([f for f, _ in found]), np.stack([track for _, track in found]))


def inputs(motion: MeasuredMotion, joint: int, predicted: Array) -> Array:
    """Inputs (T, k) of a joint's filter at the ticks, for every delay of `DELAYS_COUNT`.

    Args:
        motion: measured.
        joint: whose velocity is corrected.
        predicted: (T,) velocity of the twin, rad/s or m/s.
    """
    function, factor = _inputs(motion, joint)
    now = _functions(predicted)[function] * factor
    return np.vstack([_delayed(now, ticks) for ticks in DELAYS_COUNT]).T


def _delayed(tracks: Array, ticks: int) -> Array:
    """Tracks (..., T) delayed by some ticks; the first value fills the start."""
    first = np.repeat(tracks[..., :1], ticks, axis=-1)
    return np.concatenate([first, tracks[..., : tracks.shape[-1] - ticks]], axis=-1)


def correction(model: HealthyModel, motion: MeasuredMotion, joint: int, predicted: Array) -> Array:
    """Velocity of a healthy machine minus the twin's, for predictions (T,) or (m, T)."""
    found = model.joints[joint]
    weight = np.asarray(found.weight) / np.asarray(found.scale)
    if not weight.any():
        return np.zeros_like(predicted)
    function, factor = _inputs(motion, joint)
    functions = _functions(predicted)
    out = np.full(predicted.shape, found.offset - float(np.asarray(found.centre) @ weight))
    # Sum by function first: there are a hundred inputs, but seven functions of the prediction.
    is_of = np.eye(functions.shape[0])[:, function]
    for ticks, own in zip(DELAYS_COUNT, weight.reshape(len(DELAYS_COUNT), -1), strict=True):
        share = (is_of * own) @ factor
        out += _delayed(np.einsum("ft,f...t->...t", share, functions), ticks)
    return out


def learn(values: Sequence[Array], residuals: Sequence[Array], ridge: float = RIDGE) -> JointFilter:
    """Ridge regression of residuals (n,) on inputs (n, k), over all throws."""
    x, y = np.vstack(values), np.concatenate(residuals)
    centre, scale = x.mean(axis=0), x.std(axis=0) + 1e-9
    z = (x - centre) / scale
    offset = float(y.mean())
    weight = np.linalg.solve(z.T @ z + ridge * np.eye(z.shape[1]), z.T @ (y - offset))
    return JointFilter(
        centre=tuple(float(f"{v:.6g}") for v in centre),
        scale=tuple(float(f"{v:.6g}") for v in scale),
        weight=tuple(float(f"{v:.6g}") for v in weight),
        offset=offset,
    )


def sum_of(first: HealthyModel, second: HealthyModel) -> HealthyModel:
    """The model that corrects by as much as both together."""
    return second.model_copy(
        update={
            "joints": tuple(_sum_of(a, b) for a, b in zip(first.joints, second.joints, strict=True))
        }
    )


def _sum_of(first: JointFilter, second: JointFilter) -> JointFilter:
    """In the second's units: its centres and scales stay."""
    slope = np.asarray(first.weight) / np.asarray(first.scale)
    offset = first.offset + float((np.asarray(second.centre) - np.asarray(first.centre)) @ slope)
    weight = np.asarray(second.weight) + slope * np.asarray(second.scale)
    return second.model_copy(
        update={"weight": tuple(weight.tolist()), "offset": second.offset + offset}
    )


def nothing() -> HealthyModel:
    """A model without correction."""
    width = len(DELAYS_COUNT) * (9 + 5 * (ACTIVE_COUNT - 1) + 4)
    empty = JointFilter(
        centre=(0.0,) * width, scale=(1.0,) * width, weight=(0.0,) * width, offset=0.0
    )
    return HealthyModel(note="nothing", joints=(empty,) * len(ACTIVE_JOINTS))
