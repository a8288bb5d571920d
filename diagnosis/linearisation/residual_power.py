"""Residual power of a throw after a set of effects, block by block."""

from collections.abc import Mapping, Sequence

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


def levels(whitened: Sequence[Whitened], mean: Array, dropped_ratio: float) -> dict[str, float]:
    """Log residual power per row of every block, after the parameters `mean` (`log_level`)."""
    power = throw_powers([residual_power(one, mean) for one in whitened])
    return {name: log_level(values, dropped_ratio) for name, values in power.items()}


def throw_powers(power: Sequence[Mapping[str, tuple[float, int]]]) -> dict[str, Array]:
    """Power per row of every throw that has rows of a block, from power and rows of each block."""
    found: dict[str, list[float]] = {}
    for one in power:
        for name, (square, count) in one.items():
            if count:
                found.setdefault(name, []).append(square / count)
    return {name: np.array(values) for name, values in found.items()}


def log_level(power: Array, dropped_ratio: float) -> float:
    """Log of the mean power (n,) per row, without the throws that have most: this share, rounded down."""
    kept = np.sort(power)[: power.size - int(dropped_ratio * power.size)]
    return float(np.log(max(kept.mean(), 1e-12)))
