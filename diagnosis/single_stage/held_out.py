"""Held-out error: cross-validation over blocks of a record, and the share of the gap explained there."""

import math
from typing import Final

import numpy as np

from diagnosis.single_stage.fit import StructureFit, fit_structure, parameter_bounds
from diagnosis.single_stage.fit_problem import FitProblem
from diagnosis.verdict import Shrink
from machine.conventions import Array

BOOTSTRAP_COUNT: Final = 2000
"""Bootstrap draws of held-out blocks."""


def estimate_held_out_squares(problem: FitProblem, found: StructureFit) -> Array:
    """Sum of squares (blocks,) of each block's residual with parameters fitted to the other blocks.

    Parameters without block b follow from one Gauss-Newton step, x_b = x - (A - A_b)^-1 J_b' r_b with
    A = J'J; the block is then simulated with x_b. This is exact for a linear response. A parameter that the
    data hardly determine may leave the range where the step is valid: the smaller of the simulated and the
    linear residual is used. With nuisance parameters per run, J and r are projected off them and the linear
    residual is used.
    """
    local = np.array([name in problem.run_nuisance for name in found.names])
    basis, _ = np.linalg.qr(found.jacobian[:, local])
    J = found.jacobian[:, ~local] - basis @ (basis.T @ found.jacobian[:, ~local])
    r = found.residual - basis @ (basis.T @ found.residual)
    low, high = parameter_bounds(problem, found)
    low, high, values = low[~local], high[~local], found.values[~local]
    scale = np.maximum(np.linalg.norm(J, axis=0), 1e-12)
    Js = J / scale
    A = Js.T @ Js + 2e-6 * np.eye(len(scale))
    numbers, place = np.unique(problem.block, return_inverse=True)
    block_values: list[Array] = []
    for number in numbers:
        inside = problem.block == number
        Jb, rb = Js[inside], r[inside]
        room = ((low - values) * scale, (high - values) * scale)
        block_values.append(values + _solve_bounded_step(A - Jb.T @ Jb, -Jb.T @ rb, room) / scale)
    rows = np.arange(len(r))
    linear = np.bincount(place, (r - (np.stack(block_values) - values) @ J.T)[place, rows] ** 2)
    if np.any(local):
        return linear.astype(np.float64)
    names = found.names
    resimulated = problem.residuals(
        [dict(zip(names, x.tolist(), strict=True)) for x in block_values]
    )
    simulated = np.bincount(place, resimulated[place, rows] ** 2)
    return np.minimum(simulated, np.maximum(linear, np.bincount(place, r**2)))


def _solve_bounded_step(matrix: Array, right: Array, room: tuple[Array, Array]) -> Array:
    """Solve ``matrix step = right`` within bounds; components at a bound are fixed, the rest solved again."""
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


def measure_held_out_shrink(
    problem: FitProblem, ideal: StructureFit, chosen: StructureFit, noise: float
) -> Shrink:
    """Refit the ideal and the chosen structure without the held-out samples, and compare both on those.

    `before_m` and `after_m` are root mean squares in the unit of the residual.

    Args:
        problem: data and simulation.
        ideal: fit without effects.
        chosen: fit with effects.
        noise: standard deviation of the measurement noise, in the unit of the residual.
    """
    held = problem.held_out_mask
    use = np.where(held, 0.0, 1.0)
    before2 = _squared_residuals(problem, ideal, use)
    after2 = _squared_residuals(problem, chosen, use)
    used = ~held
    predicted = _explained_share(float(np.mean(before2[used])), float(np.mean(after2[used])), noise)
    before, after = float(np.mean(before2[held])), float(np.mean(after2[held]))
    rng = np.random.default_rng(0)
    pieces = [np.flatnonzero(held & (problem.block == b)) for b in np.unique(problem.block[held])]
    draws: list[float] = []
    for _ in range(BOOTSTRAP_COUNT if len(pieces) > 1 else 0):
        chosen_pieces = rng.integers(0, len(pieces), len(pieces))
        index = np.concatenate([pieces[k] for k in chosen_pieces])
        draws.append(
            _explained_share(float(np.mean(before2[index])), float(np.mean(after2[index])), noise)
        )
    realised = _explained_share(before, after, noise)
    low, high = np.quantile(draws, [0.05, 0.95]) if draws else (math.nan, math.nan)
    ci90 = (float(low), float(high)) if draws else (realised, realised)
    removable = max(1.0 - noise**2 / before, 0.0) if before > 0.0 else 0.0
    return Shrink(
        predicted_ratio=predicted,
        before_m=math.sqrt(before),
        after_m=math.sqrt(after),
        ratio=realised,
        ci90=ci90,
        held_out_throws=len(pieces),
        removable_ratio=math.sqrt(removable),
    )


def _squared_residuals(problem: FitProblem, structure: StructureFit, use: Array) -> Array:
    """Squared residuals (samples,); effects are fitted to the used samples, nuisance of runs to all."""
    refitted = fit_structure(problem, structure.options, structure.as_mapping(), use=use)
    if not problem.run_nuisance:
        return refitted.residual**2
    values = refitted.as_mapping()
    shared = {name: value for name, value in values.items() if name not in problem.run_nuisance}
    return fit_structure(problem, structure.options, values, frozen=shared).residual ** 2


def _explained_share(before: float, after: float, noise: float) -> float:
    """Share of the gap above the noise that is explained, from mean squares; 1 means all of it."""
    start = math.sqrt(before)
    left = math.sqrt(max(after - noise**2, 0.0))
    above = math.sqrt(max(before - noise**2, 0.0))
    return 1.0 - left / above if above > 1e-9 * max(start, 1e-12) else 0.0
