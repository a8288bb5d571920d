"""How well the model of healthy machines fits this machine, judged by its own throws.

Filters, noise and scatter were learned on one type of machine in one simulator. Another machine may be
further from its twin in everything, or closer; the model is then scaled. An effect acts at one joint or in
one stage. A deviation that all joints, or all axes, share is a misfit of the model and not an effect.
"""

from collections.abc import Sequence

import numpy as np

from diagnosis.healthy.filters import HealthyModel, correction
from diagnosis.healthy.noise import NoiseModel
from diagnosis.inference.evidence import Priors, screen, total
from diagnosis.linearisation.parameters import joint_index
from diagnosis.linearisation.residual_power import residual_power
from diagnosis.linearisation.sensitivities import LinearThrow
from diagnosis.linearisation.whitening import Whitened, information
from diagnosis.loading.prepared import AXES, PreparedThrow
from diagnosis.tuning import CLEAR_LOG_POWER
from machine.conventions import ACTIVE_JOINTS

LEAST_MISFIT_RATIO = 0.5
"""Least factor: no twin is closer to a machine, however quiet its sensors. Simulation steps of 10 ms limit
it."""
COMMON = {
    "actuation": tuple(f"actuation.{joint}" for joint in ACTIVE_JOINTS),
    "swing": tuple(f"swing.gyro.{axis}" for axis in AXES),
}
"""Blocks of which more than half must deviate before a stage counts as a misfit."""


def filters_help(
    prepared: Sequence[PreparedThrow], linear: Sequence[LinearThrow], healthy: HealthyModel
) -> bool:
    """Whether the healthy filters reduce the residual of this machine, averaged over its joints.

    Args:
        prepared: the throws.
        linear: at "no effect", with the filters.
        healthy: the filters.
    """
    gains: list[float] = []
    for name in COMMON["actuation"]:
        before, after = 0.0, 0.0
        for p, one in zip(prepared, linear, strict=True):
            block, joint = p.block(name), joint_index(name.partition(".")[2])
            if block is None:
                continue
            track = correction(healthy, p.motion, joint, one.predicted_velocity[:, joint])
            moved = p.joint_pair @ np.interp(p.joint_at_s, p.motion.t_s, track)
            after += float(np.nansum(one.residual[block.rows] ** 2))
            before += float(np.nansum((one.residual[block.rows] + moved) ** 2))
        if before > 0.0 and after > 0.0:
            gains.append(float(np.log(before / after)))
    return not gains or float(np.mean(gains)) >= 0.0


def misfit(
    whitened: Sequence[Whitened],
    priors: Priors,
    model: NoiseModel,
    clear_log_power: float = CLEAR_LOG_POWER,
) -> dict[str, float]:
    """Ratio of a stage's discrepancy to that of healthy machines of the type; 1 unless it is significant.

    The lower median over a stage's blocks: an effect at one joint, or two, does not move it.
    """
    mean = screen(total(information(whitened)), priors).mean
    power: dict[str, tuple[float, int]] = {}
    for one in whitened:
        for name, (square, count) in residual_power(one, mean).items():
            before = power.get(name, (0.0, 0))
            power[name] = before[0] + square, before[1] + count
    found: dict[str, float] = {}
    for stage, names in COMMON.items():
        excess = sorted(
            float(np.log(power[name][0] / power[name][1])) - model.unknown_level[name][0]
            for name in names
            if name in power and power[name][0] > 0.0 and name in model.unknown_level
        )
        middle = excess[(len(excess) - 1) // 2] if excess else 0.0
        ratio = max(float(np.exp(0.5 * middle)), LEAST_MISFIT_RATIO)
        found[stage] = ratio if abs(middle) > clear_log_power else 1.0
    return found


def scaled_to(model: NoiseModel, factors: dict[str, float]) -> NoiseModel:
    """The noise model with the discrepancy of each stage multiplied by these factors."""
    channels = {
        name: channel.model_copy(
            update={
                field: getattr(channel, field) * factors.get(name.partition(".")[0], 1.0)
                for field in ("floor_sd", "rate_ratio", "push_ratio")
            }
        )
        for name, channel in model.channels.items()
    }
    return model.model_copy(update={"channels": channels})
