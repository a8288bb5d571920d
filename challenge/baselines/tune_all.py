"""Baselines that tune everything: Gauss-Newton with the largest z-score, and CMA-ES over all parameters.

The first is the method of mujoco.sysid and similar tools, the second that of PACE. Both use the same effects
as the diagnosis. Neither has a model of how far healthy machines are from their twins.
"""

from collections.abc import Callable, Sequence

import numpy as np

from challenge.baselines.baseline_case import (
    GYRO_SD_RAD_PER_S,
    IMPACT_SD_M,
    POSITION_SD_RAD_M,
    Candidate,
    Case,
    conclude,
    open_case,
    run_twin,
    throw_errors,
)
from diagnosis.healthy.filters import nothing
from diagnosis.linearisation.parameters import Parameter, library
from diagnosis.linearisation.sensitivities import LinearThrow, linearise, relinearise
from diagnosis.loading.throw_data import LoadedSet
from diagnosis.verdict import Diagnosis
from machine.conventions import Array, IntArray
from sim_twin.effects.effect import Effect
from sim_twin.twin.profile import TwinProfile

GAUSS_NEWTON_ROUNDS = 2
PRIOR_RATIO = 2.0
"""Ridge of the fit, in multiples of `prior_sd`: without it effects that look alike diverge."""
Z_LIMIT = 72.0
"""Largest z-score of a healthy machine; the independence assumption makes z-scores far too large."""
EVOLUTION_THROWS = 3
EVOLUTION_GENERATIONS = 30
EVOLUTION_POPULATION = 16
EVOLUTION_LIMIT = 29.7
"""Size, in the table's tolerances, that one of ten healthy machines exceeds."""
RELEASE_SD_S = 0.01


def largest_z(loaded: LoadedSet, profile: TwinProfile) -> Diagnosis:
    """Fit all parameters together by Gauss-Newton; the cause is the parameter with the largest z-score."""
    refused = loaded.too_few()
    if refused is not None:
        return refused
    case = open_case(loaded, profile)
    theta, sd = np.zeros(len(library())), np.ones(len(library()))
    train = [case.prepared[int(i)] for i in case.train]
    first = linear = linearise(train, profile, case.calibration, nothing())
    for number in range(GAUSS_NEWTON_ROUNDS):
        if number:
            request = (_effects(theta), library())
            linear = next(
                relinearise(train, profile, case.calibration, nothing(), first, [request])
            )
        step, sd = _solve(case, linear, theta)
        theta = _bounded(theta + step)
    score = np.abs(theta) / np.maximum(sd, 1e-12) / Z_LIMIT
    return conclude(case, _candidates(theta, sd, score), _effects(theta))


def _solve(case: Case, linear: Sequence[LinearThrow], theta: Array) -> tuple[Array, Array]:
    """Ridge step and standard errors, with one pooled variance for each channel."""
    groups: dict[str, list[tuple[Array, Array]]] = {}
    for i, one in zip(case.train, linear, strict=True):
        for block in case.prepared[int(i)].blocks:
            residual = one.residual[block.rows]
            good = np.isfinite(residual)
            rows = one.jacobian[block.rows][good]
            groups.setdefault(block.name, []).append((residual[good], rows))
    ridge = np.array([(PRIOR_RATIO * p.prior_sd) ** -2 for p in library()])
    information, gradient = np.diag(ridge), -ridge * theta
    for parts in groups.values():
        residual = np.concatenate([r for r, _ in parts])
        jacobian = np.concatenate([j for _, j in parts])
        if residual.size == 0:
            continue
        weight = 1.0 / max(float(np.mean(residual**2)), 1e-12)
        information += weight * jacobian.T @ jacobian
        gradient += weight * jacobian.T @ residual
    covariance = np.linalg.inv(information)
    return covariance @ gradient, np.sqrt(np.diag(covariance))


def evolution(loaded: LoadedSet, profile: TwinProfile) -> Diagnosis:
    """Fit all parameters by CMA-ES on simulated throws; the cause is the largest in its tolerances."""
    refused = loaded.too_few()
    if refused is not None:
        return refused
    case = open_case(loaded, profile)
    width = np.array([p.prior_sd for p in library()])
    rows = case.train[:EVOLUTION_THROWS]

    def costs(points: Array) -> Array:
        return _costs(case, rows, [_effects(_bounded(point * width)) for point in points])

    best, spread = cma_es(
        costs,
        np.zeros(width.size),
        0.3,
        generations=EVOLUTION_GENERATIONS,
        population=EVOLUTION_POPULATION,
        rng=np.random.default_rng(0),
    )
    theta = _bounded(best * width)
    tolerance = np.array([max(p.tolerance, 0.05 * p.prior_sd) for p in library()])
    score = np.abs(theta) / tolerance / EVOLUTION_LIMIT
    return conclude(case, _candidates(theta, spread * width, score), _effects(theta))


def _costs(case: Case, rows: IntArray, effects: Sequence[tuple[Effect, ...]]) -> Array:
    """Mean square error of trajectories, release and impact of each set of effects."""
    output = run_twin(case, rows, effects)
    costs = np.zeros(len(effects))
    for place in range(len(effects)):
        for k, row in enumerate(rows):
            found = throw_errors(case, int(row), output, place * rows.size + k)
            parts = (
                found.position / POSITION_SD_RAD_M,
                found.gyro / GYRO_SD_RAD_PER_S,
                np.array([found.release_s / RELEASE_SD_S]),
                found.impact_m / IMPACT_SD_M,
            )
            costs[place] += sum(float(np.nan_to_num(np.mean(p**2), nan=1e4)) for p in parts)
    return costs


def cma_es(
    costs: Callable[[Array], Array],
    start: Array,
    sigma: float,
    *,
    generations: int,
    population: int,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Covariance matrix adaptation (Hansen, arXiv:1604.00772), full matrix, rank-one and rank-mu updates.

    Returns:
        Mean of the last distribution and its standard deviations, each (n,).
    """
    n, parents = start.size, population // 2
    weights = np.log(parents + 0.5) - np.log(np.arange(1, parents + 1))
    weights /= weights.sum()
    mu_eff = 1.0 / float((weights**2).sum())
    c_sigma = (mu_eff + 2.0) / (n + mu_eff + 5.0)
    d_sigma = 1.0 + 2.0 * max(0.0, np.sqrt((mu_eff - 1.0) / (n + 1.0)) - 1.0) + c_sigma
    c_path = (4.0 + mu_eff / n) / (n + 4.0 + 2.0 * mu_eff / n)
    c_one = 2.0 / ((n + 1.3) ** 2 + mu_eff)
    c_mu = min(1.0 - c_one, 2.0 * (mu_eff - 2.0 + 1.0 / mu_eff) / ((n + 2.0) ** 2 + mu_eff))
    expected = np.sqrt(n) * (1.0 - 1.0 / (4.0 * n) + 1.0 / (21.0 * n**2))
    mean, covariance = start.copy(), np.eye(n)
    path_sigma, path = np.zeros(n), np.zeros(n)
    for generation in range(generations):
        values, axes = np.linalg.eigh(covariance)
        values = np.sqrt(np.maximum(values, 1e-20))
        moves = (rng.standard_normal((population, n)) * values) @ axes.T
        order = np.argsort(costs(mean + sigma * moves))[:parents]
        chosen = moves[order]
        step = weights @ chosen
        mean = mean + sigma * step
        whitened = axes @ ((axes.T @ step) / values)
        path_sigma = (1.0 - c_sigma) * path_sigma
        path_sigma += np.sqrt(c_sigma * (2.0 - c_sigma) * mu_eff) * whitened
        length = float(np.linalg.norm(path_sigma))
        warm_up = np.sqrt(1.0 - (1.0 - c_sigma) ** (2 * (generation + 1)))
        grows = length / warm_up < (1.4 + 2.0 / (n + 1.0)) * expected
        path = (1.0 - c_path) * path
        path += grows * np.sqrt(c_path * (2.0 - c_path) * mu_eff) * step
        covariance = (1.0 - c_one - c_mu) * covariance + c_one * np.outer(path, path)
        covariance += c_mu * np.einsum("k,ki,kj->ij", weights, chosen, chosen)
        sigma *= float(np.exp(c_sigma / d_sigma * (length / expected - 1.0)))
    return mean, sigma * np.sqrt(np.diag(covariance))


def _effects(theta: Array) -> tuple[Effect, ...]:
    """All parameters as effects, one for each group."""
    groups: dict[tuple[str, str | None], dict[str, float]] = {}
    for p, size in zip(library(), theta, strict=True):
        if size != 0.0:
            groups.setdefault(p.group, {})[p.name] = float(size)
    return tuple(
        Effect(effect=effect, joint=joint, parameters=sizes)
        for (effect, joint), sizes in groups.items()
    )


def _bounded(theta: Array) -> Array:
    # A finite-difference step must fit between the size and its bound.
    pairs = zip(library(), theta, strict=True)
    return np.array([min(p.clip(float(size)), p.high - p.step) for p, size in pairs])


def _candidates(theta: Array, sd: Array, score: Array) -> list[Candidate]:
    groups: dict[tuple[str, str | None], list[tuple[int, Parameter]]] = {}
    for i, p in enumerate(library()):
        groups.setdefault(p.group, []).append((i, p))
    return [
        Candidate(
            effect,
            joint,
            {p.name: (float(theta[i]), float(sd[i])) for i, p in members},
            max(float(score[i]) for i, _ in members),
        )
        for (effect, joint), members in groups.items()
    ]
