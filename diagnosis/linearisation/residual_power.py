"""Residual power of a throw after a set of effects, block by block."""

from collections.abc import Sequence

import numpy as np

from diagnosis.linearisation.parameters import library
from diagnosis.linearisation.whitening import Whitened
from diagnosis.loading.prepared import PreparedThrow
from machine.conventions import Array

INSENSITIVE_BLOCKS = "swing.accel"
"""Blocks that are no measure of what is unexplained: joints that stop or break loose within a tick
accelerate the gripper by more than smoothed joint motion shows."""
OPENING = "release.switch"


def prediction_of(whitened: Whitened, mean: Array) -> Array:
    """Prediction (n,), whitened, of parameters (size,) in the order of the layout."""
    count = len(library())
    acting = mean[:count] + whitened.progress_ratio * mean[count : 2 * count]
    return whitened.slopes @ np.concatenate([acting, mean[2 * count :]])


def in_units(prepared: PreparedThrow, factor: Sequence[Array], white: Array) -> Array:
    """A whitened vector (n,) in the channels' units."""
    out = np.zeros_like(white)
    for block, lower in zip(prepared.blocks, factor, strict=True):
        out[block.rows] = lower @ white[block.rows]
    return out


def residual_after(whitened: Whitened, mean: Array) -> Array:
    """Residual (n,), whitened, after parameters `mean` and the throw's nuisances at their best values."""
    unexplained = whitened.residual - prediction_of(whitened, mean)
    nuisance = whitened.nuisance
    inner = np.eye(nuisance.shape[1]) + nuisance.T @ nuisance
    return unexplained - nuisance @ np.linalg.solve(inner, nuisance.T @ unexplained)


def residual_power(whitened: Whitened, mean: Array) -> dict[str, tuple[float, int]]:
    """Residual power and number of rows of each block of a throw after the parameters `mean` (p,).

    The throw's nuisances are set to their best values first.
    """
    unexplained = whitened.residual - prediction_of(whitened, mean)
    nuisance = whitened.nuisance
    left = residual_after(whitened, mean)
    power = {
        name: (float(left[rows] @ left[rows]), rows.stop - rows.start)
        for name, rows in whitened.rows.items()
    }
    if OPENING in whitened.rows:
        # Nuisances could explain all of the opening's single row; it is compared with their spread.
        row = whitened.rows[OPENING].start
        spread = 1.0 + float(nuisance[row] @ nuisance[row])
        power[OPENING] = float(unexplained[row]) ** 2 / spread, 1
    return power


def levels(whitened: Sequence[Whitened], mean: Array) -> dict[str, float]:
    """Log residual power per row of every block over all throws, after the parameters `mean`."""
    power: dict[str, float] = {}
    rows: dict[str, int] = {}
    for one in whitened:
        for name, (square, count) in residual_power(one, mean).items():
            power[name] = power.get(name, 0.0) + square
            rows[name] = rows.get(name, 0) + count
    return {name: float(np.log(power[name] / rows[name])) for name in power if rows[name]}
