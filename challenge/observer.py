"""Smallest effects that the best linear observer detects in a set of throws.

An effect changes what the twin predicts. The change is compared with sensor noise, with what differs from
throw to throw, and with the scatter of a healthy machine in every parameter, of which 12 healthy throws
are known. Its discriminability d' is the distance of the two means in standard deviations of the best
linear statistic. The detection limit with 5 % false alarms and 5 % misses is d' = 3.29 (Currie 1968, ISO
11843-1).
"""

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, NamedTuple

import numpy as np

from challenge.healthy_machines import healthy_machine
from challenge.make import make_reference
from diagnosis.healthy.health import load_health
from diagnosis.healthy.noise import whiten
from diagnosis.hypotheses.gap_problem import GapProblem, pose_problem
from diagnosis.linearisation.information import inform_gram
from diagnosis.linearisation.parameters import Parameter, layout, library, scatter_names
from diagnosis.linearisation.sensitivities import relinearise
from diagnosis.linearisation.whitening import slope_count
from diagnosis.loading.logs import load_throws
from diagnosis.loading.prepared import prepare
from diagnosis.reference_throws import health_from_reference
from machine.conventions import Array
from machine.spec import load_spec

LIMIT_D_PRIME: Final = 3.29
THROWS: Final = 12
UNIT_SEED: Final = 0
SEEDS: Final = (41, 42)
"""Seeds of the healthy throws that are known, and of those to which an effect is added."""
ROUNDS: Final = 5
STEP_RATIO: Final = 4.0
"""A size moves by at most this factor a round."""


class Shown(NamedTuple):
    """Discriminability of K effects."""

    constant: Array
    """(K,)"""
    drift: Array
    """(K,) of a drift from nothing to that size over the set."""


def observe(policies: Path) -> GapProblem:
    """The problem of healthy throws of the nominal machine, with what 12 other throws say of it."""
    machine = healthy_machine(load_spec(), UNIT_SEED)
    with TemporaryDirectory() as folder:
        known, seen = (
            load_throws(
                [make_reference(UNIT_SEED, seed, Path(folder) / str(seed), THROWS, policies)]
            )
            for seed in SEEDS
        )
    health = health_from_reference(known, machine.profile, load_health())
    prepared = prepare(seen.throws, machine.profile)
    return pose_problem(
        prepared, machine.profile, machine.calibration, health, layout(health.noise)
    )


def limit_sizes(problem: GapProblem) -> dict[str, tuple[float, float]]:
    """Detection limits by parameter key, as a constant and as a drift; the bound if it is never detected."""
    parameters = library()
    bound = np.array([max(p.high, -p.low) for p in parameters])
    found: list[Array] = []
    for kind in Shown._fields:
        size = 0.1 * bound
        for _ in range(ROUNDS):
            d_prime = getattr(discriminability(problem, parameters, size), kind)
            ratio = LIMIT_D_PRIME / np.maximum(d_prime, 1e-6)
            size = np.minimum(size * np.clip(ratio, 1.0 / STEP_RATIO, STEP_RATIO), bound)
        found.append(size)
    return {
        p.key: (float(constant), float(drift))
        for p, constant, drift in zip(parameters, *found, strict=True)
    }


def discriminability(problem: GapProblem, parameters: Sequence[Parameter], size: Array) -> Shown:
    """D' of every parameter at its size (K,), in the direction that its bounds leave more room for."""
    sign = np.array([1.0 if p.high >= -p.low else -1.0 for p in parameters])
    requests = [((p.at(float(s)),), [p]) for p, s in zip(parameters, sign * size, strict=True)]
    moved = list(
        relinearise(
            problem.prepared,
            problem.profile,
            problem.calibration,
            problem.healthy,
            problem.linear,
            requests,
        )
    )
    count = len(parameters)
    width = 2 * count + slope_count()
    precision = np.zeros((width, width))
    for i in range(len(problem.prepared)):
        change = np.column_stack([problem.linear[i].residual - at[i].residual for at in moved])
        precision += _precision_of(problem, i, np.nan_to_num(change))
    names = scatter_names()
    scatter = problem.model.scatter(names)
    asked, rest = slice(0, 2 * count), slice(2 * count, None)
    inner = precision[rest, rest] + np.linalg.inv(scatter)
    shared = np.linalg.solve(inner, precision[rest, asked])
    left = precision[asked, asked] - precision[asked, rest] @ shared
    d_prime = np.sqrt(np.maximum(np.diag(left), 0.0))
    return Shown(d_prime[:count], d_prime[count:])


def _precision_of(problem: GapProblem, throw: int, change: Array) -> Array:
    """Precision (2 K + p, 2 K + p) of the changes (n, K), as constants and drifts, and of the parameters."""
    prepared, base = problem.prepared[throw], problem.whitened[throw]
    white = np.empty_like(change)
    for block, lower in zip(prepared.blocks, problem.factor[throw], strict=True):
        white[block.rows] = whiten(lower, change[block.rows])
    share = prepared.input.progress_ratio
    table = np.column_stack(
        [np.zeros(change.shape[0]), white, share * white, base.slopes, base.nuisance]
    )
    count = 2 * change.shape[1] + base.slopes.shape[1]
    return inform_gram(table.T @ table, count).precision
