"""Metadata of a throw log: impact, target, valve calibration and the twin profile of the preview.

Metadata that is missing or cannot be read is refused with the reason.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from diagnosis.loading.log_checks import RefusedLogError
from machine.calibration import ValveCalibration
from machine.conventions import Array
from runtime.records.throw_log import ThrowLog
from sim_twin.twin.profile import TwinProfile


def impact_of(log: ThrowLog, start_ns: int, notes: list[str]) -> tuple[Array, float, float]:
    """Impact (3,) m, its standard deviation m and its time s; nan when it was not surveyed."""
    if log.impact is None:
        return np.full(3, math.nan), math.nan, math.nan
    position = np.asarray(log.impact.position_m, dtype=np.float64)
    if not np.all(np.isfinite(position)):
        notes.append("the impact's survey is not a number and was left out")
        return np.full(3, math.nan), math.nan, math.nan
    time_s = (log.impact_t_mono_ns - start_ns) * 1e-9 if log.impact_t_mono_ns else math.nan
    if not math.isnan(time_s) and not 0.0 < time_s < 60.0:
        raise RefusedLogError(
            f"the impact lies {time_s:.3g} s after the throw's start: the survey has another clock, or "
            "the clock jumped. Record with the machine's monotonic clock"
        )
    return position, float(log.impact.sd_m), time_s


def target_of(metadata: Mapping[str, Any]) -> Array:
    """The target (3,) in frame `machine`, m."""
    target = metadata.get("target") or {}
    try:
        values = [float(target[name]) for name in ("x_m", "y_m", "z_m")]
    except (KeyError, TypeError, ValueError):
        values = [math.nan]
    if not all(math.isfinite(value) for value in values):
        raise RefusedLogError(
            f"its target is {target!r}; {{x_m, y_m, z_m}} in frame machine is needed"
        )
    return np.asarray(values)


def calibration_of(metadata: Mapping[str, Any]) -> ValveCalibration:
    """The valve calibration that the machine threw with."""
    try:
        return ValveCalibration.model_validate(metadata.get("calibration"))
    except ValueError as error:
        raise RefusedLogError(
            "it carries no valve calibration, without which commands mean nothing; record with a "
            "calibrated machine (`downrange calibrate`)"
        ) from error


def profile_of(metadata: Mapping[str, Any]) -> TwinProfile | None:
    """The twin profile that previewed the throw; None if the log has none."""
    profile = metadata.get("twin_profile")
    if profile is None:
        return None
    try:
        return TwinProfile.model_validate(profile)
    except ValueError as error:
        raise RefusedLogError(f"its twin profile cannot be read: {error}") from error
