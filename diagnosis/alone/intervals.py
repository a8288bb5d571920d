"""90 % intervals of what a stage's fit found, honest about residuals, time stamps and thresholds."""

import math
from collections.abc import Mapping
from typing import Final

import numpy as np

from diagnosis.alone.fit import Fit, bounds, interval_factor, parameters_of, standard_errors
from diagnosis.alone.problem import Problem
from machine.conventions import Array

DEAD_TIME: Final = "valve_dead_time.extra_dead_time_s"
LAGS: Final = frozenset(
    f"{key}.extra_lag_s" for key in ("valve_lag", "valve_lag_second", "valve_lag_two_sided")
)
TRIED_COUNT: Final = 81
TRIED_RATIO: Final = 4.0
"""Thresholds are tried from a quarter to four times the one that was found."""
RISE_90: Final = 2.71
"""Of twice the log-likelihood at the ends of a 90 % interval (Wilks)."""


def intervals(
    problem: Problem, correlation_samples: float, found: Fit
) -> Mapping[str, tuple[float, float]]:
    """90 % interval of each parameter of a fit, by name, within its bounds.

    What a wrong time stamp of the command is taken for, a dead time or else a lag, is wider by that time.
    """
    half = standard_errors(problem, found, correlation_samples) * interval_factor(problem)
    half = np.hypot(half, problem.accuracy_ratio * found.values)
    late = {DEAD_TIME} if DEAD_TIME in found.names else LAGS
    half = np.where([name in late for name in found.names], half + problem.timing_s, half)
    if problem.timing_s > 0.0 and not (late | {DEAD_TIME}) & set(found.names):
        half = half + _shift_of_late_command(problem, found)
    low, high = bounds(problem, found)
    thresholds = {
        name for name, p in parameters_of(problem, found.options).items() if p.is_threshold
    }
    ranges: dict[str, tuple[float, float]] = {}
    for name, value, h, least, most in zip(found.names, found.values, half, low, high, strict=True):
        ends = (value - h, value + h)
        if name in thresholds:
            tried = _as_good(problem, correlation_samples, found, name)
            ends = (min(ends[0], tried[0]), max(ends[1], tried[1]))
        ranges[name] = (float(max(ends[0], least)), float(min(ends[1], most)))
    return ranges


def _shift_of_late_command(problem: Problem, found: Fit) -> Array:
    """(parameters,) how far a command late by its time stamp's error moves them, linearly.

    Where no delay is fitted something else takes it: a servo that is told late seems faster than it is.
    """
    # A part of a tick does not delay what a rate limits: twice the error, a whole period, is simulated.
    late = problem.residuals([{**found.as_mapping(), DEAD_TIME: 2.0 * problem.timing_s}])[0]
    scale = np.maximum(np.linalg.norm(found.jacobian, axis=0), 1e-12)
    moved, *_ = np.linalg.lstsq(found.jacobian / scale, 0.5 * (late - found.residual), rcond=1e-8)
    return np.abs(moved) / scale


def _as_good(
    problem: Problem, correlation_samples: float, found: Fit, name: str
) -> tuple[float, float]:
    """Ends of the values about the found one that explain the data as well, up to chance.

    Between two sizes of steps that were tried a threshold changes nothing, and a slope says nothing about it.
    """
    best = found.as_mapping()
    tried = best[name] * np.geomspace(1.0 / TRIED_RATIO, TRIED_RATIO, TRIED_COUNT)
    residual = problem.residuals([{**best, name: value} for value in tried.tolist()])
    squares = np.mean(residual**2, axis=1)
    independent = len(found.residual) / correlation_samples
    is_bad = squares > found.mean_square * math.exp(RISE_90 / independent)
    middle = TRIED_COUNT // 2
    below, above = np.flatnonzero(is_bad[:middle]), np.flatnonzero(is_bad[middle + 1 :])
    # The next value tried was already worse: the end lies before it.
    return (
        float(tried[below[-1]] if below.size else tried[0]),
        float(tried[middle + 1 + above[0]] if above.size else tried[-1]),
    )
