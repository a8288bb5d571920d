"""The covariance of a channel (healthy/noise.py) under which its residuals are most probable.

Its discrepancy is a Markov process between samples, so that the likelihood of a throw takes one pass over its
samples (Kalman filter; A. Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, 3.4).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from diagnosis.healthy.noise import ChannelNoise
from diagnosis.loading.prepared import Block
from machine.conventions import Array, BoolArray

Row = tuple[Block, Array]
"""A channel of one throw, and its residual (n,) in the channel's unit."""

MEMORY_S = (0.01, 1.0)
"""Range of correlation times."""
SHARE = (1e-3, 1e2)
"""Range of each kind of discrepancy, as a share of what it would be alone."""
FIRST_SHARE, FIRST_MEMORY_S = (0.5, 0.3, 0.2), 0.1
"""Where the search begins."""
ROUND_COUNT = 200
"""Evaluations of the likelihood, at most."""


class _Samples(NamedTuple):
    """Rows of all throws side by side, filled up to the longest."""

    is_known: BoolArray
    """(k, throws)"""
    residual: Array
    step_s: Array
    """Time since the row before."""
    levels: Array
    """(3, k, throws): one, rate and push."""


def fitted_channel(old: ChannelNoise, rows: Sequence[Row]) -> ChannelNoise:
    """A channel with the discrepancy that its residuals show.

    Its white noise stays: it also stands for what a simulation on a grid of 10 ms cannot tell.

    Args:
        old: the channel.
        rows: blocks of that channel, one a throw, with their residuals.
    """
    samples = _samples(rows)
    size = np.sqrt(np.mean(samples.residual[samples.is_known] ** 2))
    # Each kind of discrepancy alone would make this much of the residual.
    alone = size / np.maximum(samples.levels[:, samples.is_known].mean(axis=1), 1e-9)
    scale = np.array([*alone, 1.0])
    low = np.log([*(SHARE[0],) * 3, MEMORY_S[0]])
    high = np.log([*(SHARE[1],) * 3, MEMORY_S[1]])

    def sizes(logs: Array) -> Array:
        return scale * np.exp(np.clip(logs, low, high))

    found = minimize(
        lambda logs: -_log_likelihood(samples, sizes(logs), old.noise_sd),
        np.log([*FIRST_SHARE, FIRST_MEMORY_S]),
        method="Nelder-Mead",
        options={"maxfev": ROUND_COUNT, "xatol": 0.05, "fatol": 1.0},
    )
    floor, rate, push, memory = sizes(found.x).tolist()
    return old.model_copy(
        update={"floor_sd": floor, "rate_ratio": rate, "push_ratio": push, "memory_s": memory}
    )


def _samples(rows: Sequence[Row]) -> _Samples:
    shape = max(residual.size for _, residual in rows), len(rows)
    is_known, residual, step = np.zeros(shape, np.bool_), np.zeros(shape), np.zeros(shape)
    levels = np.zeros((3, *shape))
    for throw, (block, own) in enumerate(rows):
        count = slice(own.size)
        is_known[count, throw], residual[count, throw] = True, own
        step[count, throw] = np.diff(block.t_s, prepend=block.t_s[:1])
        levels[:, count, throw] = np.ones(own.size), block.rate, block.push
    return _Samples(is_known, residual, step, levels)


def _log_likelihood(samples: _Samples, sizes: Array, noise_sd: float) -> float:
    """Log likelihood of all throws for floor, rate and push ratio, and memory (4,)."""
    spread = np.tensordot(sizes[:3], samples.levels, axes=1)
    share = np.exp(-samples.step_s / sizes[3])
    mean, variance = np.zeros(spread.shape[1]), np.ones(spread.shape[1])
    total = 0.0
    for known, residual, s, near in zip(
        samples.is_known, samples.residual, spread, share, strict=True
    ):
        mean, variance = near * mean, 1.0 + near**2 * (variance - 1.0)
        whole = s**2 * variance + noise_sd**2
        off = residual - s * mean
        total -= 0.5 * float(np.sum((np.log(whole) + off**2 / whole)[known]))
        gain = variance * s / whole
        mean, variance = mean + gain * off, variance * (1.0 - gain * s)
    return total
