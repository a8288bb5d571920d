"""Least squares with bounds, by simulations of many sets of parameters at once.

A simulation takes about as long for one set as for ten: sets that may be needed are simulated together.
"""

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from machine.conventions import Array, IntArray

DAMPINGS_COUNT: Final = 6
"""Of an iteration, each ten times the one before."""
TOLERANCE_RATIO: Final = 1e-5
"""Of the sum of squares: an iteration that gains less is the last."""
Residuals = Callable[[Array], Array]
"""Residuals (sets, samples) of parameters (sets, parameters)."""


class Solved(NamedTuple):
    """Where the search ended."""

    x: Array
    """(parameters,)"""
    cost: float
    """Sum of squares."""


class _Quadratic(NamedTuple):
    """The sum of squares about a point, in its scaled free parameters."""

    x: Array
    free: IntArray
    scale: Array
    curvature: Array
    slope: Array

    def moved(self, damping: float, low: Array, high: Array) -> Array:
        """Its damped minimum, cut at the bounds."""
        step = np.zeros_like(self.x)
        damped = self.curvature + damping * np.eye(len(self.free))
        step[self.free] = np.linalg.solve(damped, self.slope) / self.scale
        return np.clip(self.x + step, low, high)


class _Moved(NamedTuple):
    x: Array
    residual: Array
    cost: float
    damping: float
    """For the next iteration."""


def solve(function: Residuals, x0: Array, low: Array, high: Array, limit: int) -> Solved:
    """Levenberg-Marquardt with steps cut at the bounds; `limit` iterations.

    Parameters at a bound that the gradient pushes outwards are held (active set); the rest still moves.
    """
    x = x0
    residual = function(x[None])[0]
    cost = float(residual @ residual)
    damping = 1e-3
    for _ in range(limit):
        near = _quadratic(sensitivities(function, x, low, high, residual), residual, x, low, high)
        better = _first_better(function, near, low, high, damping, cost)
        if better is None:
            break
        improved = (cost - better.cost) / max(cost, 1e-300)
        x, residual, cost, damping = better
        if improved < TOLERANCE_RATIO:
            break
    return Solved(x, cost)


def _quadratic(J: Array, residual: Array, x: Array, low: Array, high: Array) -> _Quadratic:
    gradient = J.T @ residual
    held = ((x <= low) & (gradient < 0.0)) | ((x >= high) & (gradient > 0.0))
    A = J.T @ J
    free = np.flatnonzero(~held)
    scale = np.sqrt(np.maximum(np.diag(A)[free], 1e-30))
    curvature = A[np.ix_(free, free)] / np.outer(scale, scale)
    return _Quadratic(x, free, scale, curvature, gradient[free] / scale)


def _first_better(
    function: Residuals, near: _Quadratic, low: Array, high: Array, damping: float, cost: float
) -> _Moved | None:
    """The least damped step that leaves less: the first alone, as it mostly does, then the others at once."""
    dampings = [damping]
    for _ in range(DAMPINGS_COUNT - 1):
        dampings.append(min(10.0 * max(dampings[-1], 1e-6), 1e9))
    for tried in (dampings[:1], dampings[1:]):
        places = np.stack([near.moved(one, low, high) for one in tried])
        for one, x, residual in zip(tried, places, function(places), strict=True):
            left = float(residual @ residual)
            if left < cost:
                return _Moved(x, residual, left, max(0.1 * one, 1e-9))
    return None


def sensitivities(function: Residuals, x: Array, low: Array, high: Array, residual: Array) -> Array:
    """Sensitivities d simulated / d parameter = - d residual / d parameter, (samples, parameters).

    Steps of 0.3 % are wide enough to cross the kinks of dead bands and of delays within a tick.
    """
    step = 3e-3 * np.maximum(np.abs(x), 0.01 * np.minimum(high - low, 10.0))
    step = np.where(x + step > high, -step, step)
    moved = function(x + np.diag(step))
    return (residual - moved).T / step
