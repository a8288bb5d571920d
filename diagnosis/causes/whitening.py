"""From residuals and slopes of a throw to what they say about the parameters: whitening and nuisances.

A nuisance is something that differs on a healthy machine, from throw to throw (oil temperature, bus phase,
grasp, jitter of the opening, swing at the start) or from set to set (sensor offsets). Each is a column of
slopes times its standard deviation; all of them are marginalised, none is ever a cause.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from diagnosis.causes.nuisances import set_columns, throw_columns, throw_nuisances
from diagnosis.causes.parameters import (
    ROUGH_EFFECTS,
    SET_NUISANCES,
    Layout,
    library,
    set_names,
)
from diagnosis.causes.residuals import Linear
from diagnosis.causes.selection import Information, inform_gram
from diagnosis.causes.shapes import unheard_names
from diagnosis.causes.unheard import unheard_columns
from diagnosis.healthy.noise import NoiseModel, whiten, whitener
from diagnosis.loading.prepared import PreparedThrow
from machine.conventions import Array, IntArray
from sim_twin.effects.effect import Effect

FORM_ERROR_RATIO = {"actuation": 0.2, "swing": 0.05, "flight": 0.05}
"""Discrepancy of a real effect from the library's by stage, as a share of what the twin is off there: what
true effects at their best sizes left on 8 development sets beyond a healthy machine's discrepancy. Drives:
0.15, 0.18, 0.18, 0.19, 0.3, 0.55, 0.6 (and 1.15 for a slew whose play began at a side that nobody knows);
swing: 0.03, 0.06, 0.08; flight: 0.06."""
JUMP_SD = 4.0
"""A joint that breaks loose jumps within a tick: two samples of 20 standard deviations, and as the twin says
before and after, on a development set with a telescope that sticks."""
SHAKE_RATIO = 0.2
"""Of what stiction or play changes at a joint, the others move with it: the twin's move alone. On three
development sets the telescope was off by 0.1, 0.2 and 0.3 of what the dipper was."""
DEAF_BLOCKS = "swing.accel"
"""Joints that stop or break loose within a tick shake the gripper by more than smoothed joint motion can tell
(up to 9 standard deviations on sets with stiction or backlash): no measure of what is left unexplained."""
SHAKEN_BLOCKS = ("actuation", "swing.gyro")
"""And the other joints: no measure where the best cause is of that kind (telescope 5.8 to 8.2 standard
deviations on three sets with stiction or play of the dipper)."""
OPENING = "release.switch"


def slope_count() -> int:
    """Columns of `Whitened.slopes`."""
    return len(library()) + len(set_names())


@dataclass(frozen=True, slots=True)
class Whitened:
    """A throw in units of its own noise."""

    table: Array
    """(n, 2 + p + s + q): residual, carried back to no effect along the slopes; residual without any effect;
    slopes by the library's parameters, then by the set's nuisances; and by what differs from throw to throw,
    in independent directions of unit spread."""
    progress_ratio: float
    """Share of a drift that acts in this throw."""
    rows: Mapping[str, slice]
    """Rows of each block."""
    log_volume: float
    """Sum of the logs of the noise's Cholesky diagonals."""
    gram: Array
    """(2 + p + s + q,) squared: products of the table's columns."""

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


@dataclass(frozen=True, slots=True)
class Basis:
    """A throw without any effect: what hypotheses that leave blocks as they are need not whiten again."""

    linear: Linear
    factor: Sequence[Array]
    whitened: Whitened
    beside: Array
    """What named slopes explain of the shapes (`beside_named`)."""


def factors(prepared: PreparedThrow, model: NoiseModel) -> list[Array]:
    """Cholesky factor of every block's covariance on a healthy machine."""
    return [
        whitener(model.channels[block.name], block.t_s, block.rate, block.push)
        for block in prepared.blocks
    ]


def rough_blocks(effects: Sequence[Effect]) -> set[str]:
    """Blocks of joints whose motion these effects make rough (`ROUGH_EFFECTS`)."""
    return {f"actuation.{e.joint}" for e in effects if e.effect in ROUGH_EFFECTS}


def widened(
    prepared: PreparedThrow,
    model: NoiseModel,
    healthy: Sequence[Array],
    off: Array,
    change: Array | None = None,
    rough: Collection[str] = (),
) -> list[Array]:
    """Factors with the discrepancy that an effect brings, whichever it is.

    A real effect is never quite the library's: a share of what the twin is off is added to the discrepancy.
    It is the same under every hypothesis, so that none is preferred for the noise that it brings.

    Args:
        prepared: the throw.
        model: noise.
        healthy: factors without it.
        off: (n,) what the twin without any effect leaves of the throw.
        change: (n,) what effects change that shake the other joints.
        rough: blocks of the joints of these effects.
    """
    shaking = [b.rows for b in prepared.blocks if b.name in rough]
    found: list[Array] = []
    for block, lower in zip(prepared.blocks, healthy, strict=True):
        extra = FORM_ERROR_RATIO.get(block.name.partition(".")[0], 0.0) * _clear(
            off[block.rows], lower
        )
        if change is not None and block.name.startswith("actuation") and block.name not in rough:
            for rows in shaking:
                extra = extra + SHAKE_RATIO * _clear(change[rows], lower)
        channel = model.channels[block.name]
        found.append(
            whitener(channel, block.t_s, block.rate, block.push, extra) if extra.any() else lower
        )
    return found


def _clear(change: Array, lower: Array) -> Array:
    """Size (n,) of a change around each row, as far as it stands out of a healthy machine's noise.

    What drowns in the noise must not excuse more of it.
    """
    size = np.abs(np.nan_to_num(change))
    around = np.max([np.roll(size, k) for k in range(-2, 3)], axis=0)
    return np.maximum(around - 2.0 * np.sqrt(np.sum(lower**2, axis=1)), 0.0)


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
        beside: what named slopes explain of the shapes (`beside_named`); that of the basis if left out.
    """
    own = linear if basis is None else basis.linear
    beside = basis.beside if beside is None and basis is not None else beside
    log_volume = float(sum(np.log(np.diag(lower)).sum() for lower in factor))
    names = {block.name: block.rows for block in prepared.blocks}
    changed = [
        (block, lower)
        for place, (block, lower) in enumerate(zip(prepared.blocks, factor, strict=True))
        if basis is None or not _same(linear, lower, basis, block.rows, place)
    ]
    if basis is None:
        table = np.empty((linear.residual.size, 2 + slope_count() + len(throw_nuisances())))
        gram = np.zeros((table.shape[1],) * 2)
    else:
        table, gram = basis.whitened.table.copy(), basis.whitened.gram.copy()
    if changed:
        rows = np.concatenate([np.arange(b.rows.start, b.rows.stop) for b, _ in changed])
        columns = _columns(prepared, linear, own, model, rows)
        first = 0
        for block, lower in changed:
            part = block.rows
            last = first + part.stop - part.start
            if basis is not None:
                gram -= table[part].T @ table[part]
            table[part] = whiten(lower, columns[first:last])
            if beside is not None:
                _take_off(table[part], beside, model)
            gram += table[part].T @ table[part]
            first = last
    return Whitened(table, prepared.input.progress_ratio, names, log_volume, gram)


def _same(linear: Linear, lower: Array, basis: Basis, rows: slice, place: int) -> bool:
    """Whether a block is what it is without effects."""
    return (
        lower is basis.factor[place]
        and np.array_equal(linear.residual[rows], basis.linear.residual[rows], equal_nan=True)
        and np.array_equal(linear.jacobian[rows], basis.linear.jacobian[rows])
    )


def _columns(
    prepared: PreparedThrow, linear: Linear, own: Linear, model: NoiseModel, rows: IntArray
) -> Array:
    """The table's columns before whitening, at some rows."""
    of_set = np.column_stack([set_columns(prepared, linear), unheard_columns(prepared, own)])[rows]
    middle = np.array([model.healthy_mean.get(p.key, 0.0) for p in library()])
    middle_of_set = np.array([model.healthy_mean.get(name, 0.0) for name in SET_NUISANCES])
    jacobian = linear.jacobian[rows]
    of_throw = np.column_stack([throw_columns(prepared, own)[rows], own.jacobian[rows]])
    root = np.linalg.cholesky(model.throw_scatter.covariance(throw_nuisances()))
    usual = of_set[:, : len(SET_NUISANCES)] @ middle_of_set
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
    middle = np.array([model.healthy_mean.get(name, 0.0) for name in unheard_names()])
    table[:, :2] -= (shapes @ middle)[:, None]


def apart(whitened: Whitened, beside: Array, model: NoiseModel) -> Whitened:
    """A throw that was whitened with the shapes as they are, with what is left of them beside the named."""
    table = whitened.table.copy()
    _take_off(table, beside, model)
    return replace(whitened, table=table, gram=table.T @ table)


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


def explained(whitened: Whitened, mean: Array) -> Array:
    """What parameters in the order of the layout (size,) make of a throw, (n,), whitened."""
    count = len(library())
    acting = mean[:count] + whitened.progress_ratio * mean[count : 2 * count]
    return whitened.slopes @ np.concatenate([acting, mean[2 * count :]])


def in_units(prepared: PreparedThrow, factor: Sequence[Array], white: Array) -> Array:
    """A whitened vector (n,) in the channels' own units."""
    out = np.zeros_like(white)
    for block, lower in zip(prepared.blocks, factor, strict=True):
        out[block.rows] = lower @ white[block.rows]
    return out


def left_of(whitened: Whitened, mean: Array) -> Array:
    """What parameters `mean` and the throw's nuisances at their best values leave of it, (n,), whitened."""
    unexplained = whitened.residual - explained(whitened, mean)
    nuisance = whitened.nuisance
    inner = np.eye(nuisance.shape[1]) + nuisance.T @ nuisance
    return unexplained - nuisance @ np.linalg.solve(inner, nuisance.T @ unexplained)


def leftovers(
    whitened: Whitened, mean: Array, rough: Collection[str] = ()
) -> dict[str, tuple[float, int]]:
    """Power of what is left in each block of a throw after the parameters `mean` (p,), and its rows.

    The throw's nuisances are set to their best values first. In the blocks named `rough` no row counts for
    more than `JUMP_SD`.
    """
    unexplained = whitened.residual - explained(whitened, mean)
    nuisance = whitened.nuisance
    left = left_of(whitened, mean)
    left = {
        name: np.clip(left[rows], -JUMP_SD, JUMP_SD) if name in rough else left[rows]
        for name, rows in whitened.rows.items()
    }
    power = {
        name: (float(left[name] @ left[name]), rows.stop - rows.start)
        for name, rows in whitened.rows.items()
    }
    if OPENING in whitened.rows:
        # Nuisances could take all of the opening's single row: it is held against their spread instead.
        row = whitened.rows[OPENING].start
        spread = 1.0 + float(nuisance[row] @ nuisance[row])
        power[OPENING] = float(unexplained[row]) ** 2 / spread, 1
    return power


def levels(
    whitened: Sequence[Whitened], mean: Array, rough: Collection[str] = ()
) -> dict[str, float]:
    """Log of the residual power per row of every block, after the parameters `mean`, over all throws."""
    power: dict[str, float] = {}
    rows: dict[str, int] = {}
    for one in whitened:
        for name, (square, count) in leftovers(one, mean, rough).items():
            power[name] = power.get(name, 0.0) + square
            rows[name] = rows.get(name, 0) + count
    return {name: float(np.log(power[name] / rows[name])) for name in power if rows[name]}
