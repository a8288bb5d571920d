"""Sets that are told in noise of their own: what the noise alone is worth belongs to nobody."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from diagnosis.causes.leftovers import explained
from diagnosis.causes.selection import Information
from diagnosis.causes.whitening import Whitened
from diagnosis.healthy.noise import whiten
from diagnosis.loading.prepared import PreparedThrow
from machine.conventions import Array


class AtNone(NamedTuple):
    """A throw without any effect, the machine's scatter at its best values."""

    columns: Mapping[str, Array]
    """By block (n, 1 + q): what is left, and the throw's nuisances, in the channel's own unit."""
    lower: Mapping[str, Array]
    """Cholesky factors of the common noise, by block."""
    gram: Mapping[str, Array]
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
    lower = {block.name: own for block, own in zip(prepared.blocks, factor, strict=True)}
    white = {block.name: table[block.rows] for block in prepared.blocks}
    gram = {name: rows.T @ rows for name, rows in white.items()}
    columns = {name: lower[name] @ rows for name, rows in white.items()}
    return AtNone(columns, lower, gram, _log_likelihood(gram, lower))


def _log_likelihood(gram: Mapping[str, Array], lower: Mapping[str, Array]) -> float:
    """The throw's nuisances marginalised (`selection.inform`)."""
    whole = np.sum(list(gram.values()), axis=0)
    inner = np.eye(whole.shape[0] - 1) + whole[1:, 1:]
    fit = float(whole[0, 1:] @ np.linalg.solve(inner, whole[1:, 0]))
    volume = sum(float(np.log(np.diag(own)).sum()) for own in lower.values())
    return -0.5 * (float(whole[0, 0]) - fit + float(np.linalg.slogdet(inner)[1])) - volume


def in_common_noise(
    throws: Sequence[AtNone],
    factors: Sequence[Mapping[str, Array]],
    found: Sequence[Information],
) -> list[Information]:
    """What throws say in some noise, less what that noise has ahead of all other sets' at no effect.

    Joints that an effect shakes are told in wider noise, which makes all that is left there more probable,
    whatever explains the rest: with it a telescope's bias that did not exist came out 900 ahead beside a
    sticking boom that had been told in the common noise.

    Args:
        throws: without any effect.
        factors: of the noise that is their own, by block.
        found: what they say in it, throw after throw.
    """
    return [
        one._replace(log_volume=one.log_volume + _ahead(none, lower))
        for one, none, lower in zip(found, throws, factors, strict=True)
    ]


def _ahead(none: AtNone, lower: Mapping[str, Array]) -> float:
    """How much likelier a throw without any effect is in some noise than in the common one."""
    gram = dict(none.gram)
    for name in (n for n in gram if lower[n] is not none.lower[n]):
        rows = whiten(lower[name], none.columns[name])
        gram[name] = rows.T @ rows
    return _log_likelihood(gram, lower) - none.log_likelihood
