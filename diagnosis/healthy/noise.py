"""Noise and discrepancy of the recorded channels, and whitening with them.

Behind the sensor noise the twin has a discrepancy that grows with motion and is correlated over about 0.2
s. For a channel sampled at t with motion levels m1, m2 (speed and acceleration): cov = noise^2 I + D
exp(-|t - t'| / tau) D, D = diag(floor + rate m1 + push m2). The values are in noise.json.
diagnosis/population/estimation.py estimates them on throws of virtual machines without an effect, each
against its own identified profile.
"""

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, Field
from scipy.linalg import solve_triangular

from machine.conventions import ACTIVE_JOINTS, Array
from machine.errors import UsageError
from sim_twin.effects.table import EFFECTS

NOISE_PATH = Path(__file__).with_name("noise.json")


class ChannelNoise(BaseModel):
    """Noise of one channel, in the channel's unit."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    noise_sd: float = Field(gt=0.0)
    """White noise of one compared sample."""
    floor_sd: float = Field(ge=0.0)
    """Discrepancy at rest."""
    rate_ratio: float = Field(ge=0.0)
    """Discrepancy per unit of the first motion level."""
    push_ratio: float = Field(ge=0.0)
    """Discrepancy per unit of the second motion level."""
    memory_s: float = Field(gt=0.0)
    """Correlation time of the discrepancy."""


class Scatter(BaseModel):
    """Joint deviations of healthy machines, or of the throws of one: standard deviations and correlations."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    names: tuple[str, ...]
    sd: tuple[float, ...]
    correlation: tuple[tuple[float, ...], ...]
    """Lower triangle, row by row, without the diagonal of ones and the zeros at the end of a row."""

    def covariance(self, names: Sequence[str]) -> Array:
        """Covariance (n, n) of these names, in their order.

        Raises:
            UsageError: healthy machines were measured without some of these.
        """
        place = {name: i for i, name in enumerate(self.names)}
        missing = [name for name in names if name not in place]
        if missing:
            raise UsageError(
                f"the model of healthy machines lacks {', '.join(missing)}; estimate it again by "
                "`python -m diagnosis.population.estimation FOLDER...`"
            )
        order = np.array([place[name] for name in names])
        full = np.eye(len(self.names))
        for row, values in enumerate(self.correlation):
            full[row, : len(values)] = values
            full[: len(values), row] = values
        sd = np.asarray(self.sd)[order]
        return sd[:, None] * full[np.ix_(order, order)] * sd

    def sd_of(self, name: str) -> float:
        """Standard deviation of one name."""
        return self.sd[self.names.index(name)]

    def with_sd(self, name: str, sd: float) -> "Scatter":
        """The same with another standard deviation of one name."""
        changed = tuple(
            sd if n == name else old for n, old in zip(self.names, self.sd, strict=True)
        )
        return self.model_copy(update={"sd": changed})

    def widened(self, sd: Mapping[str, float]) -> "Scatter":
        """With further deviations of some names, independent of all others, of these standard deviations."""
        more = np.array([sd.get(name, 0.0) for name in self.names])
        return Scatter.of(self.names, self.covariance(self.names) + np.diag(more**2))

    def within_parts(self) -> "Scatter":
        """The same with parts of the chain independent of each other.

        Nothing couples a valve of one joint with that of another or with the flight: such correlations
        of a finite number of machines are chance.
        """
        parts = np.array([part_of(name) for name in self.names])
        same = parts[:, None] == parts
        return Scatter.of(self.names, np.where(same, self.covariance(self.names), 0.0))

    @classmethod
    def of(cls, names: Sequence[str], covariance: Array) -> "Scatter":
        """From a covariance (n, n)."""
        sd = np.sqrt(np.diag(covariance))
        ratio = covariance / sd[:, None] / sd
        rows = [np.trim_zeros(np.round(ratio[i, :i], 4), "b").tolist() for i in range(sd.size)]
        sizes = tuple(float(f"{v:.4g}") for v in sd)
        return cls(names=tuple(names), sd=sizes, correlation=tuple(map(tuple, rows)))


class NoiseModel(BaseModel):
    """Everything that was estimated on machines without an effect."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    note: str
    channels: Mapping[str, ChannelNoise]
    """By block name."""
    throw_scatter: Scatter
    """Scatter between throws of a healthy machine."""
    machine_scatter: Scatter
    """Scatter between healthy machines, the same in all sets of one, over all parameters and nuisances
    of the set."""
    set_scatter: Scatter
    """Additional scatter between sets of one healthy machine."""
    drift_sd: Mapping[str, float]
    """By parameter key: drift of healthy machines within a set, one standard deviation."""
    healthy_mean: Mapping[str, float]
    """Mean of the scatter by parameter key and nuisance: the deviation that all machines share. Effects
    are deviations from it."""
    healthy_gap_m: Mapping[str, float]
    """Impact gap of healthy machines by mode, root mean square, with the healthy filters."""
    unknown_level: Mapping[str, tuple[float, float]]
    """By block: mean and standard deviation over healthy sets of the log residual power per row."""
    dropped_ratio: float = 0.0
    """Share of a set's throws, those with most residual power, that `unknown_level` leaves out."""

    def scatter(self, names: Sequence[str]) -> Array:
        """Covariance (n, n) of the deviations of one healthy set, in the order of names."""
        return self.machine_scatter.covariance(names) + self.set_scatter.covariance(names)

    def about(self, offsets: Mapping[str, float]) -> "NoiseModel":
        """The model of deviations from a twin that has these deviations already, by parameter key."""
        mean = {**self.healthy_mean}
        for name, size in offsets.items():
            mean[name] = mean.get(name, 0.0) - size
        return self.model_copy(update={"healthy_mean": mean})

    def with_jitter(self, extra_sd_s: float) -> "NoiseModel":
        """The model of a machine whose opening scatters by this much more."""
        release = float(np.hypot(self.throw_scatter.sd_of("release_delay_s"), extra_sd_s))
        wider = self.throw_scatter.with_sd("release_delay_s", release)
        return self.model_copy(update={"throw_scatter": wider})


def part_of(name: str) -> str:
    """The part of the chain that a parameter or nuisance belongs to: ``actuation.<joint>``, or a stage.

    What belongs to no effect and no joint counts to the release.
    """
    joint = next((j for j in ACTIVE_JOINTS if f".{j}." in name), None)
    if joint is not None:
        return f"actuation.{joint}"
    effect = EFFECTS.get(name.partition(".")[0])
    return "release" if effect is None else effect.stage


@cache
def load_noise(path: Path = NOISE_PATH) -> NoiseModel:
    """Read the calibrated model."""
    model = NoiseModel.model_validate_json(path.read_text(encoding="utf-8"))
    return model.model_copy(
        update={
            "machine_scatter": model.machine_scatter.within_parts(),
            "set_scatter": model.set_scatter.within_parts(),
        }
    )


def whitener(
    channel: ChannelNoise, t_s: Array, rate: Array, push: Array, extra_sd: Array | None = None
) -> Array:
    """Lower Cholesky factor (n, n) of a channel's covariance at times (n,) with motion levels (n,).

    `extra_sd` (n,) is additional discrepancy, added in squares.
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
