"""What a set of effects leaves of a throw, channel by channel."""

from collections.abc import Collection, Sequence

import numpy as np

from diagnosis.causes.parameters import library
from diagnosis.causes.whitening import Whitened
from diagnosis.loading.prepared import PreparedThrow
from machine.conventions import Array

JUMP_SD = 4.0
"""A joint that breaks loose jumps within a tick: two samples of 20 standard deviations, and as the twin says
before and after, on a development set with a telescope that sticks."""
DEAF_BLOCKS = "swing.accel"
"""Joints that stop or break loose within a tick shake the gripper by more than smoothed joint motion can tell
(up to 9 standard deviations on sets with stiction or backlash): no measure of what is left unexplained."""
SHAKEN_BLOCKS = ("actuation", "swing.gyro")
"""And the other joints: no measure where the best cause is of that kind (telescope 5.8 to 8.2 standard
deviations on three sets with stiction or play of the dipper)."""
OPENING = "release.switch"


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
