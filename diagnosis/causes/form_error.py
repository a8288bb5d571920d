"""Noise of a throw's blocks: that of a healthy machine, and what a real effect adds that the twin has not."""

from collections.abc import Collection, Sequence

import numpy as np

from diagnosis.causes.parameters import ROUGH_EFFECTS
from diagnosis.healthy.noise import NoiseModel, whitener
from diagnosis.loading.prepared import Block, PreparedThrow
from machine.conventions import Array
from sim_twin.effects.effect import Effect
from sim_twin.effects.table import effects_where

FORM_ERROR_RATIO = {"actuation": 0.2, "swing": 0.05, "flight": 0.05}
"""Discrepancy of a real effect from the library's by stage, as a share of what the twin is off there: what
true effects at their best sizes left on 8 development sets beyond a healthy machine's discrepancy. Drives:
0.15, 0.18, 0.18, 0.19, 0.3, 0.55, 0.6 (and 1.15 for a slew whose play began at a side that nobody knows);
swing: 0.03, 0.06, 0.08; flight: 0.06."""
ALIKE_ERROR_RATIO = {"actuation": 0.1, "swing": 0.05}
"""Of an effect's signal, the share that may look like another named effect in all throws alike. A drive's
form error mostly looks like none: with 0.2 as for the noise, 38 of 64 development pairs (seed 20261130) were
right, and what was missing was mostly a second effect at the same joint. With 0.1, for the two below and for
shapes as well, 41 were; of 37 singles (seed 20261131) 23 with either."""
RESPONSE_EFFECTS = effects_where(lambda e: e.stage == "actuation" and e.growth == "delay")
"""Dead time and lag of the drive. They may look like each other by all of `FORM_ERROR_RATIO`: whether the
spool's own lag grows or another lag comes behind it is not known."""
SHAKE_RATIO = 0.2
"""Of what stiction or play changes at a joint, the others move with it: the twin's move alone. On three
development sets the telescope was off by 0.1, 0.2 and 0.3 of what the dipper was."""


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
    prepared: PreparedThrow, model: NoiseModel, healthy: Sequence[Array], off: Array
) -> list[Array]:
    """Factors with the discrepancy that an effect brings, whichever it is.

    A real effect is never quite the library's: a share of what the twin is off is added to the discrepancy.
    It is the same under every hypothesis, so that none is preferred for the noise that it brings.

    Args:
        prepared: the throw.
        model: noise.
        healthy: factors without it.
        off: (n,) what the twin without any effect leaves of the throw.
    """
    return [
        _with(model, block, lower, _of_form(block, lower, off))
        for block, lower in zip(prepared.blocks, healthy, strict=True)
    ]


def shaken(
    prepared: PreparedThrow,
    model: NoiseModel,
    healthy: Sequence[Array],
    common: Sequence[Array],
    off: Array,
    change: Array,
    rough: Collection[str],
) -> list[Array]:
    """Factors with what effects bring that shake the other joints as well.

    Args:
        prepared: the throw.
        model: noise.
        healthy: factors of a healthy machine.
        common: those with the discrepancy that any effect brings (`widened`); of blocks that nothing shakes
            they are kept.
        off: (n,) what the twin without any effect leaves of the throw.
        change: (n,) what the effects change.
        rough: blocks of their joints.
    """
    shaking = [b.rows for b in prepared.blocks if b.name in rough]
    found: list[Array] = []
    for block, lower, usual in zip(prepared.blocks, healthy, common, strict=True):
        if not block.name.startswith("actuation") or block.name in rough:
            found.append(usual)
            continue
        extra = _of_form(block, lower, off)
        for rows in shaking:
            extra = extra + SHAKE_RATIO * _clear(change[rows], lower)
        found.append(_with(model, block, lower, extra))
    return found


def _of_form(block: Block, lower: Array, off: Array) -> Array:
    """More discrepancy (n,) of a block for the form of effects."""
    ratio = FORM_ERROR_RATIO.get(block.name.partition(".")[0], 0.0)
    return ratio * _clear(off[block.rows], lower)


def _with(model: NoiseModel, block: Block, lower: Array, extra: Array) -> Array:
    channel = model.channels[block.name]
    return whitener(channel, block.t_s, block.rate, block.push, extra) if extra.any() else lower


def _clear(change: Array, lower: Array) -> Array:
    """Size (n,) of a change around each row, as far as it stands out of a healthy machine's noise.

    What drowns in the noise must not excuse more of it.
    """
    size = np.abs(np.nan_to_num(change))
    around = np.max([np.roll(size, k) for k in range(-2, 3)], axis=0)
    return np.maximum(around - 2.0 * np.sqrt(np.sum(lower**2, axis=1)), 0.0)
