"""What a healthy machine of another type may be off by, and how near its own throws show it to be.

What the type's machines have in common does not hold for a machine of another type. It may be off by what the
type is off, and by some of the library's tolerance; or it may be much nearer. An effect sits in one place:
what all the other parameters are off by tells how near a machine is, and how far one of them may be off
before it is an effect.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from diagnosis.causes.evidence import Information, screen
from diagnosis.causes.parameters import layout, library
from diagnosis.causes.selection import search
from diagnosis.causes.shapes import unheard_least_sd, unheard_names
from diagnosis.healthy.noise import NoiseModel, Scatter
from diagnosis.healthy.own_sensors import LATE_KEYS, SWINGS_MORE
from machine.conventions import ACTIVE_JOINTS, Array
from machine.spec import load_spec
from sim_twin.effects.table import effects_where

LAG_RATIO = 0.1
"""Of a drive's lag: by how much that of another machine is off (by eye)."""
LEAST_SHAPE_S = 0.015
"""By how much a drive may start later and come up faster, or the other way round (by eye): another valve has
another order of its response. The mean delay stays."""
CLOCK_SD_S = 0.006
"""Sensors of another machine have filters and buses of their own (by eye)."""
COMMON_CLOCK_SD_S = 0.008
"""All sensors may be late together by it, if all that is commanded is as much earlier: no log tells that
(docs/diagnosis.md), but noise in measured joints does as if, since a later twin is a smoother one."""
LEAST_VISCOUS_PER_S = 0.015
"""Healthy strangers whose gripper was integrated in steps of 1 and 2 ms have 0.013 to 0.030 more than their
twin, and 0 to 0.027 rad/s2 less dry friction (eight sets of three plants)."""
LEAST_DEAD_BAND_RATIO = 0.008
"""Another valve's overlap is not the table's to 0.5 %: two strangers had 0.02 to 0.035 at the slew or the
telescope, beside nothing or beside another effect. With 0.012 a slew's limit of 0.4 gets a hysteresis beside
it (tests/diagnosis/test_other_plant.py)."""
DRIFT_SD: Final = {
    f"joint_sensor_bias.{joint}.bias_rad_m": 0.015 if joint == "telescope" else 0.006
    for joint in ACTIVE_JOINTS
}
"""What noise of joint sensors looks like goes with the motion, and may go with its order (by eye)."""
LEVEL_SD = 0.06
"""Of the log power that a block leaves: how much joints, or axes, of a stranger are unlike (by eye)."""
NEARNESS_RATIOS = (1.0, 0.5, 0.25)
"""Of how far the type's drives are off: what is tried for a stranger's (by eye)."""
_DRIVES: Final = {p.key for p in library() if p.stage == "actuation"}
_SENSORS: Final = {key.format(j) for key in LATE_KEYS for j in ACTIVE_JOINTS} | set(SWINGS_MORE)
"""Whose scatter from set to set is that of these very throws' sensors."""


def stranger(model: NoiseModel, drives_ratio: Sequence[float]) -> NoiseModel:
    """The model for a machine of another type: each parameter by itself, but for clocks and responses.

    Args:
        model: of the type.
        drives_ratio: how far each driven joint's drive (4,) is off, over those of the type.
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


def as_near_as_shown(model: NoiseModel, data: Information) -> NoiseModel:
    """The stranger whose drives are as near to the twin's as makes these throws most probable.

    With any effect, or two: an effect shall not make a stranger of the machine that has it. And one joint may
    be as far off as any of the type while the others tell how near the drives are, because not every effect
    shows in slopes.

    Args:
        model: of the type.
        data: what all throws say at "no effect".
    """
    alike = len(ACTIVE_JOINTS)
    shown: dict[float, float] = {}
    for ratio in NEARNESS_RATIOS:
        drives = [[ratio] * alike]
        if ratio < 1.0:
            drives += [[1.0 if i == odd else ratio for i in range(alike)] for odd in range(alike)]
        shown[ratio] = max(_log_evidence(data, stranger(model, one)) for one in drives)
    return stranger(model, [max(shown, key=lambda ratio: shown[ratio])] * alike)


def _log_evidence(data: Information, model: NoiseModel) -> float:
    """Of throws of a machine with any two effects, or less."""
    priors = layout(model).priors
    base = screen(data, priors)
    sets = search(base, priors, range(len(priors.groups)), largest=2)
    return base.log_evidence + float(np.logaddexp.reduce([one.log_odds for one in sets]))


def _drive(name: str) -> str:
    """The driven joint whose drive a parameter is about; "" for all else."""
    if name not in _DRIVES:
        return ""
    return next((joint for joint in ACTIVE_JOINTS if f".{joint}." in name), "")


def _least_sd(names: Sequence[str]) -> Array:
    """What any other machine may be off by (p,)."""
    least = dict(zip(unheard_names(), unheard_least_sd().tolist(), strict=True))
    least |= {p.key: p.tolerance for p in library()}
    # Of the type's machines, what noise of their sensors looks like is part of the mean.
    least |= dict(SWINGS_MORE)
    least |= {name: max(least[name], CLOCK_SD_S) for name in _clocks()}
    least["passive_viscous_friction.extra_viscous_per_s"] = LEAST_VISCOUS_PER_S
    bands = [p.key for p in library() if p.effect == "valve_dead_band"]
    least |= dict.fromkeys(bands, LEAST_DEAD_BAND_RATIO)
    for joint, lag_s in zip(ACTIVE_JOINTS, load_spec().response.lag_s, strict=True):
        name = f"valve_lag.{joint}.extra_lag_s"
        least[name] = max(least[name], LAG_RATIO * lag_s)
    return np.array([least.get(name, 0.0) for name in names])


def _clocks() -> list[str]:
    """Keys of the latencies of all sensors that move with the arm."""
    late = effects_where(lambda effect: effect.stage == "aim" and effect.growth == "delay")
    return [p.key for p in library() if p.effect in late]


def _together() -> list[dict[str, float]]:
    """What parameters are off by together, one standard deviation each."""
    commands = [f"valve_dead_time.{joint}.extra_dead_time_s" for joint in ACTIVE_JOINTS]
    commands.append("release_delay.extra_delay_s")
    common = dict.fromkeys(_clocks(), COMMON_CLOCK_SD_S)
    found = [common | dict.fromkeys(commands, -COMMON_CLOCK_SD_S)]
    for joint, lag_s in zip(ACTIVE_JOINTS, load_spec().response.lag_s, strict=True):
        later_s = max(LEAST_SHAPE_S, LAG_RATIO * lag_s)
        names = f"valve_dead_time.{joint}.extra_dead_time_s", f"valve_lag.{joint}.extra_lag_s"
        found.append(dict(zip(names, (later_s, -later_s), strict=True)))
    return found
