"""Whitening factors of a throw's channels."""

from diagnosis.healthy.noise import NoiseModel, whitener
from diagnosis.loading.prepared import PreparedThrow
from machine.conventions import Array


def factors(prepared: PreparedThrow, model: NoiseModel) -> list[Array]:
    """Cholesky factor of every block's covariance on a healthy machine."""
    return [
        whitener(model.channels[block.name], block.t_s, block.rate, block.push)
        for block in prepared.blocks
    ]
