"""Whitening of a throw's residual and slopes, and marginalisation of its nuisances.

A nuisance is a deviation of a healthy machine between throws (oil temperature, bus phase, grasp, jitter of
the opening, initial swing) or between sets (sensor offsets). Each is a column of slopes times its standard
deviation. All are marginalised; none is ever a cause.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from diagnosis.healthy.noise import NoiseModel, whiten
from diagnosis.linearisation.basis_functions import unmodelled_columns
from diagnosis.linearisation.information import Information, inform_gram
from diagnosis.linearisation.nuisances import set_columns, throw_columns, throw_nuisances
from diagnosis.linearisation.parameters import SET_NUISANCES, ParameterLayout, library, set_names
from diagnosis.linearisation.sensitivities import LinearThrow
from diagnosis.linearisation.unmodelled_effects import unmodelled_names
from diagnosis.loading.prepared import PreparedThrow
from machine.conventions import Array


def slope_count() -> int:
    """Columns of `Whitened.slopes`."""
    return len(library()) + len(set_names())


@dataclass(frozen=True, slots=True)
class Whitened:
    """A throw in units of its noise."""

    table: Array
    """All columns (n, 1 + p + s + q): the residual; slopes of the library's parameters, then of the
    set's nuisances; then the deviations between throws, in independent directions of unit variance."""
    progress_ratio: float
    """Share of a drift that acts in this throw."""
    rows: Mapping[str, slice]
    """Rows of each block."""
    gram: Array
    """(1 + p + s + q,) squared: products of the table's columns."""

    @property
    def residual(self) -> Array:
        """Measured minus twin, (n,)."""
        return self.table[:, 0]

    @property
    def slopes(self) -> Array:
        """Of the parameters, then the nuisances of the set, (n, p + s)."""
        return self.table[:, 1 : 1 + slope_count()]

    @property
    def nuisance(self) -> Array:
        """Of the deviations between throws, (n, q)."""
        return self.table[:, 1 + slope_count() :]


def whiten_throw(
    prepared: PreparedThrow,
    linear: LinearThrow,
    model: NoiseModel,
    factor: Sequence[Array],
    beside: Array | None = None,
) -> Whitened:
    """Whiten a throw's blocks; rows that the twin could not predict count as no data.

    Args:
        prepared: the throw.
        linear: its residual and slopes.
        model: noise and scatter.
        factor: Cholesky factors of the blocks' covariances.
        beside: projection of the unmodelled effects (`beside_named`), which is subtracted.
    """
    names = {block.name: block.rows for block in prepared.blocks}
    columns = _columns(prepared, linear, model)
    table = np.empty_like(columns)
    for block, lower in zip(prepared.blocks, factor, strict=True):
        table[block.rows] = whiten(lower, columns[block.rows])
    if beside is not None:
        _subtract_projection(table, beside, model)
    return Whitened(table, prepared.input.progress_ratio, names, table.T @ table)


@cache
def _named() -> tuple[str, ...]:
    """Keys of the library's parameters."""
    return tuple(p.key for p in library())


def healthy_mean_of(model: NoiseModel, names: Sequence[str]) -> Array:
    """Deviations that all healthy machines share, in the order of names."""
    return np.array([model.healthy_mean.get(name, 0.0) for name in names])


def _columns(prepared: PreparedThrow, linear: LinearThrow, model: NoiseModel) -> Array:
    """The table's columns before whitening."""
    of_set = np.column_stack([set_columns(prepared, linear), unmodelled_columns(prepared, linear)])
    middle = healthy_mean_of(model, _named())
    of_throw = np.column_stack([throw_columns(prepared, linear), linear.jacobian])
    root = np.linalg.cholesky(model.throw_scatter.covariance(throw_nuisances()))
    usual = of_set[:, : len(SET_NUISANCES)] @ healthy_mean_of(model, SET_NUISANCES)
    residual = linear.residual - linear.jacobian @ middle - usual
    columns = np.column_stack([residual, linear.jacobian, of_set, of_throw @ root])
    # Only the ball and the impact can be missing, and their noise is white.
    columns[~np.isfinite(linear.residual)] = 0.0
    return columns


def beside_named(data: Information, plan: ParameterLayout) -> Array:
    """Projection of the unmodelled effects on the named parameters over all throws, (p, u).

    The part of an unmodelled effect that a named one explains belongs to the named one. Otherwise healthy
    machines would scatter along both and hide larger named effects. Sizes of the named have their wide
    prior.
    """
    named, first = plan.parameter_count, plan.size_count - len(unmodelled_names())
    precision = data.precision[:named, :named] + np.diag(plan.priors.slab_sd[:named] ** -2)
    return np.asarray(np.linalg.solve(precision, data.precision[:named, first:]), dtype=np.float64)


def _subtract_projection(table: Array, beside: Array, model: NoiseModel) -> None:
    """Subtract the projection of the unmodelled effects on the named, in place, and their healthy mean."""
    named, last = 1 + len(library()), 1 + slope_count()
    shapes = table[:, last - beside.shape[1] : last]
    shapes -= table[:, 1:named] @ beside
    table[:, 0] -= shapes @ healthy_mean_of(model, unmodelled_names())


def with_projection_subtracted(whitened: Whitened, beside: Array, model: NoiseModel) -> Whitened:
    """A throw whitened with complete unmodelled effects, after subtracting their projection on the named."""
    table = whitened.table.copy()
    _subtract_projection(table, beside, model)
    return replace(whitened, table=table, gram=table.T @ table)


def information(whitened: Sequence[Whitened]) -> list[Information]:
    """Information of each throw with nuisances marginalised, in the order of the layout."""
    return [_in_layout(w, len(library())) for w in whitened]


def _in_layout(whitened: Whitened, count: int) -> Information:
    """A drift's slopes are the parameters' times the throw's place in the set."""
    found = inform_gram(whitened.gram, slope_count())
    order = np.r_[0:count, 0:count, count : slope_count()]
    share = np.ones(order.size)
    share[count : 2 * count] = whitened.progress_ratio
    precision = found.precision[np.ix_(order, order)] * share[:, None] * share
    return Information(precision, found.gradient[order] * share)
