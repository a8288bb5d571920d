"""What the twin is known to miss on a healthy machine: a learned correction of the driven joints' velocities.

The twin's drives know neither pressures nor the shared pump, and every machine of the type has both. What
that leaves between twin and machine is the same on all of them, and would look like an effect. It is
learned as a linear filter (ridge regression) on throws of healthy machines: from the twin's own
prediction, the other joints' motion and the swing, with delays up to 0.2 s. The joint's own measured motion
is no input, so that an effect at this joint cannot be taken for health; and no valve command is, so that
the correction moves with what an effect makes of the command (with commands among the inputs, a dead time
of 0.069 s was sized at 0.119 s).
The weights stand in filters.json; diagnosis/healthy/calibration.py made them.
"""

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict

from diagnosis.loading.measured import MeasuredMotion
from machine.conventions import ACTIVE_COUNT, ACTIVE_JOINTS, CONTROL_PERIOD_S, Array

HEALTHY_PATH = Path(__file__).with_name("filters.json")
DELAYS_COUNT = (0, 4, 8, 14, 22)
"""Of the inputs, control ticks."""
BREAKAWAY_RAD_M_PER_S = 0.02
SLOW_RAD_M_PER_S = 0.05
RIDGE = 10.0
"""Prior precision of a weight on an input of unit variance, over squared residual of one sample."""


class JointFilter(BaseModel):
    """Of one joint: inputs are centred and scaled, then weighted."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    centre: tuple[float, ...]
    scale: tuple[float, ...]
    weight: tuple[float, ...]
    offset: float


class HealthyModel(BaseModel):
    """Of all driven joints."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    note: str
    joints: tuple[JointFilter, ...]


@cache
def load_healthy(path: Path = HEALTHY_PATH) -> HealthyModel:
    """Read the learned weights."""
    return HealthyModel.model_validate_json(path.read_text(encoding="utf-8"))


def inputs(motion: MeasuredMotion, joint: int, predicted: Array) -> Array:
    """Inputs (T, k) of a joint's filter at the ticks.

    Args:
        motion: measured.
        joint: whose velocity is corrected.
        predicted: (T,) velocity that the twin gives it, rad/s or m/s.
    """
    v, a, q = motion.velocity_rad_m_per_s, motion.acceleration_rad_m_per_s2, motion.position_rad_m
    push = np.gradient(predicted, CONTROL_PERIOD_S)
    reach = np.sin(q[:, 1] + q[:, 2]) * (2.0 + q[:, 3]) + 3.0 * np.cos(q[:, 1])
    others = [other for other in range(ACTIVE_COUNT) if other != joint]
    demand = np.abs(v[:, others]).sum(axis=1)
    moving = np.clip(predicted / BREAKAWAY_RAD_M_PER_S, -1.0, 1.0)
    direction = np.clip(predicted / SLOW_RAD_M_PER_S, -1.0, 1.0)
    speed = np.abs(predicted)
    columns = [
        predicted,
        push,
        predicted * speed,
        speed,
        predicted * reach,
        speed * reach,
        predicted * demand,
        speed * demand,
        moving,
    ]
    for other in others:
        columns += [
            v[:, other],
            a[:, other],
            np.abs(v[:, other]),
            v[:, other] * predicted,
            np.abs(v[:, other]) * direction,
        ]
    swing_push = np.gradient(motion.swing_rate_rad_per_s, CONTROL_PERIOD_S, axis=0)
    now = np.column_stack([*columns, motion.swing_rate_rad_per_s, swing_push])
    return np.hstack([_delayed(now, ticks) for ticks in DELAYS_COUNT])


def _delayed(values: Array, ticks: int) -> Array:
    if ticks == 0:
        return values
    return np.vstack([np.repeat(values[:1], ticks, axis=0), values[:-ticks]])


def correction(model: HealthyModel, motion: MeasuredMotion, joint: int, predicted: Array) -> Array:
    """What a healthy machine's velocity is above the twin's, for predictions (T,) or (m, T)."""
    found = model.joints[joint]
    weight = np.asarray(found.weight) / np.asarray(found.scale)
    if not weight.any():
        return np.zeros_like(predicted)
    offset = found.offset - float(np.asarray(found.centre) @ weight)
    tracks = [inputs(motion, joint, one) @ weight + offset for one in np.atleast_2d(predicted)]
    return np.reshape(tracks, predicted.shape)


def learn(values: Sequence[Array], residuals: Sequence[Array]) -> JointFilter:
    """Ridge regression of residuals (n,) on inputs (n, k), over all throws."""
    x, y = np.vstack(values), np.concatenate(residuals)
    centre, scale = x.mean(axis=0), x.std(axis=0) + 1e-9
    z = (x - centre) / scale
    offset = float(y.mean())
    weight = np.linalg.solve(z.T @ z + RIDGE * np.eye(z.shape[1]), z.T @ (y - offset))
    return JointFilter(
        centre=tuple(float(f"{v:.6g}") for v in centre),
        scale=tuple(float(f"{v:.6g}") for v in scale),
        weight=tuple(float(f"{v:.6g}") for v in weight),
        offset=offset,
    )


def nothing() -> HealthyModel:
    """A model that corrects nothing, to begin the learning with."""
    width = len(DELAYS_COUNT) * (9 + 5 * (ACTIVE_COUNT - 1) + 4)
    empty = JointFilter(
        centre=(0.0,) * width, scale=(1.0,) * width, weight=(0.0,) * width, offset=0.0
    )
    return HealthyModel(note="nothing", joints=(empty,) * len(ACTIVE_JOINTS))
