"""Expectation maximisation: the scatter under which throws of healthy machines are most probable.

Parameters of a set scatter at two levels (hierarchical_prior.py). Those of every throw, eta ~ N(0, T), add
to the noise of the channels. One round fits all sets under the present scatter and noise, estimates both
levels from the fits, and takes the second moment of the throws' fits as the new T. T is shrunk towards its
diagonal, since there are hardly more throws than directions.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.healthy.noise import ChannelNoise, NoiseModel, Scatter
from diagnosis.linearisation.information import healthy_posterior, total
from diagnosis.linearisation.model_error import factors
from diagnosis.linearisation.nuisances import throw_nuisances
from diagnosis.linearisation.parameters import SET_NUISANCES, layout, library, scatter_names
from diagnosis.linearisation.residual_power import in_units, prediction_of
from diagnosis.linearisation.sensitivities import LinearThrow
from diagnosis.linearisation.unmodelled_effects import unmodelled_least_sd
from diagnosis.linearisation.whitening import (
    Whitened,
    beside_named,
    information,
    whiten_throw,
    with_projection_subtracted,
)
from diagnosis.loading.prepared import PreparedThrow
from diagnosis.population.channel_fit import fitted_channel
from diagnosis.population.hierarchical_prior import (
    Levels,
    SetLikelihood,
    learn,
    set_likelihood,
    shrink_covariance,
)
from machine.calibration import ValveCalibration
from machine.conventions import Array
from sim_twin.effects.table import effects_where
from sim_twin.twin.profile import TwinProfile

KEPT_NUISANCES = ("release_delay_s", "switch_lag_s")
"""Not separable in healthy data: the jitter of the opening is in the machine's profile."""
THROW_SHRINKING_COUNT = 60.0
"""Number of uncorrelated pseudo-throws that are added to the throws seen."""
NO_SLOPE = effects_where(lambda effect: not effect.is_smooth)
"""Effects with a threshold have no slope at 0 and no negative size: they have scatter but no mean."""
FIRST_SCATTER_RATIO = 4.0
"""Initial standard deviations as a multiple of the library's tolerances."""
BELIEVED_RATIO = 5.0
"""Prior width of a healthy parameter as a multiple of its initial standard deviation. Directions that no
throw determines (load against drag, base against slew) would diverge together without it."""
LEAST_SD_RATIO = 0.02
"""Least standard deviation of a parameter as a share of the library's tolerance."""


@dataclass(frozen=True, slots=True)
class HealthySet:
    """One set of throws without an effect."""

    prepared: Sequence[PreparedThrow]
    linear: Sequence[LinearThrow]
    profile: TwinProfile
    calibration: ValveCalibration


@dataclass(frozen=True, slots=True)
class HealthyFit:
    """Posterior of a healthy set under a model."""

    mean: Array
    """(size,) of the whole parameter vector."""
    covariance: Array
    """(size, size)"""
    moment: Array
    """(q, q) posterior second moment of the throws' independent nuisance directions, mean over throws."""
    left: Sequence[Array]
    """Residual of each throw in the channels' units, without nuisances and parameters."""
    likelihood: SetLikelihood
    """Log likelihood of the set's constants and nuisances."""


def fit(one: HealthySet, model: NoiseModel) -> HealthyFit:
    """Posterior of a set's parameters and of its throws' nuisances, and the residual."""
    factor = [factors(p, model) for p in one.prepared]
    plan = layout(model)
    raw = [
        whiten_throw(p, linear, model, f)
        for p, linear, f in zip(one.prepared, one.linear, factor, strict=True)
    ]
    beside = beside_named(total(information(raw)), plan)
    white = [with_projection_subtracted(throw, beside, model) for throw in raw]
    data = total(information(white))
    base = healthy_posterior(data, plan.priors)
    moments: list[Array] = []
    left: list[Array] = []
    for w, p, lower in zip(white, one.prepared, factor, strict=True):
        rest, moment = _without_nuisances(w, base.mean)
        moments.append(moment)
        left.append(in_units(p, lower, rest))
    return HealthyFit(
        base.mean, base.covariance, np.mean(moments, axis=0), left, set_likelihood(data, plan)
    )


def _without_nuisances(white: Whitened, mean: Array) -> tuple[Array, Array]:
    """Residual (n,) after parameters and the throw's nuisances, and the nuisances' second moment (q, q)."""
    rest = white.residual - prediction_of(white, mean)
    nuisance = white.nuisance
    covariance = np.linalg.inv(np.eye(nuisance.shape[1]) + nuisance.T @ nuisance)
    eta = covariance @ (nuisance.T @ rest)
    return rest - nuisance @ eta, np.outer(eta, eta) + covariance


def improve(sets: Sequence[HealthySet], model: NoiseModel) -> NoiseModel:
    """One round."""
    plan = layout(model)
    fits = [fit(one, model) for one in sets]
    drifts = slice(plan.parameter_count, plan.parameter_count + plan.drift_count)
    drift = np.mean([f.mean[drifts] ** 2 + np.diag(f.covariance)[drifts] for f in fits], axis=0)
    return with_scatter_of(sets, fits, model).model_copy(
        update={
            "drift_sd": {
                p.key: float(f"{max(np.sqrt(v), LEAST_SD_RATIO * p.tolerance):.4g}")
                for p, v in zip(library(), drift, strict=True)
            },
            "throw_scatter": _throw_scatter(sets, fits, model),
            "channels": {
                name: _channel(name, old, sets, fits) for name, old in model.channels.items()
            },
        }
    )


def with_scatter_of(
    sets: Sequence[HealthySet], fits: Sequence[HealthyFit], model: NoiseModel
) -> NoiseModel:
    """The model with the scatter of machines and sets estimated from these fits."""
    names = scatter_names()
    mean = np.array([model.healthy_mean.get(name, 0.0) for name in names])
    belief = 1.0 / np.square(BELIEVED_RATIO * first_scatter_sd())
    machines: dict[str, list[SetLikelihood]] = {}
    for one, found in zip(sets, fits, strict=True):
        precision, gradient = found.likelihood
        believed = SetLikelihood(precision + np.diag(belief), gradient - belief * mean)
        machines.setdefault(one.prepared[0].throw.machine_id, []).append(believed)
    first = Levels(
        np.zeros(len(names)),
        model.machine_scatter.covariance(names),
        model.set_scatter.covariance(names),
    )
    # Effects with a threshold have no negative size: their mean would be that of other effects.
    has_mean = np.array([not name.startswith(NO_SLOPE) for name in names])
    levels = learn(list(machines.values()), first, has_mean=has_mean)
    return model.model_copy(
        update={
            "healthy_mean": {
                name: model.healthy_mean.get(name, 0.0) + float(moved)
                for name, moved in zip(names, levels.mean, strict=True)
            },
            "machine_scatter": Scatter.of(names, _without_correlations(levels.machine)),
            "set_scatter": Scatter.of(names, _without_correlations(levels.within)),
        }
    )


def _without_correlations(covariance: Array) -> Array:
    """Scatter of the unmodelled effects without correlations, and at least `unmodelled_least_sd`.

    They are orthogonal to all named parameters (basis_functions.py), and too many for correlations of their
    own.
    """
    least = unmodelled_least_sd()
    named = covariance.shape[0] - least.size
    kept = np.zeros_like(covariance)
    kept[:named, :named] = covariance[:named, :named]
    places = np.arange(named, covariance.shape[0])
    kept[places, places] = np.diag(covariance)[named:] + 0.5 * least**2
    return kept


def first_scatter_sd() -> Array:
    """Initial standard deviations (p,) in the order of `scatter_names`."""
    offsets = [
        0.03 if "accel" in name else 0.003 if "gyro" in name or name.endswith("_s") else 0.01
        for name in SET_NUISANCES
    ]
    return np.array(
        [
            *(FIRST_SCATTER_RATIO * p.tolerance for p in library()),
            *offsets,
            *(FIRST_SCATTER_RATIO * unmodelled_least_sd()),
        ]
    )


def _throw_scatter(
    sets: Sequence[HealthySet], fits: Sequence[HealthyFit], model: NoiseModel
) -> Scatter:
    names = throw_nuisances()
    root = np.linalg.cholesky(model.throw_scatter.covariance(names))
    throws = sum(len(one.prepared) for one in sets)
    measured = root @ np.mean([f.moment for f in fits], axis=0) @ root.T
    kept = [names.index(name) for name in KEPT_NUISANCES]
    measured[kept, :] = 0.0
    measured[:, kept] = 0.0
    measured[kept, kept] = [model.throw_scatter.sd_of(name) ** 2 for name in KEPT_NUISANCES]
    return Scatter.of(names, shrink_covariance(measured, throws, THROW_SHRINKING_COUNT))


def _channel(
    name: str, old: ChannelNoise, sets: Sequence[HealthySet], fits: Sequence[HealthyFit]
) -> ChannelNoise:
    """The channel with the discrepancy that is left in these sets."""
    if not name.startswith(("actuation", "swing")):
        return old
    rows = [
        (block, left[block.rows])
        for one, found in zip(sets, fits, strict=True)
        for p, left in zip(one.prepared, found.left, strict=True)
        if (block := p.block(name)) is not None
    ]
    return fitted_channel(old, rows)
