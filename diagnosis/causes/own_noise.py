"""Sets that are told in noise of their own: what the noise alone is worth belongs to nobody."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from diagnosis.causes.evidence import Information
from diagnosis.causes.leftovers import explained
from diagnosis.causes.whitening import Whitened
from diagnosis.healthy.noise import whiten
from diagnosis.loading.prepared import PreparedThrow
from machine.conventions import Array


class AtNone(NamedTuple):
    """A throw without any effect, the machine's scatter at its best values; block by block."""

    columns: Sequence[Array]
    """(n, 1 + q): what is left, and the throw's nuisances, in the channel's own unit."""
    lower: Sequence[Array]
    """Cholesky factors of the common noise."""
    gram: Sequence[Array]
    """Products of the columns (1 + q, 1 + q), whitened by it."""
    log_likelihood: float
    """In it."""


def at_none(
    prepared: PreparedThrow, factor: Sequence[Array], whitened: Whitened, mean: Array
) -> AtNone:
    """A throw without any effect, from its whitened columns.

    Args:
        prepared: the throw.
        factor: of the blocks' covariances.
        whitened: the throw in their units.
        mean: of all parameters, in the order of the layout.
    """
    left = whitened.residual - explained(whitened, mean)
    table = np.column_stack([left, whitened.nuisance])
    white = [table[block.rows] for block in prepared.blocks]
    gram = [rows.T @ rows for rows in white]
    columns = [lower @ rows for lower, rows in zip(factor, white, strict=True)]
    return AtNone(columns, factor, gram, _log_likelihood(gram, factor))


def _log_likelihood(gram: Sequence[Array], lower: Sequence[Array]) -> float:
    """The throw's nuisances marginalised (`selection.inform`)."""
    whole = np.sum(gram, axis=0)
    inner = np.eye(whole.shape[0] - 1) + whole[1:, 1:]
    fit = float(whole[0, 1:] @ np.linalg.solve(inner, whole[1:, 0]))
    volume = sum(float(np.log(np.diag(own)).sum()) for own in lower)
    return -0.5 * (float(whole[0, 0]) - fit + float(np.linalg.slogdet(inner)[1])) - volume


def in_common_noise(
    throws: Sequence[AtNone], factors: Sequence[Sequence[Array]], found: Sequence[Information]
) -> list[Information]:
    """What throws say in some noise, less what that noise has ahead of all other sets' at no effect.

    Joints that an effect shakes are told in wider noise, which makes all that is left there more probable,
    whatever explains the rest: with it a telescope's bias that did not exist came out 900 ahead beside a
    sticking boom that had been told in the common noise.

    Args:
        throws: without any effect.
        factors: of the noise that is their own, of every throw's blocks.
        found: what they say in it, throw after throw.
    """
    return [
        one._replace(log_volume=one.log_volume + _ahead(none, factor))
        for one, none, factor in zip(found, throws, factors, strict=True)
    ]


def _ahead(none: AtNone, factor: Sequence[Array]) -> float:
    """How much likelier a throw without any effect is in some noise than in the common one."""
    gram = list(none.gram)
    for place, (lower, common) in enumerate(zip(factor, none.lower, strict=True)):
        if lower is not common:
            rows = whiten(lower, none.columns[place])
            gram[place] = rows.T @ rows
    return _log_likelihood(gram, factor) - none.log_likelihood
