"""The covariance of a channel is found again from residuals that were drawn from it."""

import numpy as np
import pytest

from diagnosis.healthy.noise import ChannelNoise, whiten, whitener
from diagnosis.loading.prepared import Block
from diagnosis.population.channel_fit import Row, fitted_channel

TRUE = ChannelNoise(noise_sd=0.01, floor_sd=0.02, rate_ratio=0.1, push_ratio=0.0, memory_s=0.4)
OTHER = TRUE.model_copy(update={"floor_sd": 0.002, "rate_ratio": 0.0, "memory_s": 0.05})


def drawn(seed: int) -> Row:
    rng = np.random.default_rng(seed)
    t_s = np.cumsum(rng.uniform(0.01, 0.03, 150))
    rate, push = np.abs(np.sin(t_s)), np.abs(np.cos(3.0 * t_s))
    block = Block("actuation.slew", slice(0, t_s.size), t_s, rate, push)
    return block, whitener(TRUE, t_s, rate, push) @ rng.standard_normal(t_s.size)


def test_a_channel_is_found_from_its_residuals() -> None:
    found = fitted_channel(OTHER, [drawn(seed) for seed in range(16)])
    assert found.noise_sd == TRUE.noise_sd
    assert found.floor_sd == pytest.approx(TRUE.floor_sd, rel=0.4)
    assert found.rate_ratio == pytest.approx(TRUE.rate_ratio, rel=0.3)
    assert found.memory_s == pytest.approx(TRUE.memory_s, rel=0.4)
    power = [_power(found, drawn(seed)) for seed in range(100, 116)]
    assert np.mean(power) == pytest.approx(1.0, abs=0.1)


def _power(channel: ChannelNoise, row: Row) -> float:
    block, residual = row
    white = whiten(whitener(channel, block.t_s, block.rate, block.push), residual)
    return float(np.mean(white**2))
