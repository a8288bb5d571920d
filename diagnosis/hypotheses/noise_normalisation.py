"""Normalisation of sets with a noise model of their own by the evidence of that noise alone."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from diagnosis.healthy.noise import whiten
from diagnosis.inference.evidence import Information
from diagnosis.linearisation.residual_power import prediction_of
from diagnosis.linearisation.whitening import Whitened
from diagnosis.loading.prepared import PreparedThrow
from machine.conventions import Array


class NoEffectThrow(NamedTuple):
    """A throw without effect, the machine's scatter at its best values; block by block."""

    columns: Sequence[Array]
    """(n, 1 + q): residual and the throw's nuisances, in the channel's unit."""
    lower: Sequence[Array]
    """Cholesky factors of the common noise."""
    gram: Sequence[Array]
    """Products of the whitened columns (1 + q, 1 + q)."""
    log_likelihood: float
    """Log likelihood in the common noise."""


def no_effect_throw(
    prepared: PreparedThrow, factor: Sequence[Array], whitened: Whitened, mean: Array
) -> NoEffectThrow:
    """A throw without effect, from its whitened columns.

    Args:
        prepared: the throw.
        factor: Cholesky factors of the blocks' covariances.
        whitened: the throw, whitened.
        mean: of all parameters, in the order of the layout.
    """
    left = whitened.residual - prediction_of(whitened, mean)
    table = np.column_stack([left, whitened.nuisance])
    white = [table[block.rows] for block in prepared.blocks]
    gram = [rows.T @ rows for rows in white]
    columns = [lower @ rows for lower, rows in zip(factor, white, strict=True)]
    return NoEffectThrow(columns, factor, gram, _log_likelihood(gram, factor))


def _log_likelihood(gram: Sequence[Array], lower: Sequence[Array]) -> float:
    """Log likelihood with the throw's nuisances marginalised (`evidence.inform`)."""
    whole = np.sum(gram, axis=0)
    inner = np.eye(whole.shape[0] - 1) + whole[1:, 1:]
    fit = float(whole[0, 1:] @ np.linalg.solve(inner, whole[1:, 0]))
    volume = sum(float(np.log(np.diag(own)).sum()) for own in lower)
    return -0.5 * (float(whole[0, 0]) - fit + float(np.linalg.slogdet(inner)[1])) - volume


def in_common_noise(
    throws: Sequence[NoEffectThrow],
    factors: Sequence[Sequence[Array]],
    found: Sequence[Information],
) -> list[Information]:
    """Information of throws in a noise of their own, less the evidence that this noise alone gains.

    Joints that an effect excites have a wider noise, which makes any residual there more probable, whatever
    explains the rest. Subtract the evidence that the noise covariance alone accounts for, at no effect.

    Args:
        throws: without effect.
        factors: Cholesky factors of the noise of each throw's blocks.
        found: information in that noise, throw after throw.
    """
    return [
        one._replace(log_volume=one.log_volume + _ahead(none, factor))
        for one, none, factor in zip(found, throws, factors, strict=True)
    ]


def _ahead(none: NoEffectThrow, factor: Sequence[Array]) -> float:
    """Log likelihood of a throw without effect in some noise, minus that in the common noise."""
    gram = list(none.gram)
    for place, (lower, common) in enumerate(zip(factor, none.lower, strict=True)):
        if lower is not common:
            rows = whiten(lower, none.columns[place])
            gram[place] = rows.T @ rows
    return _log_likelihood(gram, factor) - none.log_likelihood
