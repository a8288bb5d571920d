"""What throws say of the parameters equals the dense Gaussian."""

import numpy as np

from diagnosis.linearisation.information import (
    Information,
    Priors,
    healthy_posterior,
    inform_gram,
    total,
)
from machine.conventions import Array


def inform(residual: Array, jacobian: Array, nuisance: Array) -> Information:
    table = np.column_stack([residual, jacobian, nuisance])
    return inform_gram(table.T @ table, jacobian.shape[1])


def test_marginalised_nuisances_equal_the_dense_gaussian() -> None:
    rng = np.random.default_rng(0)
    residual, jacobian = rng.standard_normal(9), rng.standard_normal((9, 3))
    nuisance = rng.standard_normal((9, 2))
    inverse = np.linalg.inv(np.eye(9) + nuisance @ nuisance.T)
    found = inform(residual, jacobian, nuisance)
    np.testing.assert_allclose(found.precision, jacobian.T @ inverse @ jacobian, atol=1e-10)
    np.testing.assert_allclose(found.gradient, jacobian.T @ inverse @ residual, atol=1e-10)


def test_the_posterior_of_several_throws_equals_that_of_their_rows_together() -> None:
    rng = np.random.default_rng(1)
    jacobian, residual = rng.standard_normal((30, 4)), rng.standard_normal(30)
    half = rng.standard_normal((4, 4))
    scatter = half @ half.T + np.eye(4)
    groups = tuple(np.array([i]) for i in range(4))
    priors = Priors(scatter, np.ones(4), -np.ones(4), np.ones(4), groups, np.zeros(4))
    parts = [
        inform(residual[rows], jacobian[rows], np.zeros((rows.stop - rows.start, 1)))
        for rows in (slice(0, 11), slice(11, 30))
    ]
    found = healthy_posterior(total(parts), priors)
    # Of theta given r = J theta + e, by the rules for a joint normal distribution.
    across = scatter @ jacobian.T @ np.linalg.inv(np.eye(30) + jacobian @ scatter @ jacobian.T)
    np.testing.assert_allclose(found.mean, across @ residual, atol=1e-9)
    np.testing.assert_allclose(found.covariance, scatter - across @ jacobian @ scatter, atol=1e-9)
