"""Uncertainty of fitted parameters: standard errors and 90 % intervals.

Correlated residuals, errors of the time stamps, and parameters without a gradient are accounted for.
"""

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
from scipy.stats import t as student_t

from diagnosis.single_stage.fit import StructureFit, parameter_bounds, structure_parameters
from diagnosis.single_stage.fit_problem import FitProblem
from machine.conventions import Array, IntArray

DEAD_TIME_PARAMETER: Final = "valve_dead_time.extra_dead_time_s"
DEAD_TIME_PARAMETERS: Final = frozenset(
    {
        DEAD_TIME_PARAMETER,
        "valve_dead_time_two_sided.positive_dead_time_s",
        "valve_dead_time_two_sided.negative_dead_time_s",
    }
)
LAG_PARAMETERS: Final = frozenset(
    f"{key}.extra_lag_s" for key in ("valve_lag", "valve_lag_two_sided")
)
PROFILE_POINTS_COUNT: Final = 81
"""Points of the profile likelihood of a threshold parameter."""
PROFILE_RANGE_RATIO: Final = 4.0
"""The profile extends from a quarter to four times the fitted value."""
PROFILE_RISE_90: Final = 2.71
"""Rise of twice the negative log-likelihood at the ends of a 90 % interval: the 0.90 quantile of chi2(1)."""


def estimate_standard_errors(
    problem: FitProblem, found: StructureFit, correlation_samples: float
) -> Array:
    """Standard error of each parameter, (parameters,), for correlated residuals.

    The larger of two estimates: the white-noise covariance times the residual's correlation length, and the
    cluster-robust sandwich A^-1 (sum_b g_b g_b') A^-1 over blocks, g_b = J_b' r_b (Liang and Zeger 1986).
    """
    J, r = found.jacobian, found.residual
    scale = np.maximum(np.linalg.norm(J, axis=0), 1e-12)
    Js = J / scale
    freedom = max(len(r) / correlation_samples - len(scale), 1.0)
    noise = float(np.sum(r**2)) / freedom
    known = {p.name: p.prior_sd for p in problem.nuisance}
    prior = np.array([known.get(name, math.inf) for name in found.names]) ** -2.0
    inverse = np.linalg.pinv(Js.T @ Js + np.diag(noise * prior / scale**2), rcond=1e-10)
    white = np.sqrt(np.maximum(np.diag(inverse), 0.0) * noise)
    blocks = np.unique(problem.block)
    gradients = np.stack([Js[problem.block == b].T @ r[problem.block == b] for b in blocks])
    meat = gradients.T @ gradients * len(blocks) / max(len(blocks) - 1, 1)
    robust = np.sqrt(np.maximum(np.diag(inverse @ meat @ inverse), 0.0))
    return np.maximum(white, robust) / scale


def interval_half_width_factor(problem: FitProblem) -> float:
    """Half width of a 90 % interval in standard errors, with the number of blocks as degrees of freedom."""
    return float(student_t.ppf(0.95, max(len(np.unique(problem.block)) - 1, 2)))


def estimate_correlation_samples(residual: Array, block: IntArray) -> float:
    """Integrated autocorrelation time in samples, 1 + 2 sum rho_k until rho_k <= 0.05; at least 1."""
    count = len(residual)
    centred = residual - np.mean(residual)
    power = float(np.mean(centred**2))
    if power <= 0.0 or count < 8:
        return 1.0
    total = 1.0
    for lag in range(1, count // 4):
        same = block[lag:] == block[:-lag]
        if not np.any(same):
            break
        rho = float(np.mean((centred[lag:] * centred[:-lag])[same])) / power
        if rho <= 0.05:
            break
        total += 2.0 * rho
    return min(total, count / 8.0)


def parameter_intervals(
    problem: FitProblem, correlation_samples: float, found: StructureFit
) -> Mapping[str, tuple[float, float]]:
    """90 % interval of each parameter of a fit, by name, within its bounds.

    The interval of the dead time, or else of the lag, is widened by the error of the command's time stamps.
    Intervals of threshold parameters include their profile likelihood.
    """
    half = estimate_standard_errors(
        problem, found, correlation_samples
    ) * interval_half_width_factor(problem)
    half = np.hypot(half, problem.simulation_error_ratio * found.values)
    delays = DEAD_TIME_PARAMETERS if DEAD_TIME_PARAMETERS & set(found.names) else LAG_PARAMETERS
    half = np.where(
        [name in delays for name in found.names], half + problem.timestamp_error_s, half
    )
    if problem.timestamp_error_s > 0.0 and not (delays | DEAD_TIME_PARAMETERS) & set(found.names):
        half = half + _estimate_timestamp_shift(problem, found)
    low, high = parameter_bounds(problem, found)
    thresholds = {
        name for name, p in structure_parameters(problem, found.options).items() if p.is_threshold
    }
    ranges: dict[str, tuple[float, float]] = {}
    for name, value, h, least, most in zip(found.names, found.values, half, low, high, strict=True):
        ends = (value - h, value + h)
        if name in thresholds:
            tried = _profile_interval(problem, correlation_samples, found, name)
            ends = (min(ends[0], tried[0]), max(ends[1], tried[1]))
        ranges[name] = (float(max(ends[0], least)), float(min(ends[1], most)))
    return ranges


def _estimate_timestamp_shift(problem: FitProblem, found: StructureFit) -> Array:
    """Linearised shift of each parameter, (parameters,), under the error of the command's time stamps.

    Without a fitted delay other parameters absorb it.
    """
    # A delay below one tick does not move a rate-limited response: twice the error is simulated, then halved.
    delayed = problem.residuals(
        [{**found.as_mapping(), DEAD_TIME_PARAMETER: 2.0 * problem.timestamp_error_s}]
    )[0]
    scale = np.maximum(np.linalg.norm(found.jacobian, axis=0), 1e-12)
    moved, *_ = np.linalg.lstsq(
        found.jacobian / scale, 0.5 * (delayed - found.residual), rcond=1e-8
    )
    return np.abs(moved) / scale


def _profile_interval(
    problem: FitProblem, correlation_samples: float, found: StructureFit, name: str
) -> tuple[float, float]:
    """Ends of a threshold's profile-likelihood interval, with the other parameters fixed.

    Between two command sizes that occur in the record a threshold changes nothing, so it has no gradient.
    """
    best = found.as_mapping()
    tried = best[name] * np.geomspace(
        1.0 / PROFILE_RANGE_RATIO, PROFILE_RANGE_RATIO, PROFILE_POINTS_COUNT
    )
    residual = problem.residuals([{**best, name: value} for value in tried.tolist()])
    squares = np.mean(residual**2, axis=1)
    independent = len(found.residual) / correlation_samples
    is_bad = squares > found.mean_square * math.exp(PROFILE_RISE_90 / independent)
    middle = PROFILE_POINTS_COUNT // 2
    below, above = np.flatnonzero(is_bad[:middle]), np.flatnonzero(is_bad[middle + 1 :])
    # The first value that is worse bounds the interval from outside.
    return (
        float(tried[below[-1]] if below.size else tried[0]),
        float(tried[middle + 1 + above[0]] if above.size else tried[-1]),
    )
