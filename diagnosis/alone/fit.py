"""Least-squares fits of nested structures to one stage's own data: what the three stage tools share.

A structure is a set of options; each option adds the parameters of one effect to a simulated response.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
from scipy.stats import t as student_t

from diagnosis.alone.problem import FreeParameter, Option, Problem
from diagnosis.alone.solver import sensitivities, solve
from machine.conventions import Array, IntArray

QUICK_ITERATIONS: Final = 5
FULL_ITERATIONS: Final = 40
SCANNED_COUNT: Final = 16
NEAR_RATIO: Final = 1.25
"""Thresholds are tried at so many values over their range, then up to this factor about the best."""


@dataclass(frozen=True, slots=True)
class Fit:
    """A structure at its best parameters."""

    options: tuple[Option, ...]
    names: tuple[str, ...]
    """Of the parameters: the nuisance's own, then ``option.parameter``."""
    values: Array
    """(parameters,)"""
    residual: Array
    """(samples,)"""
    jacobian: Array
    """(samples, parameters)"""
    is_settled: bool = True
    """Whether the optimiser was given time to converge."""

    @property
    def mean_square(self) -> float:
        """Of the residual."""
        return float(np.mean(self.residual**2))

    def as_mapping(self) -> dict[str, float]:
        """Parameters by name."""
        return dict(zip(self.names, self.values.tolist(), strict=True))


def fit(
    problem: Problem,
    options: tuple[Option, ...],
    start: Mapping[str, float],
    iterations: int = FULL_ITERATIONS,
    use: Array | None = None,
    frozen: Mapping[str, float] | None = None,
) -> Fit:
    """Fit a structure, from `start` and from each start of the parameters that it lacks.

    Args:
        problem: data and response.
        options: the structure.
        start: parameters of a simpler fit, by name.
        iterations: limit of the optimiser.
        use: (samples,) 1 where a sample counts, 0 where it is held out.
        frozen: parameters that keep these values.
    """
    fixed = dict(frozen or {})
    parameters = {n: p for n, p in parameters_of(problem, options).items() if n not in fixed}
    names = tuple(parameters)
    low = np.array([p.low for p in parameters.values()])
    high = np.array([p.high for p in parameters.values()])
    starts = _starts(problem, parameters, start)

    def unweighted(x: Array) -> Array:
        return problem.residuals(
            [{**fixed, **dict(zip(names, row, strict=True))} for row in x.tolist()]
        )

    sd = np.array([p.prior_sd for p in parameters.values()])
    centre = np.array([p.starts[0] for p in parameters.values()])
    known = np.flatnonzero(np.isfinite(sd))

    def weighted(x: Array, part: Array | float = 1.0) -> Array:
        residual = unweighted(x) * (part if use is None else part * use)
        if known.size == 0:
            return residual
        # What is known beforehand counts as one more measurement of that parameter.
        prior = -problem.noise * ((x - centre) / sd)[:, known]
        return np.concatenate([residual, prior], axis=1)

    best_x, best_cost = np.array([]), np.inf
    # Every start gets a short run, the best one a long run.
    for first in starts:
        margin = 1e-6 * (high - low)
        x0 = np.clip(np.array([first[name] for name in names]), low + margin, high - margin)
        for part in problem.horizons if set(names) - set(start) else ():
            x0 = solve(partial(weighted, part=part), x0, low, high, QUICK_ITERATIONS).x
        limit = iterations if len(starts) == 1 else min(iterations, QUICK_ITERATIONS)
        solved = solve(weighted, x0, low, high, limit)
        if solved.cost < best_cost:
            best_x, best_cost = solved.x, solved.cost
    thresholds = [k for k, p in enumerate(parameters.values()) if p.is_threshold]
    for index in thresholds:
        best_x = _scanned(weighted, best_x, index, low[index], high[index])
    if (len(starts) > 1 or thresholds) and iterations > QUICK_ITERATIONS:
        best_x = solve(weighted, best_x, low, high, iterations).x
    residual = unweighted(best_x[None])[0]
    jacobian = sensitivities(unweighted, best_x, low, high, residual)
    return Fit(options, names, best_x, residual, jacobian, iterations > QUICK_ITERATIONS)


def parameters_of(problem: Problem, options: Sequence[Option]) -> dict[str, FreeParameter]:
    """What is fitted in a structure, by name."""
    own = {f"{o.key}.{p.name}": p for o in options for p in o.parameters}
    return {p.name: p for p in problem.nuisance} | own


def _scanned(
    function: Callable[[Array], Array], x: Array, index: int, low: float, high: float
) -> Array:
    """The best of some values of one positive parameter, the others as they are: coarse, then near it."""
    x = _best_of(function, x, index, np.geomspace(low, high, SCANNED_COUNT))
    near = x[index] * np.geomspace(1.0 / NEAR_RATIO, NEAR_RATIO, SCANNED_COUNT)
    return _best_of(function, x, index, np.clip(near, low, high))


def _best_of(function: Callable[[Array], Array], x: Array, index: int, values: Array) -> Array:
    """The point as it is or with one of these values, whichever leaves least."""
    tried = np.tile(x, (len(values) + 1, 1))
    tried[1:, index] = values
    return tried[int(np.argmin(np.sum(function(tried) ** 2, axis=1)))]


def _starts(
    problem: Problem, parameters: Mapping[str, FreeParameter], start: Mapping[str, float]
) -> list[Mapping[str, float]]:
    """Where a fit begins: `start` with each start of what it lacks, and what the problem guesses."""
    new = [name for name in parameters if name not in start]
    starts: list[Mapping[str, float]] = [
        {
            name: start[name] if name in start else p.starts[number % len(p.starts)]
            for name, p in parameters.items()
        }
        for number in range(max((len(parameters[name].starts) for name in new), default=1))
    ]
    guess = problem.guess(tuple(parameters)) if new else {}
    return [*starts, {**starts[0], **guess}] if guess else starts


def held_out_mean_square(problem: Problem, found: Fit) -> float:
    """Mean square of each block's residual with parameters from the other blocks only.

    One Gauss-Newton step from the fit to all blocks, x_b = x - (A - A_b)^-1 J_b' r_b with A = J'J, then the
    block is simulated again with x_b; exact for a linear response. Where a parameter hardly shows, that step
    leaves the range in which it means anything: the linear response is taken where it is the smaller one.
    With local nuisance, J and r are taken beyond what the local parameters explain, and it is taken always.
    """
    local = np.array([name in problem.local for name in found.names])
    basis, _ = np.linalg.qr(found.jacobian[:, local])
    J = found.jacobian[:, ~local] - basis @ (basis.T @ found.jacobian[:, ~local])
    r = found.residual - basis @ (basis.T @ found.residual)
    low, high = bounds(problem, found)
    low, high, values = low[~local], high[~local], found.values[~local]
    scale = np.maximum(np.linalg.norm(J, axis=0), 1e-12)
    Js = J / scale
    A = Js.T @ Js + 2e-6 * np.eye(len(scale))
    numbers, place = np.unique(problem.block, return_inverse=True)
    moved: list[Array] = []
    for number in numbers:
        inside = problem.block == number
        Jb, rb = Js[inside], r[inside]
        room = ((low - values) * scale, (high - values) * scale)
        moved.append(values + _boxed_step(A - Jb.T @ Jb, -Jb.T @ rb, room) / scale)
    rows = np.arange(len(r))
    linear = np.bincount(place, (r - (np.stack(moved) - values) @ J.T)[place, rows] ** 2)
    if np.any(local):
        return float(np.sum(linear)) / len(r)
    names = found.names
    again = problem.residuals([dict(zip(names, x.tolist(), strict=True)) for x in moved])
    simulated = np.bincount(place, again[place, rows] ** 2)
    return float(np.sum(np.minimum(simulated, np.maximum(linear, np.bincount(place, r**2))))) / len(
        r
    )


def _boxed_step(matrix: Array, right: Array, room: tuple[Array, Array]) -> Array:
    """Solve ``matrix step = right`` within bounds: what hits one stays there, the rest is solved again."""
    step = np.zeros_like(right)
    free = np.ones(len(right), dtype=np.bool_)
    for _ in range(4):
        coupled = right[free] - matrix[np.ix_(free, ~free)] @ step[~free]
        step[free] = np.linalg.solve(matrix[np.ix_(free, free)], coupled)
        beyond = free & ((step < room[0]) | (step > room[1]))
        step = np.clip(step, *room)
        if not np.any(beyond):
            break
        free &= ~beyond
    return step


def bounds(problem: Problem, found: Fit) -> tuple[Array, Array]:
    """Bounds of a fit's parameters, (parameters,) each."""
    parameters = parameters_of(problem, found.options)
    low = np.array([parameters[name].low for name in found.names])
    high = np.array([parameters[name].high for name in found.names])
    return low, high


def standard_errors(problem: Problem, found: Fit, correlation_samples: float) -> Array:
    """Standard error of each parameter, (parameters,), honest about correlated residuals.

    The larger of two: white-noise covariance times the residual's correlation length, and the sandwich
    A^-1 (sum_b g_b g_b') A^-1 over blocks, g_b = J_b' r_b (cluster-robust; Liang and Zeger 1986).
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


def interval_factor(problem: Problem) -> float:
    """Half width of a 90 % interval in standard errors, with the blocks as degrees of freedom."""
    return float(student_t.ppf(0.95, max(len(np.unique(problem.block)) - 1, 2)))


def correlation_length(residual: Array, block: IntArray) -> float:
    """Integrated autocorrelation time in samples, 1 + 2 sum rho_k up to its first zero; at least 1."""
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
