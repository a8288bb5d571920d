"""Noise and discrepancy of the recorded channels, and the whitening that follows from them.

The twin is never the machine: behind the sensor noise lies a discrepancy that grows with motion and lasts
about 0.2 s. For a channel sampled at t with motion levels m1, m2 (speed and acceleration):
cov = noise^2 I + D exp(-|t - t'| / tau) D, D = diag(floor + rate m1 + push m2).
The numbers stand in noise.json, measured on throws of virtual machines without any effect, each
against its own identified profile; diagnosis/healthy/calibration.py made it.
"""

from collections.abc import Mapping, Sequence
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


class Scatter(BaseModel):
    """How far healthy machines, or throws of one, are off in many directions together."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    names: tuple[str, ...]
    sd: tuple[float, ...]
    correlation: tuple[tuple[float, ...], ...]
    """Lower triangle, row by row, without the diagonal of ones and zeros at the end of a row."""

    def covariance(self, names: Sequence[str]) -> Array:
        """Covariance (n, n) of these names, in their order."""
        place = {name: i for i, name in enumerate(self.names)}
        order = np.array([place[name] for name in names])
        full = np.eye(len(self.names))
        for row, values in enumerate(self.correlation):
            full[row, : len(values)] = values
            full[: len(values), row] = values
        sd = np.asarray(self.sd)[order]
        return sd[:, None] * full[np.ix_(order, order)] * sd

    def sd_of(self, name: str) -> float:
        """Standard deviation of one of them."""
        return self.sd[self.names.index(name)]

    def with_sd(self, name: str, sd: float) -> "Scatter":
        """The same with another standard deviation of one of them."""
        changed = tuple(
            sd if n == name else old for n, old in zip(self.names, self.sd, strict=True)
        )
        return self.model_copy(update={"sd": changed})

    @classmethod
    def of(cls, names: Sequence[str], covariance: Array) -> "Scatter":
        """From a covariance (n, n)."""
        sd = np.sqrt(np.diag(covariance))
        ratio = covariance / sd[:, None] / sd
        rows = [np.trim_zeros(np.round(ratio[i, :i], 4), "b").tolist() for i in range(sd.size)]
        sizes = tuple(float(f"{v:.4g}") for v in sd)
        return cls(names=tuple(names), sd=sizes, correlation=tuple(map(tuple, rows)))


class NoiseModel(BaseModel):
    """All that was measured on machines without an effect."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    note: str
    channels: Mapping[str, ChannelNoise]
    """By block name."""
    throw_scatter: Scatter
    """What differs from throw to throw on a healthy machine."""
    machine_scatter: Scatter
    """What healthy machines are off in the direction of every parameter and nuisance of the set, each by its
    own and in all its sets."""
    set_scatter: Scatter
    """What one healthy machine is off from set to set on top of it."""
    drift_sd: Mapping[str, float]
    """By parameter key: what healthy machines drift within a set."""
    healthy_mean: Mapping[str, float]
    """Middle of that scatter, by parameter key and nuisance: what is off on every machine. Effects are
    deviations from it."""
    healthy_gap_m: Mapping[str, float]
    """Impact gap of healthy machines by mode, root mean square, with the healthy filters."""
    unknown_level: Mapping[str, tuple[float, float]]
    """By block: mean and standard deviation over healthy sets of log(residual power), after the fit."""

    def scatter(self, names: Sequence[str]) -> Array:
        """Covariance (n, n) of what a set of throws of a healthy machine is off, in the order of names."""
        return self.machine_scatter.covariance(names) + self.set_scatter.covariance(names)

    def with_jitter(self, extra_sd_s: float) -> "NoiseModel":
        """The model of a machine whose opening scatters by this much more."""
        release = float(np.hypot(self.throw_scatter.sd_of("release_delay_s"), extra_sd_s))
        wider = self.throw_scatter.with_sd("release_delay_s", release)
        return self.model_copy(update={"throw_scatter": wider})


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
