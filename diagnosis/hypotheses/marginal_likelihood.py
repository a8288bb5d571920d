"""Marginal likelihood of a set of throws under any prediction of the twin.

Model of one throw: r = J theta + N eta + e. The residual r is measured minus predicted; theta ~ N(0, S)
are the deviations of a healthy machine on another day, the same in all throws of the set; eta ~ N(0, I)
those of the throw; e is the noise of the channels. All three are marginalised in closed form, in the same
way for every set of effects. The sets differ in their predictions alone.

An effect of the library is never quite the machine's. Its form error shows in every throw alike, so that more
throws do not average it out. The likelihood is coarsened accordingly (Miller and Dunson 2019, J. Am. Stat.
Assoc. 114, 1113): the log likelihood of each part of the chain is divided by 1 + `FORM_ERROR_RATIO` x, with x
what a perfect prediction could gain there: of what is left over, and of what deviations absorb. A part then
contributes at most 1 / `FORM_ERROR_RATIO`, and what explains a small share of its misfit alone is no
evidence.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from diagnosis.healthy.noise import whiten
from diagnosis.hypotheses.gap_problem import GapProblem
from diagnosis.linearisation.parameters import library
from diagnosis.linearisation.whitening import Whitened
from diagnosis.tuning import FORM_ERROR_RATIO
from machine.conventions import Array, IntArray


class Marginal(NamedTuple):
    """Likelihood of sizes with all deviations marginalised."""

    log_likelihood: float
    """Up to a constant of the throws."""
    gradient: Array
    """(m,) by the columns' coefficients."""
    precision: Array
    """(m, m)"""
    healthy_mean: Array
    """(p,) posterior mean of the healthy parameters."""


class Products(NamedTuple):
    """Products of a throw's columns (c of them) with themselves and with the healthy parameters (p)."""

    own: Array
    """(c, c)"""
    with_healthy: Array
    """(p, c)"""


@dataclass(frozen=True, slots=True, eq=False)
class ThrowColumns:
    """One throw in units of its noise, with its nuisances marginalised."""

    residual: Array
    """(n,) without effect."""
    healthy: Array
    """(n, p) slopes of the healthy parameters."""
    nuisance: Array
    """(n, q)"""
    inner: Array
    """(q, q) inverse of I + N'N."""
    row_weight: Array
    """(n,) square root of the weight of each row's channel."""

    def without_nuisances(self, columns: Array) -> Array:
        """Columns (n, c) after the marginalisation of the throw's nuisances."""
        return columns - self.nuisance @ (self.inner @ (self.nuisance.T @ columns))


@dataclass(frozen=True, slots=True, eq=False)
class MarginalLikelihood:
    """The marginal likelihood of one set of throws."""

    problem: GapProblem
    throws: Sequence[ThrowColumns]
    covariance: Array
    """(p, p) of the healthy parameters, given the throws."""
    precision: Array
    """(p, p) information of the throws about the parameters along the slopes of no effect."""
    healthy_precision: Array
    """(p, p) the same, with the deviations of a healthy machine marginalised."""

    def healthy_gradient(self, across: Array) -> Array:
        """(p,) gradient about no size, from the products of a residual with the slopes."""
        return across - self.precision @ (self.covariance @ across)

    def products(self, throw: int, change: Array, slopes: Array) -> Products:
        """Products of a throw's residual under a prediction, and of the prediction's slopes.

        Args:
            throw: index.
            change: (n,) of the prediction against no effect, in the channels' units.
            slopes: (n, k) of the prediction by the sizes of effects.
        """
        one = self.throws[throw]
        columns = self.whitened(throw, np.column_stack([change, slopes]))
        columns[:, 0] = one.residual - columns[:, 0]
        kept = one.without_nuisances(columns)
        return Products(columns.T @ kept, one.healthy.T @ kept)

    def whitened(self, throw: int, raw: Array) -> Array:
        """Columns (n, c) in the channels' units, in units of the throw's noise."""
        one, p = self.throws[throw], self.problem.prepared[throw]
        columns = np.zeros_like(raw)
        for block, lower in zip(p.blocks, self.problem.factor[throw], strict=True):
            rows = raw[block.rows]
            if rows.any():
                columns[block.rows] = whiten(lower, rows)
        columns[~np.isfinite(self.problem.linear[throw].residual)] = 0.0
        return columns * one.row_weight[:, None]

    def left_over(self, changes: Sequence[Array], mean: Array) -> list[Array]:
        """Residual (n,) of every throw in units of its noise, not coarsened.

        Args:
            changes: of every throw's prediction, in the channels' units.
            mean: (p,) of the healthy parameters, which is subtracted as are the throws' nuisances.
        """
        found: list[Array] = []
        for i, (one, change) in enumerate(zip(self.throws, changes, strict=True)):
            rest = one.residual - self.whitened(i, change[:, None])[:, 0] - one.healthy @ mean
            found.append(one.without_nuisances(rest[:, None])[:, 0] / one.row_weight)
        return found

    def marginal(self, products: Sequence[Products], replaced: IntArray) -> Marginal:
        """The likelihood under a prediction, and its derivatives by the sizes of effects.

        A healthy deviation of a parameter that is simulated at a size acts along the slope at that size. Its
        slope at no size would let it cancel the effect, and what is left of both would pass for evidence.

        Args:
            products: of every throw: of the residual, then of m slopes at the sizes.
            replaced: (m,) healthy parameters whose columns these slopes replace.
        """
        own = np.sum([one.own for one in products], axis=0)
        across = np.sum([one.with_healthy for one in products], axis=0)
        covariance, count = self.covariance, replaced.size
        weighed = covariance @ across
        volume = 0.0
        if count:
            # The precision changes in the rows and columns replaced: an update of rank 2 m.
            moved = across[:, 1:] - self.precision[:, replaced]
            moved[replaced] = own[1:, 1:] - self.precision[np.ix_(replaced, replaced)]
            across[replaced] = own[1:]
            half = moved.copy()
            half[replaced] *= 0.5
            update = np.column_stack([covariance[:, replaced], covariance @ half])
            zero, one = np.zeros((count, count)), np.eye(count)
            inner = np.block([[zero, one], [one, zero]])
            inner += np.vstack([update[replaced], half.T @ update])
            weighed = covariance @ across
            weighed -= update @ np.linalg.solve(inner, update.T @ across)
            volume = 0.5 * float(np.linalg.slogdet(inner)[1])
        left = own - across.T @ weighed
        return Marginal(-0.5 * float(left[0, 0]) - volume, left[1:, 0], left[1:, 1:], weighed[:, 0])


def marginal_likelihood(problem: GapProblem) -> MarginalLikelihood:
    """The marginal likelihood of a problem's throws."""
    weights = channel_weights(problem)
    columns = [_columns(whitened, weights) for whitened in problem.whitened]
    precision = np.sum([c.healthy.T @ c.without_nuisances(c.healthy) for c in columns], axis=0)
    root = np.linalg.cholesky(problem.layout.priors.scatter)
    inner = np.eye(root.shape[0]) + root.T @ precision @ root
    covariance = root @ np.linalg.solve(inner, root.T)
    covariance = 0.5 * (covariance + covariance.T)
    healthy_precision = precision - precision @ covariance @ precision
    return MarginalLikelihood(problem, columns, covariance, precision, healthy_precision)


def stage_of(channel: str) -> str:
    """The part of the chain that a channel shows: a driven joint, the swing, the opening or the flight."""
    return channel if channel.startswith("actuation") else channel.partition(".")[0]


def channel_weights(problem: GapProblem) -> dict[str, float]:
    """Weight of the log likelihood of every channel.

    Healthy machines of a type differ in their residual power by more than independent samples would. Without
    reference throws the log likelihood is divided by that dispersion as well (quasi-likelihood: Wedderburn
    1974, Biometrika 61, 439).
    """
    gain = {part: 0.5 * shift.excess for part, shift in problem.none_shift.items()}
    # Deviations of pose and mounting show in the swing.
    gain["swing"] += gain["aim"]
    spread: dict[str, float] = {}
    for name, level in problem.none_levels.items():
        middle, sd = problem.model.unknown_level.get(name, (0.0, 0.0))
        rows = sum(
            w.rows[name].stop - w.rows[name].start for w in problem.whitened if name in w.rows
        )
        excess = 0.5 * rows * max(float(np.exp(level - middle)) - 1.0, 0.0)
        gain[stage_of(name)] = gain.get(stage_of(name), 0.0) + excess
        spread[name] = 1.0 if problem.is_own else max(0.5 * rows * sd**2, 1.0)
    return {
        name: 1.0 / (spread[name] + FORM_ERROR_RATIO * gain[stage_of(name)])
        for name in problem.none_levels
    }


def _columns(whitened: Whitened, weights: dict[str, float]) -> ThrowColumns:
    weight = np.ones(whitened.residual.size)
    for name, rows in whitened.rows.items():
        weight[rows] = np.sqrt(weights[name])
    count = len(library())
    slopes = whitened.slopes
    drifts = whitened.progress_ratio * slopes[:, :count]
    healthy = np.column_stack([slopes[:, :count], drifts, slopes[:, count:]]) * weight[:, None]
    nuisance = whitened.nuisance * weight[:, None]
    precision = np.eye(nuisance.shape[1]) + nuisance.T @ nuisance
    inner = np.asarray(np.linalg.inv(precision), dtype=np.float64)
    return ThrowColumns(whitened.residual * weight, healthy, nuisance, inner, weight)
