"""Whitening of a throw's residual and slopes, and marginalisation of its nuisances.

A nuisance is a deviation of a healthy machine between throws (oil temperature, bus phase, grasp, jitter of
the opening, initial swing) or between sets (sensor offsets). Each is a column of slopes times its standard
deviation. All are marginalised; none is ever a cause.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np

from diagnosis.healthy.noise import NoiseModel, whiten
from diagnosis.inference.evidence import Information, inform_gram
from diagnosis.linearisation.basis_functions import unmodelled_columns
from diagnosis.linearisation.nuisances import set_columns, throw_columns, throw_nuisances
from diagnosis.linearisation.parameters import SET_NUISANCES, ParameterLayout, library, set_names
from diagnosis.linearisation.sensitivities import LinearThrow
from diagnosis.linearisation.unmodelled_effects import unmodelled_names
from diagnosis.loading.prepared import Block, PreparedThrow
from machine.conventions import Array, IntArray


def slope_count() -> int:
    """Columns of `Whitened.slopes`."""
    return len(library()) + len(set_names())


Change = tuple[slice, IntArray, Array]
"""Rows, columns, and the values there."""


@dataclass(frozen=True)
class Whitened:
    """A throw in units of its noise."""

    first: Array
    """The table without the changes."""
    progress_ratio: float
    """Share of a drift that acts in this throw."""
    rows: Mapping[str, slice]
    """Rows of each block."""
    log_volume: float
    """Sum of the logs of the noise's Cholesky diagonals."""
    gram: Array
    """(2 + p + s + q,) squared: products of the table's columns."""
    changes: tuple[Change, ...] = ()

    @cached_property
    def table(self) -> Array:
        """All columns (n, 2 + p + s + q); previews need only their products.

        Residual, extrapolated to no effect along the slopes; residual without effect; slopes of the
        library's parameters, then of the set's nuisances; then the deviations between throws, in
        independent directions of unit variance.
        """
        if not self.changes:
            return self.first
        table = self.first.copy()
        for rows, columns, values in self.changes:
            table[rows, columns] = values
        return table

    @property
    def residual(self) -> Array:
        """Measured minus twin, (n,)."""
        return self.table[:, 0]

    @property
    def slopes(self) -> Array:
        """Of the parameters, then the nuisances of the set, (n, p + s)."""
        return self.table[:, 2 : 2 + slope_count()]

    @property
    def nuisance(self) -> Array:
        """Of the deviations between throws, (n, q)."""
        return self.table[:, 2 + slope_count() :]


class Moved(NamedTuple):
    """Columns of a block that differ from those of its throw without effect."""

    residual: Array
    """(n,) difference before whitening."""
    slopes: Array
    """(n, p) difference before whitening."""
    columns: IntArray
    """Indices in the table (k,)."""
    values: Array
    """Values (n, k)."""
    gram: Array
    """Difference of these columns of the throw's gram (columns, k)."""


@dataclass(frozen=True, slots=True)
class Basis:
    """A throw without effect, whose whitened blocks are reused by hypotheses that do not move them."""

    linear: LinearThrow
    factor: Sequence[Array]
    whitened: Whitened
    beside: Array
    """Projection of the unmodelled effects on the named slopes (`beside_named`)."""
    last: dict[str, Moved] = field(default_factory=dict[str, Moved])
    """By block, the last change: sets that follow each other often share an effect."""
    grams: dict[str, Array] = field(default_factory=dict[str, Array])
    """By block, its part of the gram, once computed."""

    def gram_of(self, block: Block) -> Array:
        """A block's part of the gram."""
        if block.name not in self.grams:
            rows = self.whitened.table[block.rows]
            self.grams[block.name] = rows.T @ rows
        return self.grams[block.name]


def whiten_throw(
    prepared: PreparedThrow,
    linear: LinearThrow,
    model: NoiseModel,
    factor: Sequence[Array],
    basis: Basis | None = None,
    beside: Array | None = None,
) -> Whitened:
    """Whiten a throw's blocks; rows that the twin could not predict count as no data.

    Args:
        prepared: the throw.
        linear: its residual and slopes.
        model: noise and scatter.
        factor: Cholesky factors of the blocks' covariances.
        basis: the throw without effect, whose slopes the nuisances have, so that hypotheses differ in their
            predictions and not in their scatter; `linear` if left out.
        beside: projection of the unmodelled effects (`beside_named`); that of the basis, if there is one.
    """
    log_volume = float(sum(np.log(np.diag(lower)).sum() for lower in factor))
    names = {block.name: block.rows for block in prepared.blocks}
    progress_ratio = prepared.input.progress_ratio
    if basis is not None:
        gram, changes = _changed(prepared, linear, model, factor, basis)
        return Whitened(basis.whitened.table, progress_ratio, names, log_volume, gram, changes)
    table = np.empty((linear.residual.size, 2 + slope_count() + len(throw_nuisances())))
    blocks = list(zip(prepared.blocks, factor, strict=True))
    for rows, _, values in _whitened(prepared, linear, linear, model, beside, blocks):
        table[rows] = values
    return Whitened(table, progress_ratio, names, log_volume, table.T @ table)


def _whitened(
    prepared: PreparedThrow,
    linear: LinearThrow,
    own: LinearThrow,
    model: NoiseModel,
    beside: Array | None,
    blocks: Sequence[tuple[Block, Array]],
) -> list[Change]:
    """Rows of blocks, whitened by their factors; nuisances and basis functions have the slopes of `own`."""
    if not blocks:
        return []
    columns = _columns(prepared, linear, own, model, np.r_[*(block.rows for block, _ in blocks)])
    found: list[Change] = []
    first = 0
    for block, lower in blocks:
        last = first + block.rows.stop - block.rows.start
        values = whiten(lower, columns[first:last])
        if beside is not None:
            _subtract_projection(values, beside, model)
        found.append((block.rows, np.arange(values.shape[1]), values))
        first = last
    return found


def _changed(
    prepared: PreparedThrow,
    linear: LinearThrow,
    model: NoiseModel,
    factor: Sequence[Array],
    basis: Basis,
) -> tuple[Array, tuple[Change, ...]]:
    """The gram of `linear`, and the changes of its table against that of the basis.

    Whitening is linear: in the same noise only the difference to the basis is whitened.
    """
    gram = basis.whitened.gram.copy()
    changes: list[Change] = []
    there = np.isfinite(linear.residual) == np.isfinite(basis.linear.residual)
    others: list[tuple[Block, Array]] = []
    for place, (block, lower) in enumerate(zip(prepared.blocks, factor, strict=True)):
        rows = block.rows
        if lower is not basis.factor[place] or not there[rows].all():
            others.append((block, lower))
            continue
        residual = np.nan_to_num(linear.residual[rows] - basis.linear.residual[rows])
        slopes = linear.jacobian[rows] - basis.linear.jacobian[rows]
        if residual.any() or slopes.any():
            moved = basis.last.get(block.name)
            if moved is None or not _is_of(moved, residual, slopes):
                moved = _moved(basis, rows, lower, model, residual, slopes)
                basis.last[block.name] = moved
            changes.append((rows, moved.columns, moved.values))
            gram[:, moved.columns] += moved.gram
            gram[moved.columns] = gram[:, moved.columns].T
    fresh = _whitened(prepared, linear, basis.linear, model, basis.beside, others)
    for (block, _), (_, _, after) in zip(others, fresh, strict=True):
        gram += after.T @ after - basis.gram_of(block)
    return gram, (*changes, *fresh)


def _is_of(moved: Moved, residual: Array, slopes: Array) -> bool:
    return np.array_equal(moved.residual, residual) and np.array_equal(moved.slopes, slopes)


def _moved(
    basis: Basis, rows: slice, lower: Array, model: NoiseModel, residual: Array, slopes: Array
) -> Moved:
    """Change of a block by differences (n,) and (n, p) before whitening."""
    named = np.flatnonzero(slopes.any(axis=0))
    change = np.column_stack(
        [residual - slopes @ healthy_mean_of(model, _named()), slopes[:, named]]
    )
    # Only the ball and the impact can be missing, and their noise is white.
    change[~np.isfinite(basis.linear.residual[rows])] = 0.0
    white = whiten(lower, change)
    shapes = -white[:, 1:] @ basis.beside[named]
    first = 2 + slope_count() - shapes.shape[1]
    of_all = shapes @ healthy_mean_of(model, unmodelled_names())
    steps = np.column_stack([white[:, 0] - of_all, -of_all, white[:, 1:], shapes])
    columns = np.r_[0, 1, 2 + named, first : first + shapes.shape[1]]
    before = basis.whitened.table[rows]
    after = before[:, columns] + steps
    gram = before.T @ steps
    gram[columns] += steps.T @ after
    return Moved(residual, slopes, columns, after, gram)


@cache
def _named() -> tuple[str, ...]:
    """Keys of the library's parameters."""
    return tuple(p.key for p in library())


def healthy_mean_of(model: NoiseModel, names: Sequence[str]) -> Array:
    """Deviations that all healthy machines share, in the order of names."""
    return np.array([model.healthy_mean.get(name, 0.0) for name in names])


def _columns(
    prepared: PreparedThrow,
    linear: LinearThrow,
    own: LinearThrow,
    model: NoiseModel,
    rows: IntArray,
) -> Array:
    """The table's columns before whitening, at some rows."""
    of_set = np.column_stack([set_columns(prepared, linear), unmodelled_columns(prepared, own)])[
        rows
    ]
    middle = healthy_mean_of(model, _named())
    jacobian = linear.jacobian[rows]
    of_throw = np.column_stack([throw_columns(prepared, own)[rows], own.jacobian[rows]])
    root = np.linalg.cholesky(model.throw_scatter.covariance(throw_nuisances()))
    usual = of_set[:, : len(SET_NUISANCES)] @ healthy_mean_of(model, SET_NUISANCES)
    columns = np.column_stack(
        [
            linear.residual[rows] - jacobian @ middle - usual,
            own.residual[rows] - own.jacobian[rows] @ middle - usual,
            jacobian,
            of_set,
            of_throw @ root,
        ]
    )
    # Only the ball and the impact can be missing, and their noise is white.
    columns[~np.isfinite(linear.residual[rows] + own.residual[rows])] = 0.0
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
    named, last = 2 + len(library()), 2 + slope_count()
    shapes = table[:, last - beside.shape[1] : last]
    shapes -= table[:, 2:named] @ beside
    table[:, :2] -= (shapes @ healthy_mean_of(model, unmodelled_names()))[:, None]


def with_projection_subtracted(whitened: Whitened, beside: Array, model: NoiseModel) -> Whitened:
    """A throw whitened with complete unmodelled effects, after subtracting their projection on the named."""
    table = whitened.table.copy()
    _subtract_projection(table, beside, model)
    return replace(whitened, first=table, gram=table.T @ table, changes=())


def information(whitened: Sequence[Whitened]) -> list[Information]:
    """Information of each throw with nuisances marginalised, in the order of the layout."""
    return [_in_layout(w, len(library())) for w in whitened]


def _in_layout(whitened: Whitened, count: int) -> Information:
    """A drift's slopes are the parameters' times the throw's place in the set."""
    found = inform_gram(whitened.gram, slope_count(), whitened.log_volume)
    order = np.r_[0:count, 0:count, count : slope_count()]
    share = np.ones(order.size)
    share[count : 2 * count] = whitened.progress_ratio
    precision = found.precision[np.ix_(order, order)] * share[:, None] * share
    return found._replace(
        precision=precision,
        gradient=found.gradient[order] * share,
        none_gradient=found.none_gradient[order] * share,
    )
