"""Fit a joint's velocity response (dead time, second order, gain) to recorded motion.

Model, one joint: y'' = w^2 (g u(t - d) - y) - 2 z w y', with the commanded velocity u, the measured
velocity y, dead time d, natural frequency w, damping ratio z and gain g. Simulated exactly for inputs
held over a sample (zero-order hold). Functions load scipy's solvers themselves: every process that throws
imports this module, and scipy.signal takes seconds.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from machine.conventions import CONTROL_PERIOD_S, Array

DEAD_TIMES_S = np.arange(0.0, 0.41, 0.02)
"""Initial dead times of the search."""
LOWER = np.array([0.0, 0.5, 0.15, 0.3])
UPPER = np.array([0.6, 60.0, 3.0, 2.0])


@dataclass(frozen=True)
class ResponseFit:
    """Fitted response of one joint; `r2_ratio` is the coefficient of determination."""

    dead_time_s: float
    natural_frequency_rad_per_s: float
    damping_ratio: float
    gain_ratio: float
    r2_ratio: float
    residual_rad_m_per_s: float
    """Root mean square of the residual."""


def simulate_response(
    command: Array,
    dead_time_s: float,
    natural_frequency_rad_per_s: float,
    damping_ratio: float,
    gain_ratio: float,
    period_s: float = CONTROL_PERIOD_S,
) -> Array:
    """Velocity (runs, ticks) of the model for commands (runs, ticks), from rest."""
    from scipy.signal import cont2discrete, lfilter

    whole, fraction = divmod(dead_time_s / period_s, 1.0)
    padded = np.pad(command, ((0, 0), (int(whole) + 1, 0)))[:, : command.shape[1] + 1]
    delayed = padded[:, 1:] + fraction * (padded[:, :-1] - padded[:, 1:])
    w, z = natural_frequency_rad_per_s, damping_ratio
    system = ([gain_ratio * w * w], [1.0, 2.0 * z * w, w * w])
    discrete: Any = cont2discrete(system, period_s, method="zoh")
    numerator, denominator = discrete[0], discrete[1]
    response: Any = lfilter(np.ravel(numerator), denominator, delayed, axis=1)
    return response


def fit_response(
    command: Array, velocity: Array, period_s: float = CONTROL_PERIOD_S
) -> ResponseFit:
    """Least-squares fit over all runs; both arrays (runs, ticks), rad/s or m/s, each run from rest.

    Raises:
        ValueError: the command is constant.
    """
    from scipy.optimize import least_squares

    if float(np.std(command)) < 1e-4:
        raise ValueError("the commanded velocity is constant: nothing to identify, record a motion")

    def residual(parameters: Array) -> Array:
        d, w, z, g = (float(value) for value in parameters)
        return (simulate_response(command, d, w, z, g, period_s) - velocity).ravel()

    starts = [np.array([d, 8.0, 0.7, 1.0]) for d in DEAD_TIMES_S]
    best = min(starts, key=lambda start: float(np.sum(residual(start) ** 2)))
    scale = np.array([0.02, 3.0, 0.3, 0.2])
    fits: list[Any] = [
        least_squares(residual, start, bounds=(LOWER, UPPER), x_scale=scale, max_nfev=25)
        for start in (best, best * np.array([1.0, 2.0, 1.5, 1.0]))
    ]
    fit = min(fits, key=lambda candidate: float(candidate.cost))
    error = residual(fit.x)
    d, w, z, g = (float(value) for value in fit.x)
    return ResponseFit(
        dead_time_s=d,
        natural_frequency_rad_per_s=w,
        damping_ratio=z,
        gain_ratio=g,
        r2_ratio=1.0 - float(np.sum(error**2) / np.sum((velocity - velocity.mean()) ** 2)),
        residual_rad_m_per_s=float(np.sqrt(np.mean(error**2))),
    )
