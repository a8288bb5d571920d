"""Noise and discrepancy of the recorded channels, and the whitening that follows from them.

The twin is never the machine: behind the sensor noise lies a discrepancy that grows with motion and lasts
about 0.2 s. For a channel sampled at t with motion levels m1, m2 (speed and acceleration):
cov = noise^2 I + D exp(-|t - t'| / tau) D, D = diag(floor + rate m1 + push m2).
The numbers stand in noise.json, measured on throws of virtual machines without any effect, each
against its own identified profile; scripts/calibrate_diagnosis.py made it.
"""

from collections.abc import Mapping
from functools import cache
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, Field
from scipy.linalg import solve_triangular

from machine.conventions import Array

NOISE_PATH = Path(__file__).with_name("noise.json")


class ChannelNoise(BaseModel):
    """One channel, in its own unit."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    noise_sd: float = Field(gt=0.0)
    """White, of one sample as compared."""
    floor_sd: float = Field(ge=0.0)
    """Discrepancy without motion."""
    rate_ratio: float = Field(ge=0.0)
    """Discrepancy a unit of the first motion level."""
    push_ratio: float = Field(ge=0.0)
    """Discrepancy a unit of the second motion level."""
    memory_s: float = Field(gt=0.0)


class NoiseModel(BaseModel):
    """All that was measured on machines without an effect."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    note: str
    channels: Mapping[str, ChannelNoise]
    """By block name."""
    nuisance_sd: Mapping[str, float]
    """Of a throw: what differs from throw to throw on a healthy machine."""
    set_nuisance_sd: Mapping[str, float]
    """Of a set of throws: sensor offsets and the like."""
    tolerance: Mapping[str, float]
    """Spike by parameter key: what healthy machines scatter in the direction of an effect."""
    healthy_mean: Mapping[str, float]
    """Middle of that scatter, by parameter key and nuisance: what is off on every machine. Effects are
    deviations from it."""
    healthy_gap_m: Mapping[str, float]
    """Impact gap of healthy machines by mode, root mean square, with the healthy filters."""
    unknown_level: Mapping[str, tuple[float, float]]
    """By block: mean and standard deviation over healthy sets of log(residual power), after the fit."""

    def with_jitter(self, extra_sd_s: float) -> "NoiseModel":
        """The model of a machine whose opening scatters by this much more."""
        release = float(np.hypot(self.nuisance_sd["release_delay_s"], extra_sd_s))
        return self.model_copy(
            update={"nuisance_sd": {**self.nuisance_sd, "release_delay_s": release}}
        )


@cache
def load_noise(path: Path = NOISE_PATH) -> NoiseModel:
    """Read the calibrated model."""
    return NoiseModel.model_validate_json(path.read_text(encoding="utf-8"))


def whitener(
    channel: ChannelNoise, t_s: Array, rate: Array, push: Array, extra_sd: Array | None = None
) -> Array:
    """Lower Cholesky factor (n, n) of a channel's covariance at times (n,) with motion levels (n,).

    `extra_sd` (n,) is more discrepancy, added in squares.
    """
    spread = channel.floor_sd + channel.rate_ratio * rate + channel.push_ratio * push
    if extra_sd is not None:
        spread = np.hypot(spread, extra_sd)
    near = np.exp(-np.abs(t_s[:, None] - t_s[None, :]) / channel.memory_s)
    covariance = spread[:, None] * near * spread[None, :]
    covariance[np.diag_indices_from(covariance)] += channel.noise_sd**2
    return np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)


def whiten(factor: Array, values: Array) -> Array:
    """Apply the inverse of a factor (n, n) to values (n,) or (n, columns)."""
    return np.asarray(solve_triangular(factor, values, lower=True, check_finite=False))
