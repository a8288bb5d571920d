"""The healthy model of one machine, estimated on its reference throws.

The model of the type says how far its machines are from their twins, and what residual they leave. Another
machine may deviate further, and its residual may be larger and last longer: what a twin of a given structure
misses on a machine, it misses in every throw. Four steps, each judged by the reference throws themselves:

1. The machine's own parameters have the wide priors of effects: it is not taken for one of its type.
2. The covariance of each channel is fitted to the residual of held-out throws.
3. From set to set every parameter scatters by no less than the effect table's tolerance.
4. What one half of the healthy throws shows as an effect, given the other half, is scatter of this machine.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from diagnosis.healthy.noise import ChannelNoise, NoiseModel, Scatter, whiten, whitener
from diagnosis.inference.evidence import Information, screen, total, weigh
from diagnosis.linearisation.model_error import factors
from diagnosis.linearisation.parameters import layout, library, scatter_names, set_names
from diagnosis.linearisation.residual_power import in_units, residual_after
from diagnosis.linearisation.sensitivities import LinearThrow
from diagnosis.linearisation.whitening import Whitened, information, whiten_throw
from diagnosis.loading.prepared import Block, PreparedThrow
from diagnosis.population.expectation_maximisation import fitted_channel
from diagnosis.population.hierarchical_prior import Levels, of_machine, set_likelihood
from machine.conventions import Array
from sim_twin.effects.table import effects_where

SMOOTH_EFFECTS = effects_where(lambda effect: effect.growth in ("linear", "curved", "delay"))
"""Effects whose deviations can be simulated at a posterior mean."""
OWN_EFFECTS = effects_where(
    lambda effect: effect.growth in ("linear", "curved", "delay") and not effect.is_of_load
)
"""Those that a machine's twin takes from its reference throws."""
MEASURED_STAGES = ("actuation", "swing")
"""Stages whose channels have enough samples in a throw for a covariance of their own."""
ROUND_COUNT = 8
"""Largest number of rounds in which scatter grows; a round that finds no effect ends them."""
_DRIFT = "drift:"

Row = tuple[Block, Array]
"""A channel of one throw, and its residual (n,) in the channel's unit."""


class ReferenceThrows(NamedTuple):
    """Healthy throws of one machine, linearised at "no effect"."""

    prepared: Sequence[PreparedThrow]
    linear: Sequence[LinearThrow]
    beside: Array
    """What the named parameters explain of the unmodelled effects (`beside_named`)."""

    def every_other(self, first: int) -> "ReferenceThrows":
        """One half: throws of either half are spread over the whole time."""
        return self._replace(prepared=self.prepared[first::2], linear=self.linear[first::2])

    def whitened(self, model: NoiseModel) -> list[Whitened]:
        """The throws in units of a model's noise."""
        return [
            whiten_throw(p, linear, model, factors(p, model), beside=self.beside)
            for p, linear in zip(self.prepared, self.linear, strict=True)
        ]


def machine_model(model: NoiseModel, reference: ReferenceThrows) -> NoiseModel:
    """The model of this machine from that of its type and its reference throws."""
    wide = with_wide_priors(model)
    measured = with_measured_noise(wide, reference)
    tolerant = with_set_tolerance(measured)
    consistent = with_scatter_between_halves(tolerant, reference)
    return with_posterior(consistent, information(reference.whitened(consistent)))


def with_wide_priors(model: NoiseModel) -> NoiseModel:
    """The model of a machine of which nothing is known but that effects with slopes may be part of it.

    A machine differs from its twin by more than the machines of the virtual type differ from theirs. Load and
    air are not part of it.
    """
    wide = {p.key: p.prior_sd for p in library() if p.effect in OWN_EFFECTS}
    return model.model_copy(update={"machine_scatter": model.machine_scatter.widened(wide)})


def with_measured_noise(model: NoiseModel, reference: ReferenceThrows) -> NoiseModel:
    """The model with this machine's channel covariances, and the level of residual that they leave.

    A covariance is fitted to the residual of one half of the throws after the parameters of the other half.
    It replaces that of the type if the half that it was not fitted to is more probable under it.
    """
    residuals = _held_out_residuals(model, reference)
    channels, levels = dict(model.channels), dict(model.unknown_level)
    for name, of_type in model.channels.items():
        rows = [
            (block, residual[block.rows])
            for p, residual in zip(reference.prepared, residuals, strict=True)
            if (block := p.block(name)) is not None
        ]
        if not name.startswith(MEASURED_STAGES) or len(rows) < len(residuals):
            continue
        gain = 0.0
        for half in (0, 1):
            fitted = fitted_channel(of_type, rows[1 - half :: 2])
            gain += _log_likelihood(fitted, rows[half::2]) - _log_likelihood(of_type, rows[half::2])
        if gain > 0.0:
            channels[name] = fitted_channel(of_type, rows)
        if name in levels:
            power = np.array([_power(channels[name], row) for row in rows])
            error = float(np.std(np.log(power), ddof=1)) / np.sqrt(power.size)
            sd = float(np.hypot(levels[name][1], error))
            levels[name] = float(np.log(power.mean())), sd
    return model.model_copy(update={"channels": channels, "unknown_level": levels})


def with_set_tolerance(model: NoiseModel) -> NoiseModel:
    """The model whose parameters scatter between sets by the effect table's tolerance, each by itself.

    Oil, grease and play change from day to day within what maintenance would leave alone.
    """
    tolerance = {p.key: p.tolerance for p in library()}
    return model.model_copy(update={"set_scatter": model.set_scatter.widened(tolerance)})


def with_scatter_between_halves(model: NoiseModel, reference: ReferenceThrows) -> NoiseModel:
    """The model with the scatter that one half of the reference throws shows given the other.

    The part of the twin's misfit that the covariances do not hold lies along the sensitivities of some
    effects. Healthy throws have no effect, so the most probable one, where it is more probable than none in
    one half, measures that misfit: its parameters scatter from set to set by its size.
    """
    data = information(reference.whitened(model))
    for _ in range(ROUND_COUNT):
        sizes: dict[str, float] = {}
        for half in (0, 1):
            other = with_posterior(model, data[1 - half :: 2])
            for name, size in _most_probable(other, reference.every_other(half)).items():
                sizes[name] = max(sizes.get(name, 0.0), size)
        if not sizes:
            break
        drift_sd = dict(model.drift_sd)
        for name, size in sizes.items():
            if name.startswith(_DRIFT):
                key = name.removeprefix(_DRIFT)
                drift_sd[key] = float(np.hypot(drift_sd[key], size))
        scatter = model.set_scatter.widened(sizes)
        model = model.model_copy(update={"set_scatter": scatter, "drift_sd": drift_sd})
    return model


def with_posterior(model: NoiseModel, data: Sequence[Information]) -> NoiseModel:
    """The model with the posterior of this machine's own share of the scatter.

    Args:
        model: whose machine scatter is the prior.
        data: what each reference throw says, whitened by the model.
    """
    names = scatter_names()
    levels = Levels(
        np.zeros(len(names)),
        model.machine_scatter.covariance(names),
        model.set_scatter.covariance(names),
    )
    mean, covariance = of_machine([set_likelihood(total(data), layout(model))], levels)
    return model.model_copy(
        update={
            "healthy_mean": {
                name: model.healthy_mean.get(name, 0.0) + float(off)
                for name, off in zip(names, mean, strict=True)
            },
            "machine_scatter": Scatter.of(names, covariance),
        }
    )


def _most_probable(model: NoiseModel, healthy: ReferenceThrows) -> dict[str, float]:
    """Magnitudes by key of the most probable single effect; empty where no effect is more probable."""
    plan = layout(model)
    priors = plan.priors._replace(looks_like=healthy.beside)
    base = screen(total(information(healthy.whitened(model))), priors)
    keys = [p.key for p in library()]
    names = (*keys, *(_DRIFT + key for key in keys), *set_names())
    groups = range(len(plan.groups))
    best = max((weigh(base, priors, (group,)) for group in groups), key=lambda one: one.log_odds)
    if best.log_odds <= 0.0:
        return {}
    index = priors.groups[best.members[0]].tolist()
    return {names[i]: abs(float(v)) for i, v in zip(index, best.mean, strict=True)}


def _held_out_residuals(model: NoiseModel, reference: ReferenceThrows) -> list[Array]:
    """Residual of every throw (n,) in the channels' units, after the parameters of the other half."""
    white = reference.whitened(model)
    data, priors = information(white), layout(model).priors
    means = [screen(total(data[1 - half :: 2]), priors).mean for half in (0, 1)]
    return [
        in_units(p, factors(p, model), residual_after(w, means[i % 2]))
        for i, (p, w) in enumerate(zip(reference.prepared, white, strict=True))
    ]


def _log_likelihood(channel: ChannelNoise, rows: Sequence[Row]) -> float:
    found = 0.0
    for block, residual in rows:
        factor = whitener(channel, block.t_s, block.rate, block.push)
        white = whiten(factor, residual)
        found -= 0.5 * float(white @ white) + float(np.log(np.diag(factor)).sum())
    return found


def _power(channel: ChannelNoise, row: Row) -> float:
    """Mean square of a whitened residual."""
    block, residual = row
    white = whiten(whitener(channel, block.t_s, block.rate, block.push), residual)
    return float(white @ white) / white.size
