"""Evidence and model selection on linear problems with a known answer."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from diagnosis.inference.evidence import (
    Information,
    Priors,
    inform_gram,
    screen,
    set_log_prior,
    total,
    weigh,
)
from diagnosis.inference.model_selection import search
from diagnosis.tuning import (
    MIN_SLAB_OVER_SPIKE_RATIO,
    PARTNER_LOG_PRIOR,
)
from machine.conventions import Array

FREE = 1e9


def priors(count: int, slab: float = 1.0, spike: float = 0.01) -> Priors:
    return Priors(
        scatter=spike**2 * np.eye(count),
        slab_sd=np.full(count, slab),
        low=np.full(count, -FREE),
        high=np.full(count, FREE),
        groups=tuple(np.array([i]) for i in range(count)),
        log_prior=np.full(count, -4.0),
    )


@dataclass
class GapProblem:
    """Throws of a linear machine."""

    information: list[Information]


def inform(residual: Array, jacobian: Array, nuisance: Array) -> Information:
    table = np.column_stack([residual, jacobian, nuisance])
    return inform_gram(table.T @ table, jacobian.shape[1])


def throws(truth: Array, rng: np.random.Generator, count: int = 12, rows: int = 40) -> GapProblem:
    found: list[Information] = []
    for _ in range(count):
        jacobian = rng.standard_normal((rows, truth.size))
        nuisance = rng.standard_normal((rows, 2))
        residual = jacobian @ truth + nuisance @ rng.standard_normal(2)
        residual += rng.standard_normal(rows)
        found.append(inform(residual, jacobian, nuisance))
    return GapProblem(found)


def test_marginalised_nuisances_equal_the_dense_gaussian() -> None:
    rng = np.random.default_rng(0)
    residual, jacobian, nuisance = (
        rng.standard_normal(9),
        rng.standard_normal((9, 3)),
        rng.standard_normal((9, 2)),
    )
    inverse = np.linalg.inv(np.eye(9) + nuisance @ nuisance.T)
    found = inform(residual, jacobian, nuisance)
    np.testing.assert_allclose(found.precision, jacobian.T @ inverse @ jacobian, atol=1e-10)
    np.testing.assert_allclose(found.gradient, jacobian.T @ inverse @ residual, atol=1e-10)
    assert found.square == pytest.approx(float(residual @ inverse @ residual))


def test_evidence_equals_the_dense_gaussian() -> None:
    rng = np.random.default_rng(1)
    jacobian, residual = rng.standard_normal((30, 4)), rng.standard_normal(30)
    prior = priors(4, slab=MIN_SLAB_OVER_SPIKE_RATIO * 0.5, spike=0.5)
    found = weigh(screen(inform(residual, jacobian, np.zeros((30, 1))), prior), prior, (0, 2))

    def log_density(sd: Array) -> float:
        covariance = np.eye(30) + jacobian @ np.diag(sd**2) @ jacobian.T
        density: Any = multivariate_normal
        return float(density.logpdf(residual, cov=covariance))

    sd = np.sqrt(np.diag(prior.scatter))
    none = log_density(sd)
    # The mixture's smaller scales are lifted to the same least width here.
    sd[[0, 2]] = np.hypot(MIN_SLAB_OVER_SPIKE_RATIO * 0.5, 0.5)
    assert found.log_odds == pytest.approx(log_density(sd) - none - 8.0 + PARTNER_LOG_PRIOR)


def test_true_pair_is_found_and_nothing_else() -> None:
    rng = np.random.default_rng(2)
    truth = np.zeros(20)
    truth[[3, 11]] = 0.5, -0.3
    prior = priors(20)
    base = screen(total(throws(truth, rng).information), prior)
    best = search(base, prior, range(len(prior.groups)))[0]
    assert best.members == (3, 11)
    np.testing.assert_allclose(best.mean, [0.5, -0.3], atol=0.12)


def test_scatter_within_the_spike_is_no_effect() -> None:
    rng = np.random.default_rng(3)
    prior = priors(20, spike=0.1)
    truth = 0.1 * rng.standard_normal(20)
    base = screen(total(throws(truth, rng).information), prior)
    assert search(base, prior, range(len(prior.groups)))[0].members == ()


def test_correlated_scatter_of_healthy_machines_is_no_effect() -> None:
    rng = np.random.default_rng(6)
    prior = priors(6)
    scatter = prior.scatter.copy()
    # Parameters 1 and 2 are off by 0.4, always together.
    scatter[1:3, 1:3] += 0.16
    correlated = prior._replace(scatter=scatter)
    together, apart = np.zeros(6), np.zeros(6)
    together[1:3], apart[1:3] = 0.4, (0.4, -0.4)
    bases = [
        screen(total(throws(truth, rng, rows=200).information), correlated)
        for truth in (together, apart)
    ]
    assert search(bases[0], correlated, range(len(correlated.groups)))[0].members == ()
    # Either of them is off: the other is then scatter.
    assert search(bases[1], correlated, range(len(correlated.groups)))[0].members in {(1,), (2,)}


def test_one_sided_effect_of_the_wrong_sign_is_refused() -> None:
    rng = np.random.default_rng(4)
    truth = np.zeros(5)
    truth[1] = -0.5
    prior = priors(5)._replace(low=np.array([-FREE, 0.0, -FREE, -FREE, -FREE]))
    base = screen(total(throws(truth, rng).information), prior)
    assert weigh(base, prior, (1,)).log_odds < 0.0


def test_each_pair_of_effects_in_a_set_is_rarer() -> None:
    plain = priors(4)
    alone = set_log_prior(plain, (0,))
    assert set_log_prior(plain, (0, 1)) == 2.0 * alone + PARTNER_LOG_PRIOR
    assert set_log_prior(plain, (0, 1, 3)) == 3.0 * alone + 3.0 * PARTNER_LOG_PRIOR


def test_a_slab_is_no_wider_than_its_bound_allows_to_either_side() -> None:

    def log_odds(size: float, low: float) -> float:
        truth = np.array([size, 0.0, 0.0])
        prior = priors(3)._replace(low=np.array([low, -FREE, -FREE]), high=np.full(3, 9.0))
        exact = inform(np.eye(3) @ truth * 100.0, 100.0 * np.eye(3), np.zeros((3, 0)))
        return weigh(screen(exact, prior), prior, (0,)).log_odds

    assert log_odds(0.4, -FREE) == pytest.approx(log_odds(-0.4, -FREE))
    assert log_odds(-0.4, -0.5) < log_odds(0.4, -0.5) - 0.3
    assert log_odds(0.4, -0.5) == pytest.approx(log_odds(0.4, -FREE), abs=0.25)
