"""Deviations that a healthy machine of another type may have, and how close its own throws show it to be.

The deviations that machines of the type share do not hold for another type. Such a machine may deviate as
the type does and by part of the library's tolerance, or it may be much closer to its twin. An effect acts
in one place. The deviations of all other parameters show how close a machine is, and thereby how far one of
them may deviate before it is an effect.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from diagnosis.healthy.noise import NoiseModel, Scatter
from diagnosis.healthy.sensor_noise import LATE_KEYS, NOISE_LIKE_SD
from diagnosis.inference.evidence import Information, screen
from diagnosis.inference.model_selection import search
from diagnosis.linearisation.parameters import layout, library
from diagnosis.linearisation.unmodelled_effects import unmodelled_least_sd, unmodelled_names
from diagnosis.tuning import (
    CLOCK_SD_S,
    COMMON_CLOCK_SD_S,
    DRIVE_RATIOS,
    LAG_RATIO,
    LEAST_DEAD_BAND_RATIO,
    LEAST_SHAPE_S,
    LEAST_VISCOUS_PER_S,
    LEVEL_SD,
)
from machine.conventions import ACTIVE_JOINTS, Array
from machine.spec import load_spec
from sim_twin.effects.table import effects_where

DRIFT_SD: Final = {
    f"joint_sensor_bias.{joint}.bias_rad_m": 0.015 if joint == "telescope" else 0.006
    for joint in ACTIVE_JOINTS
}
"""Drift of the joint sensors' biases, rad or m: noise of joint sensors acts like a bias that follows the
motion."""
_DRIVES: Final = {p.key for p in library() if p.stage == "actuation"}
_SENSORS: Final = {key.format(j) for key in LATE_KEYS for j in ACTIVE_JOINTS} | set(NOISE_LIKE_SD)
"""Parameters whose scatter between sets is that of these throws' sensors."""


def other_type_model(model: NoiseModel, drives_ratio: Sequence[float]) -> NoiseModel:
    """The model for a machine of another type: parameters are independent, except for clocks and responses.

    Args:
        model: of the type.
        drives_ratio: deviation of each driven joint's drive (4,) relative to that of the type.
    """
    names = model.machine_scatter.names
    mean = np.array([model.healthy_mean.get(name, 0.0) for name in names])
    of_type = np.diag(model.machine_scatter.covariance(names)) + mean**2
    by_joint = dict(zip(ACTIVE_JOINTS, drives_ratio, strict=True)) | {"": 1.0}
    ratio = np.array([by_joint[_drive(name)] for name in names])
    covariance = np.diag(_least_sd(names) ** 2 + ratio**2 * of_type)
    for together in _together():
        moved = np.array([together.get(name, 0.0) for name in names])
        covariance += np.outer(moved, moved)
    set_scatter = model.set_scatter
    for name, share in zip(names, ratio, strict=True):
        if name not in _SENSORS:
            set_scatter = set_scatter.with_sd(name, share * set_scatter.sd_of(name))
    return model.model_copy(
        update={
            "drift_sd": {**model.drift_sd, **DRIFT_SD},
            "healthy_mean": {},
            "machine_scatter": Scatter.of(names, covariance),
            "set_scatter": set_scatter,
            "unknown_level": {
                name: (middle, float(np.hypot(sd, LEVEL_SD)))
                for name, (middle, sd) in model.unknown_level.items()
            },
        }
    )


def fitted_other_type_model(model: NoiseModel, data: Information) -> NoiseModel:
    """The model of another type whose drives' deviation makes these throws most probable.

    The evidence includes any set of up to two effects, so that an effect does not widen the deviations of
    its own machine. One joint may deviate as far as the type while the others show how close the drives
    are, because not every effect shows in slopes.

    Args:
        model: of the type.
        data: information of all throws at "no effect".
    """
    alike = len(ACTIVE_JOINTS)
    shown: dict[float, float] = {}
    for ratio in DRIVE_RATIOS:
        drives = [[ratio] * alike]
        if ratio < 1.0:
            drives += [[1.0 if i == odd else ratio for i in range(alike)] for odd in range(alike)]
        shown[ratio] = max(_log_evidence(data, other_type_model(model, one)) for one in drives)
    return other_type_model(model, [max(shown, key=lambda ratio: shown[ratio])] * alike)


def _log_evidence(data: Information, model: NoiseModel) -> float:
    """Of throws of a machine with any set of up to two effects."""
    priors = layout(model).priors
    base = screen(data, priors)
    sets = search(base, priors, range(len(priors.groups)))
    return base.log_evidence + float(np.logaddexp.reduce([one.log_odds for one in sets]))


def _drive(name: str) -> str:
    """The driven joint that a drive parameter belongs to; "" for other parameters."""
    if name not in _DRIVES:
        return ""
    return next((joint for joint in ACTIVE_JOINTS if f".{joint}." in name), "")


def _least_sd(names: Sequence[str]) -> Array:
    """Least standard deviations (p,) of a machine of another type."""
    least = dict(zip(unmodelled_names(), unmodelled_least_sd().tolist(), strict=True))
    least |= {p.key: p.tolerance for p in library()}
    # For machines of the type, the apparent effect of sensor noise is part of the mean.
    least |= dict(NOISE_LIKE_SD)
    least |= {name: max(least[name], CLOCK_SD_S) for name in _clocks()}
    least["passive_viscous_friction.extra_viscous_per_s"] = LEAST_VISCOUS_PER_S
    bands = [p.key for p in library() if p.effect == "valve_dead_band"]
    least |= dict.fromkeys(bands, LEAST_DEAD_BAND_RATIO)
    for joint, lag_s in zip(ACTIVE_JOINTS, load_spec().response.lag_s, strict=True):
        name = f"valve_lag.{joint}.extra_lag_s"
        least[name] = max(least[name], LAG_RATIO * lag_s)
    return np.array([least.get(name, 0.0) for name in names])


def _clocks() -> list[str]:
    """Latencies of all sensors that move with the arm."""
    late = effects_where(lambda effect: effect.stage == "aim" and effect.growth == "delay")
    return [p.key for p in library() if p.effect in late]


def _together() -> list[dict[str, float]]:
    """Joint deviations of several parameters, one standard deviation each."""
    commands = [f"valve_dead_time.{joint}.extra_dead_time_s" for joint in ACTIVE_JOINTS]
    commands.append("release_delay.extra_delay_s")
    common = dict.fromkeys(_clocks(), COMMON_CLOCK_SD_S)
    found = [common | dict.fromkeys(commands, -COMMON_CLOCK_SD_S)]
    for joint, lag_s in zip(ACTIVE_JOINTS, load_spec().response.lag_s, strict=True):
        later_s = max(LEAST_SHAPE_S, LAG_RATIO * lag_s)
        names = f"valve_dead_time.{joint}.extra_dead_time_s", f"valve_lag.{joint}.extra_lag_s"
        found.append(dict(zip(names, (later_s, -later_s), strict=True)))
    return found
