"""Noise of a throw's blocks: that of a healthy machine, and the error of the effects' models."""

from collections.abc import Collection, Sequence

import numpy as np

from diagnosis.healthy.noise import NoiseModel, whitener
from diagnosis.linearisation.parameters import NONSMOOTH_EFFECTS
from diagnosis.loading.prepared import Block, PreparedThrow
from diagnosis.tuning import EXCITATION_RATIO, MODEL_ERROR_RATIO
from machine.conventions import Array
from sim_twin.effects.effect import Effect
from sim_twin.effects.table import effects_where

RESPONSE_EFFECTS = effects_where(lambda e: e.stage == "actuation" and e.growth == "delay")
"""Effects that look like each other by all of `MODEL_ERROR_RATIO`: whether a lag is that of the spool or
of a second element behind it is not known."""


def factors(prepared: PreparedThrow, model: NoiseModel) -> list[Array]:
    """Cholesky factor of every block's covariance on a healthy machine."""
    return [
        whitener(model.channels[block.name], block.t_s, block.rate, block.push)
        for block in prepared.blocks
    ]


def nonsmooth_blocks(effects: Sequence[Effect]) -> set[str]:
    """Blocks of joints whose motion these effects make nonsmooth."""
    return {f"actuation.{e.joint}" for e in effects if e.effect in NONSMOOTH_EFFECTS}


def with_common_error(
    prepared: PreparedThrow, model: NoiseModel, healthy: Sequence[Array], off: Array
) -> list[Array]:
    """Factors with the model error of effects in general.

    A share of the twin's deviation is added to the discrepancy. It is the same under every hypothesis, so
    that none is preferred for its noise.

    Args:
        prepared: the throw.
        model: noise.
        healthy: factors without it.
        off: (n,) residual of the throw without effect.
    """
    return [
        _with(model, block, lower, _model_error(block, lower, off))
        for block, lower in zip(prepared.blocks, healthy, strict=True)
    ]


def with_excited_joints(
    prepared: PreparedThrow,
    model: NoiseModel,
    healthy: Sequence[Array],
    common: Sequence[Array],
    off: Array,
    change: Array,
    nonsmooth: Collection[str],
) -> list[Array]:
    """Factors with the model error of effects that excite other joints.

    Args:
        prepared: the throw.
        model: noise.
        healthy: factors of a healthy machine.
        common: factors with the model error of effects in general (`with_common_error`), for blocks that
            are not excited.
        off: (n,) residual of the throw without effect.
        change: (n,) change by the effects.
        nonsmooth: blocks of their joints.
    """
    shaking = [b.rows for b in prepared.blocks if b.name in nonsmooth]
    found: list[Array] = []
    for block, lower, usual in zip(prepared.blocks, healthy, common, strict=True):
        if not block.name.startswith("actuation") or block.name in nonsmooth:
            found.append(usual)
            continue
        extra = _model_error(block, lower, off)
        for rows in shaking:
            extra = extra + EXCITATION_RATIO * _clear(change[rows], lower)
        found.append(_with(model, block, lower, extra))
    return found


def _model_error(block: Block, lower: Array, off: Array) -> Array:
    """Additional discrepancy (n,) of a block for the model error of effects."""
    ratio = MODEL_ERROR_RATIO.get(block.name.partition(".")[0], 0.0)
    return ratio * _clear(off[block.rows], lower)


def _with(model: NoiseModel, block: Block, lower: Array, extra: Array) -> Array:
    channel = model.channels[block.name]
    return whitener(channel, block.t_s, block.rate, block.push, extra) if extra.any() else lower


def _clear(change: Array, lower: Array) -> Array:
    """Magnitude (n,) of a change around each row, as far as it exceeds a healthy machine's noise.

    A change within the noise must not widen the noise.
    """
    size = np.abs(np.nan_to_num(change))
    around = np.max([np.roll(size, k) for k in range(-2, 3)], axis=0)
    return np.maximum(around - 2.0 * np.sqrt(np.sum(lower**2, axis=1)), 0.0)
