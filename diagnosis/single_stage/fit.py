"""Bounded nonlinear least squares for nested model structures, with many parameter sets simulated at once.

A simulation of ten parameter sets takes about as long as one, so all sets of an iteration run together.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final, NamedTuple

import numpy as np

from diagnosis.single_stage.fit_problem import EffectOption, FitProblem, FreeParameter
from machine.conventions import Array, IntArray

DAMPING_STEPS_COUNT: Final = 6
"""Damping values tried per iteration, each ten times the one before."""
TOLERANCE_RATIO: Final = 1e-5
"""Relative reduction of the sum of squares below which the iteration stops."""
ResidualFunction = Callable[[Array], Array]
"""Residuals (sets, samples) of parameters (sets, parameters)."""
QUICK_ITERATIONS: Final = 5
"""Iterations of a preliminary fit."""
FULL_ITERATIONS: Final = 40
"""Iterations of a final fit."""
THRESHOLD_GRID_COUNT: Final = 16
"""Grid points of a threshold parameter."""
THRESHOLD_REFINEMENT_RATIO: Final = 1.25
"""Range of its second, finer grid, as a factor about the best coarse value."""


class SolverResult(NamedTuple):
    """Solution of a least-squares problem."""

    x: Array
    """(parameters,)"""
    cost: float
    """Sum of squares."""


class _LocalQuadratic(NamedTuple):
    """Second-order expansion of the sum of squares about a point, in its scaled free parameters."""

    x: Array
    free: IntArray
    scale: Array
    curvature: Array
    slope: Array

    def step_damped(self, damping: float, low: Array, high: Array) -> Array:
        """Damped minimum, clipped to the bounds."""
        step = np.zeros_like(self.x)
        damped = self.curvature + damping * np.eye(len(self.free))
        step[self.free] = np.linalg.solve(damped, self.slope) / self.scale
        return np.clip(self.x + step, low, high)


class _AcceptedStep(NamedTuple):
    x: Array
    residual: Array
    cost: float
    damping: float
    """Damping of the next iteration."""


def minimise(
    function: ResidualFunction, x0: Array, low: Array, high: Array, limit: int
) -> SolverResult:
    """Minimise a sum of squares by Levenberg-Marquardt with clipped steps; at most `limit` iterations.

    Parameters at a bound with a gradient that points outwards are fixed for the iteration (active set).
    """
    x = x0
    residual = function(x[None])[0]
    cost = float(residual @ residual)
    damping = 1e-3
    for _ in range(limit):
        expansion = _expand_quadratic(
            finite_difference_jacobian(function, x, low, high, residual), residual, x, low, high
        )
        better = _accept_step(function, expansion, low, high, damping, cost)
        if better is None:
            break
        improved = (cost - better.cost) / max(cost, 1e-300)
        x, residual, cost, damping = better
        if improved < TOLERANCE_RATIO:
            break
    return SolverResult(x, cost)


def _expand_quadratic(
    J: Array, residual: Array, x: Array, low: Array, high: Array
) -> _LocalQuadratic:
    gradient = J.T @ residual
    held = ((x <= low) & (gradient < 0.0)) | ((x >= high) & (gradient > 0.0))
    A = J.T @ J
    free = np.flatnonzero(~held)
    scale = np.sqrt(np.maximum(np.diag(A)[free], 1e-30))
    curvature = A[np.ix_(free, free)] / np.outer(scale, scale)
    return _LocalQuadratic(x, free, scale, curvature, gradient[free] / scale)


def _accept_step(
    function: ResidualFunction,
    expansion: _LocalQuadratic,
    low: Array,
    high: Array,
    damping: float,
    cost: float,
) -> _AcceptedStep | None:
    """The least damped step that reduces the cost; None if none does.

    The first is tried alone because it mostly succeeds, then all others at once.
    """
    dampings = [damping]
    for _ in range(DAMPING_STEPS_COUNT - 1):
        dampings.append(min(10.0 * max(dampings[-1], 1e-6), 1e9))
    for tried in (dampings[:1], dampings[1:]):
        places = np.stack([expansion.step_damped(one, low, high) for one in tried])
        for one, x, residual in zip(tried, places, function(places), strict=True):
            left = float(residual @ residual)
            if left < cost:
                return _AcceptedStep(x, residual, left, max(0.1 * one, 1e-9))
    return None


def finite_difference_jacobian(
    function: ResidualFunction, x: Array, low: Array, high: Array, residual: Array
) -> Array:
    """Jacobian d simulated / d parameter = - d residual / d parameter, (samples, parameters).

    Steps of 0.3 % are wide enough to cross the kinks of dead bands and of delays within a tick.
    """
    step = 3e-3 * np.maximum(np.abs(x), 0.01 * np.minimum(high - low, 10.0))
    step = np.where(x + step > high, -step, step)
    moved = function(x + np.diag(step))
    return (residual - moved).T / step


@dataclass(frozen=True, slots=True)
class StructureFit:
    """A structure with its fitted parameters."""

    options: tuple[EffectOption, ...]
    names: tuple[str, ...]
    """Names of the parameters: nuisance first, then ``option.parameter``."""
    values: Array
    """(parameters,)"""
    residual: Array
    """(samples,)"""
    jacobian: Array
    """(samples, parameters)"""
    is_converged: bool = True
    """Whether the optimiser had enough iterations to converge."""

    @property
    def mean_square(self) -> float:
        """Mean square of the residual."""
        return float(np.mean(self.residual**2))

    def as_mapping(self) -> dict[str, float]:
        """Parameters by name."""
        return dict(zip(self.names, self.values.tolist(), strict=True))


def fit_structure(
    problem: FitProblem,
    options: tuple[EffectOption, ...],
    start: Mapping[str, float],
    iterations: int = FULL_ITERATIONS,
    use: Array | None = None,
    frozen: Mapping[str, float] | None = None,
) -> StructureFit:
    """Fit a structure from all start values of the parameters that `start` lacks.

    Args:
        problem: data and simulation.
        options: the structure.
        start: parameters of a simpler fit, by name.
        iterations: limit of the optimiser.
        use: (samples,) weight 1 where a sample is used, 0 where it is held out.
        frozen: parameters that keep these values.
    """
    fixed = dict(frozen or {})
    parameters = {n: p for n, p in structure_parameters(problem, options).items() if n not in fixed}
    names = tuple(parameters)
    low = np.array([p.low for p in parameters.values()])
    high = np.array([p.high for p in parameters.values()])
    starts = _make_starts(problem, parameters, start)

    def unweighted(x: Array) -> Array:
        return problem.residuals(
            [{**fixed, **dict(zip(names, row, strict=True))} for row in x.tolist()]
        )

    sd = np.array([p.prior_sd for p in parameters.values()])
    centre = np.array([p.starts[0] for p in parameters.values()])
    has_prior = np.flatnonzero(np.isfinite(sd))

    def weighted(x: Array, part: Array | float = 1.0) -> Array:
        residual = unweighted(x) * (part if use is None else part * use)
        if has_prior.size == 0:
            return residual
        # A prior counts as one more measurement of its parameter.
        prior = -problem.noise * ((x - centre) / sd)[:, has_prior]
        return np.concatenate([residual, prior], axis=1)

    best_x, best_cost = np.array([]), np.inf
    # A few iterations from every start, then all iterations from the best.
    for first in starts:
        margin = 1e-6 * (high - low)
        x0 = np.clip(np.array([first[name] for name in names]), low + margin, high - margin)
        for part in problem.prefix_weights if set(names) - set(start) else ():
            x0 = minimise(partial(weighted, part=part), x0, low, high, QUICK_ITERATIONS).x
        limit = iterations if len(starts) == 1 else min(iterations, QUICK_ITERATIONS)
        solved = minimise(weighted, x0, low, high, limit)
        if solved.cost < best_cost:
            best_x, best_cost = solved.x, solved.cost
    thresholds = [k for k, p in enumerate(parameters.values()) if p.is_threshold]
    for index in thresholds:
        best_x = _scan_threshold(weighted, best_x, index, low[index], high[index])
    if (len(starts) > 1 or thresholds) and iterations > QUICK_ITERATIONS:
        best_x = minimise(weighted, best_x, low, high, iterations).x
    residual = unweighted(best_x[None])[0]
    jacobian = finite_difference_jacobian(unweighted, best_x, low, high, residual)
    return StructureFit(options, names, best_x, residual, jacobian, iterations > QUICK_ITERATIONS)


def structure_parameters(
    problem: FitProblem, options: Sequence[EffectOption]
) -> dict[str, FreeParameter]:
    """Free parameters of a structure, by name."""
    own = {f"{o.key}.{p.name}": p for o in options for p in o.parameters}
    return {p.name: p for p in problem.nuisance} | own


def _scan_threshold(
    function: Callable[[Array], Array], x: Array, index: int, low: float, high: float
) -> Array:
    """Replace one positive parameter by the best value on a coarse, then a fine geometric grid."""
    x = _best_of_grid(function, x, index, np.geomspace(low, high, THRESHOLD_GRID_COUNT))
    near = x[index] * np.geomspace(
        1.0 / THRESHOLD_REFINEMENT_RATIO, THRESHOLD_REFINEMENT_RATIO, THRESHOLD_GRID_COUNT
    )
    return _best_of_grid(function, x, index, np.clip(near, low, high))


def _best_of_grid(function: Callable[[Array], Array], x: Array, index: int, values: Array) -> Array:
    """The point itself or with one of these values, whichever has the smallest cost."""
    tried = np.tile(x, (len(values) + 1, 1))
    tried[1:, index] = values
    return tried[int(np.argmin(np.sum(function(tried) ** 2, axis=1)))]


def _make_starts(
    problem: FitProblem, parameters: Mapping[str, FreeParameter], start: Mapping[str, float]
) -> list[Mapping[str, float]]:
    """Start points: `start` with each start value of what it lacks, and the problem's initial guess."""
    new = [name for name in parameters if name not in start]
    starts: list[Mapping[str, float]] = [
        {
            name: start[name] if name in start else p.starts[number % len(p.starts)]
            for name, p in parameters.items()
        }
        for number in range(max((len(parameters[name].starts) for name in new), default=1))
    ]
    guess = problem.initial_guess(tuple(parameters)) if new else {}
    return [*starts, {**starts[0], **guess}] if guess else starts


def parameter_bounds(problem: FitProblem, found: StructureFit) -> tuple[Array, Array]:
    """Lower and upper bounds of a fit's parameters, (parameters,) each."""
    parameters = structure_parameters(problem, found.options)
    low = np.array([parameters[name].low for name in found.names])
    high = np.array([parameters[name].high for name in found.names])
    return low, high
