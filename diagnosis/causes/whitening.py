"""From residuals and slopes of a throw to what they say about the parameters: whitening and nuisances.

A nuisance is something that differs on a healthy machine, from throw to throw (oil temperature, bus phase,
grasp, jitter of the opening, swing at the start) or from set to set (sensor offsets). Each is a column of
slopes times its standard deviation; all of them are marginalised, none is ever a cause.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np

from diagnosis.causes.evidence import Information, inform_gram
from diagnosis.causes.linear import Linear
from diagnosis.causes.nuisances import set_columns, throw_columns, throw_nuisances
from diagnosis.causes.parameters import SET_NUISANCES, Layout, library, set_names
from diagnosis.causes.shapes import unheard_names
from diagnosis.causes.unheard import unheard_columns
from diagnosis.healthy.noise import NoiseModel, whiten
from diagnosis.loading.prepared import Block, PreparedThrow
from machine.conventions import Array, IntArray


def slope_count() -> int:
    """Columns of `Whitened.slopes`."""
    return len(library()) + len(set_names())


Change = tuple[slice, IntArray, Array]
"""Rows, columns, and what stands there."""


@dataclass(frozen=True)
class Whitened:
    """A throw in units of its own noise."""

    first: Array
    """The table, but for the changes."""
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
        """All columns (n, 2 + p + s + q); most of what is looked at roughly needs their products alone.

        Residual, carried back to no effect along the slopes; residual without any effect; slopes by the
        library's parameters, then by the set's nuisances; and by what differs from throw to throw, in
        independent directions of unit spread.
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
        """By the parameters, then the nuisances of the set, (n, p + s)."""
        return self.table[:, 2 : 2 + slope_count()]

    @property
    def nuisance(self) -> Array:
        """What differs from throw to throw, (n, q)."""
        return self.table[:, 2 + slope_count() :]


class Moved(NamedTuple):
    """Columns of a block that are not those of its throw without any effect."""

    residual: Array
    """(n,) by how much, before whitening."""
    slopes: Array
    """(n, p)"""
    columns: IntArray
    """Which of the table (k,)."""
    values: Array
    """What they are (n, k)."""
    gram: Array
    """By how much these columns of the throw's gram are others (columns, k)."""


@dataclass(frozen=True, slots=True)
class Basis:
    """A throw without any effect: what hypotheses that leave blocks as they are need not whiten again."""

    linear: Linear
    factor: Sequence[Array]
    whitened: Whitened
    beside: Array
    """What named slopes explain of the shapes (`beside_named`)."""
    last: dict[str, Moved] = field(default_factory=dict[str, Moved])
    """By block, of the set before: sets that are tried after each other often share an effect."""
    grams: dict[str, Array] = field(default_factory=dict[str, Array])
    """By block, its part of the gram, where it was asked for."""

    def gram_of(self, block: Block) -> Array:
        """A block's part of the gram."""
        if block.name not in self.grams:
            rows = self.whitened.table[block.rows]
            self.grams[block.name] = rows.T @ rows
        return self.grams[block.name]


def whiten_throw(
    prepared: PreparedThrow,
    linear: Linear,
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
        factor: of the blocks' covariances.
        basis: the throw without effects: its nuisances follow its slopes, so that hypotheses differ in what
            they predict, not in what they call scatter; `linear` if left out.
        beside: what named slopes explain of the shapes (`beside_named`); that of the basis, if there is one.
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
    linear: Linear,
    own: Linear,
    model: NoiseModel,
    beside: Array | None,
    blocks: Sequence[tuple[Block, Array]],
) -> list[Change]:
    """Rows of blocks, each whitened by its factor; nuisances and shapes have the slopes of `own`."""
    if not blocks:
        return []
    columns = _columns(prepared, linear, own, model, np.r_[*(block.rows for block, _ in blocks)])
    found: list[Change] = []
    first = 0
    for block, lower in blocks:
        last = first + block.rows.stop - block.rows.start
        values = whiten(lower, columns[first:last])
        if beside is not None:
            _take_off(values, beside, model)
        found.append((block.rows, np.arange(values.shape[1]), values))
        first = last
    return found


def _changed(
    prepared: PreparedThrow,
    linear: Linear,
    model: NoiseModel,
    factor: Sequence[Array],
    basis: Basis,
) -> tuple[Array, tuple[Change, ...]]:
    """The gram of `linear`, and what its table has that the basis' has not.

    Whitening is linear: in the same noise only what differs from the basis is whitened.
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
    """What differences (n,) and (n, p) before whitening make of a block."""
    named = np.flatnonzero(slopes.any(axis=0))
    change = np.column_stack(
        [residual - slopes @ healthy_middle(model, _named()), slopes[:, named]]
    )
    # Only the ball and the impact can be missing, and their noise is white.
    change[~np.isfinite(basis.linear.residual[rows])] = 0.0
    white = whiten(lower, change)
    shapes = -white[:, 1:] @ basis.beside[named]
    first = 2 + slope_count() - shapes.shape[1]
    of_all = shapes @ healthy_middle(model, unheard_names())
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


def healthy_middle(model: NoiseModel, names: Sequence[str]) -> Array:
    """What all healthy machines are off, in the order of names."""
    return np.array([model.healthy_mean.get(name, 0.0) for name in names])


def _columns(
    prepared: PreparedThrow, linear: Linear, own: Linear, model: NoiseModel, rows: IntArray
) -> Array:
    """The table's columns before whitening, at some rows."""
    of_set = np.column_stack([set_columns(prepared, linear), unheard_columns(prepared, own)])[rows]
    middle = healthy_middle(model, _named())
    jacobian = linear.jacobian[rows]
    of_throw = np.column_stack([throw_columns(prepared, own)[rows], own.jacobian[rows]])
    root = np.linalg.cholesky(model.throw_scatter.covariance(throw_nuisances()))
    usual = of_set[:, : len(SET_NUISANCES)] @ healthy_middle(model, SET_NUISANCES)
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


def beside_named(data: Information, plan: Layout) -> Array:
    """What named parameters explain of the shapes over all throws, (p, u).

    A gain that is the same all along is a gain. Otherwise healthy machines would scatter along both, and hide
    a gain three times as large. Sizes of the named ones have their wide prior.
    """
    named, first = plan.parameter_count, plan.size_count - len(unheard_names())
    precision = data.precision[:named, :named] + np.diag(plan.priors.slab_sd[:named] ** -2)
    return np.asarray(np.linalg.solve(precision, data.precision[:named, first:]), dtype=np.float64)


def _take_off(table: Array, beside: Array, model: NoiseModel) -> None:
    """Leave of the shapes, in place, what the named do not explain; and take off what all machines have."""
    named, last = 2 + len(library()), 2 + slope_count()
    shapes = table[:, last - beside.shape[1] : last]
    shapes -= table[:, 2:named] @ beside
    table[:, :2] -= (shapes @ healthy_middle(model, unheard_names()))[:, None]


def apart(whitened: Whitened, beside: Array, model: NoiseModel) -> Whitened:
    """A throw that was whitened with the shapes as they are, with what is left of them beside the named."""
    table = whitened.table.copy()
    _take_off(table, beside, model)
    return replace(whitened, first=table, gram=table.T @ table, changes=())


def information(whitened: Sequence[Whitened]) -> list[Information]:
    """What each throw says, nuisances marginalised, in the order of the layout."""
    return [_in_layout(w, len(library())) for w in whitened]


def _in_layout(whitened: Whitened, count: int) -> Information:
    """Drifts' slopes are the parameters' times the throw's place in the set."""
    found = inform_gram(whitened.gram, slope_count(), whitened.log_volume)
    order = np.r_[0:count, 0:count, count : slope_count()]
    share = np.ones(order.size)
    share[count : 2 * count] = whitened.progress_ratio
    precision = found.precision[np.ix_(order, order)] * share[:, None] * share
    return found._replace(
        precision=precision,
        gradient=found.gradient[order] * share,
        bare_gradient=found.bare_gradient[order] * share,
    )
