"""The healthy model of one machine, estimated on its reference throws.

The model of the type says how far its machines are from their twins, and what residual they leave. Another
machine may deviate further, and its residual may be larger and last longer: what a twin of a given structure
misses on a machine, it misses in every throw. Three steps, each judged by the reference throws themselves:

1. The machine's own parameters have the wide priors of effects: it is not taken for one of its type.
2. The covariance of each channel is fitted to the residual of held-out throws.
3. From set to set every parameter scatters by no less than the effect table's tolerance.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from diagnosis.healthy.noise import NoiseModel, Scatter
from diagnosis.linearisation.information import Information, healthy_posterior, total
from diagnosis.linearisation.model_error import factors
from diagnosis.linearisation.parameters import layout, library, scatter_names
from diagnosis.linearisation.residual_power import (
    in_units,
    log_level,
    residual_after,
    residual_power,
    throw_powers,
)
from diagnosis.linearisation.sensitivities import LinearThrow
from diagnosis.linearisation.whitening import Whitened, information, whiten_throw
from diagnosis.loading.prepared import PreparedThrow
from diagnosis.population.channel_fit import fitted_channel
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
DROPPED_RATIO = 1.0 / 6.0
"""Share of throws whose residual power does not count: fewer than those of a fault that shows in one throw of
three."""
LEAST_LEVEL_SD = 0.08
"""Least standard deviation of a machine's log residual power from day to day."""


class ReferenceThrows(NamedTuple):
    """Healthy throws of one machine, linearised at "no effect"."""

    prepared: Sequence[PreparedThrow]
    linear: Sequence[LinearThrow]
    beside: Array
    """What the named parameters explain of the unmodelled effects (`beside_named`)."""

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
    own = with_posterior(tolerant, information(reference.whitened(tolerant)))
    return with_usual_level(own, reference)


def with_wide_priors(model: NoiseModel) -> NoiseModel:
    """The model of a machine of which nothing is known but that effects with slopes may be part of it.

    A machine differs from its twin by more than the machines of the virtual type differ from theirs. Load and
    air are not part of it.
    """
    wide = {p.key: p.prior_sd for p in library() if p.effect in OWN_EFFECTS}
    return model.model_copy(update={"machine_scatter": model.machine_scatter.widened(wide)})


def with_measured_noise(model: NoiseModel, reference: ReferenceThrows) -> NoiseModel:
    """The model with this machine's channel covariances.

    Covariances are fitted to the residuals of one half of the throws after the parameters of the other half.
    """
    residuals = _held_out_residuals(model, reference)
    channels = dict(model.channels)
    for name, of_type in model.channels.items():
        rows = [
            (block, residual[block.rows])
            for p, residual in zip(reference.prepared, residuals, strict=True)
            if (block := p.block(name)) is not None
        ]
        if not name.startswith(MEASURED_STAGES) or len(rows) < len(residuals):
            continue
        channels[name] = fitted_channel(of_type, rows)
    return model.model_copy(update={"channels": channels})


def with_set_tolerance(model: NoiseModel) -> NoiseModel:
    """The model whose parameters scatter between sets by the effect table's tolerance, each by itself.

    Oil, grease and play change from day to day within what maintenance would leave alone.
    """
    tolerance = {p.key: p.tolerance for p in library()}
    return model.model_copy(update={"set_scatter": model.set_scatter.widened(tolerance)})


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


def with_usual_level(model: NoiseModel, reference: ReferenceThrows) -> NoiseModel:
    """The model with the residual power that sets of this machine leave while it is healthy.

    Each half of the throws is taken as a set: with deviations of its own, as a diagnosed set has. Single
    throws of a healthy machine can leave many times the usual, so that those with most are left out.
    """
    white = reference.whitened(model)
    priors = layout(model).priors
    powers: list[dict[str, tuple[float, int]]] = []
    for half in (0, 1):
        own = white[half::2]
        mean = healthy_posterior(total(information(own)), priors).mean
        powers += [residual_power(one, mean) for one in own]
    usual = dict(model.unknown_level)
    for name, power in throw_powers(powers).items():
        if name not in usual or power.size < len(white):
            continue
        # Standard error of a trimmed mean by winsorised deviations (Tukey and McLaughlin 1963).
        most = np.sort(power)[power.size - 1 - int(DROPPED_RATIO * power.size)]
        error = float(np.std(np.minimum(power, most), ddof=1)) / (1.0 - DROPPED_RATIO)
        error /= np.sqrt(power.size) * np.exp(log_level(power, DROPPED_RATIO))
        # Of the level of these throws, and of that of a set of half as many.
        sd = float(np.hypot(LEAST_LEVEL_SD, error * np.sqrt(3.0)))
        usual[name] = log_level(power, DROPPED_RATIO), sd
    return model.model_copy(update={"unknown_level": usual, "dropped_ratio": DROPPED_RATIO})


def _held_out_residuals(model: NoiseModel, reference: ReferenceThrows) -> list[Array]:
    """Residual of every throw (n,) in the channels' units, after the parameters of the other half."""
    white = reference.whitened(model)
    data, priors = information(white), layout(model).priors
    means = [healthy_posterior(total(data[1 - half :: 2]), priors).mean for half in (0, 1)]
    return [
        in_units(p, factors(p, model), residual_after(w, means[i % 2]))
        for i, (p, w) in enumerate(zip(reference.prepared, white, strict=True))
    ]
