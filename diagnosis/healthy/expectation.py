"""Expectation maximisation: the scatter under which throws of healthy machines are most probable.

Each set of throws is one machine: its parameters theta ~ N(mean, S), and those of every throw eta ~ N(0, T),
come on top of the noise of the channels. One round fits all sets under the present S, T and noise, and then
takes the second moments of the fits as the new S and T, drawn a little towards their diagonals because
there are hardly more sets than directions.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from diagnosis.causes.parameters import Layout, layout, library, scatter_names
from diagnosis.causes.residuals import Linear
from diagnosis.causes.selection import screen, total
from diagnosis.causes.whitening import (
    Whitened,
    explained,
    factors,
    information,
    throw_nuisances,
    whiten_throw,
)
from diagnosis.healthy.noise import ChannelNoise, NoiseModel, Scatter
from diagnosis.loading.prepared import PreparedThrow
from machine.calibration import ValveCalibration
from machine.conventions import Array, IntArray
from sim_twin.twin.profile import TwinProfile

KEPT_NUISANCES = ("release_delay_s", "switch_lag_s")
"""Not separable in healthy data: jitter of the opening is in the machine's profile."""
WITHOUT_MEAN = (
    *(f"valve_{name}" for name in ("lag", "dead_band", "gain", "hysteresis")),
    *("speed_limit", "load_dependent_speed", "backlash", "stiction", "pump_flow_sharing"),
)
"""What is off there on every machine is taken away by the filters; a mean of their own would drift against
that of the dead time, which the identification sees with the joint sensor in it."""
SET_SHRINKING_COUNT = 30.0
THROW_SHRINKING_COUNT = 60.0
"""So many sets (throws) without any correlation are added to those that were seen (by eye)."""
NO_SLOPE = ("valve_hysteresis", "speed_limit", "backlash", "stiction")
MOST_SD_RATIO = 3.0
"""Effects with a threshold have no slope at 0: what healthy machines say of them is mostly correlation with
others, and their scatter stays below this multiple of the library's tolerance (by eye)."""
LEAST_SD_RATIO = 0.02
"""Of the library's tolerance: no direction is without scatter."""


@dataclass(frozen=True, slots=True)
class HealthySet:
    """One set of throws without an effect."""

    prepared: Sequence[PreparedThrow]
    linear: Sequence[Linear]
    profile: TwinProfile
    calibration: ValveCalibration


@dataclass(frozen=True, slots=True)
class Fit:
    """A healthy set under a model."""

    mean: Array
    """(size,) of the whole vector of the layout."""
    covariance: Array
    """(size, size)"""
    moment: Array
    """(q, q) posterior second moment of the throws' independent directions, mean over throws."""
    left: Sequence[Array]
    """By throw, in the channels' own units, nuisances and parameters taken off."""


def fit(one: HealthySet, model: NoiseModel) -> Fit:
    """Posterior of a set's parameters, of its throws' nuisances, and what they leave."""
    factor = [factors(p, model) for p in one.prepared]
    white = [
        whiten_throw(p, linear, model, f)
        for p, linear, f in zip(one.prepared, one.linear, factor, strict=True)
    ]
    base = screen(total(information(white)), layout(model).priors)
    moments: list[Array] = []
    left: list[Array] = []
    for w, p, lower in zip(white, one.prepared, factor, strict=True):
        rest, moment = _without_nuisances(w, base.mean)
        moments.append(moment)
        raw = np.zeros_like(rest)
        for block, one_factor in zip(p.blocks, lower, strict=True):
            raw[block.rows] = one_factor @ rest[block.rows]
        left.append(raw)
    return Fit(base.mean, base.covariance, np.mean(moments, axis=0), left)


def _without_nuisances(white: Whitened, mean: Array) -> tuple[Array, Array]:
    """What parameters and the throw's nuisances leave (n,), and the nuisances' second moment (q, q)."""
    rest = white.residual - explained(white, mean)
    nuisance = white.nuisance
    covariance = np.linalg.inv(np.eye(nuisance.shape[1]) + nuisance.T @ nuisance)
    eta = covariance @ (nuisance.T @ rest)
    return rest - nuisance @ eta, np.outer(eta, eta) + covariance


def improve(sets: Sequence[HealthySet], model: NoiseModel) -> NoiseModel:
    """One round."""
    plan, names = layout(model), scatter_names()
    fits = [fit(one, model) for one in sets]
    fixed = _fixed(plan)
    middle = np.mean([f.mean for f in fits], axis=0)[fixed]
    moves = np.array([0.0 if name.startswith(WITHOUT_MEAN) else 1.0 for name in names])
    # The mean moves in steps; what is left of it this round does not count as scatter.
    shifted = [f.mean[fixed] - moves * middle for f in fits]
    seen = np.mean(
        [
            np.outer(m, m) + f.covariance[np.ix_(fixed, fixed)]
            for m, f in zip(shifted, fits, strict=True)
        ],
        axis=0,
    )
    drifts = slice(plan.parameter_count, plan.parameter_count + plan.drift_count)
    drift = np.mean([f.mean[drifts] ** 2 + np.diag(f.covariance)[drifts] for f in fits], axis=0)
    return model.model_copy(
        update={
            "healthy_mean": {
                name: model.healthy_mean.get(name, 0.0) + float(middle[place])
                for place, name in enumerate(names)
                if moves[place]
            },
            "scatter": Scatter.of(names, _shrunk(seen, len(fits), SET_SHRINKING_COUNT)),
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


def _fixed(plan: Layout) -> IntArray:
    """Places of the vector that are no drifts."""
    return np.r_[: plan.parameter_count, plan.parameter_count + plan.drift_count : plan.size_count]


def _shrunk(covariance: Array, count: int, shrinking_count: float) -> Array:
    share = shrinking_count / (count + shrinking_count)
    return (1.0 - share) * covariance + share * np.diag(np.diag(covariance))


def capped(model: NoiseModel) -> NoiseModel:
    """The model with as much scatter of effects without a slope at 0 as can be believed."""
    scatter = model.scatter
    most = {p.key: MOST_SD_RATIO * p.tolerance for p in library() if p.effect in NO_SLOPE}
    for name, sd in most.items():
        scatter = scatter.with_sd(name, min(sd, scatter.sd_of(name)))
    return model.model_copy(update={"scatter": scatter})


def _throw_scatter(sets: Sequence[HealthySet], fits: Sequence[Fit], model: NoiseModel) -> Scatter:
    names = throw_nuisances()
    root = np.linalg.cholesky(model.throw_scatter.covariance(names))
    throws = sum(len(one.prepared) for one in sets)
    seen = root @ np.mean([f.moment for f in fits], axis=0) @ root.T
    kept = [names.index(name) for name in KEPT_NUISANCES]
    seen[kept, :] = 0.0
    seen[:, kept] = 0.0
    seen[kept, kept] = [model.throw_scatter.sd_of(name) ** 2 for name in KEPT_NUISANCES]
    return Scatter.of(names, _shrunk(seen, throws, THROW_SHRINKING_COUNT))


def _channel(
    name: str, old: ChannelNoise, sets: Sequence[HealthySet], fits: Sequence[Fit]
) -> ChannelNoise:
    """Discrepancy from the size and the memory of what is left."""
    if not name.startswith(("actuation", "swing")):
        return old
    size: list[Array] = []
    level: list[Array] = []
    for one, found in zip(sets, fits, strict=True):
        for p, left in zip(one.prepared, found.left, strict=True):
            block = p.block(name)
            if block is not None:
                size.append(left[block.rows])
                level.append(np.column_stack([np.ones(block.t_s.size), block.rate, block.push]))
    x, y = np.vstack(level), np.abs(np.concatenate(size)) * np.sqrt(np.pi / 2.0)
    scale = x.std(axis=0) + x.mean(axis=0)
    slope = nnls(x / scale, y)[0] / scale
    floor = float(np.sqrt(max(slope[0] ** 2 - old.noise_sd**2, (0.3 * old.noise_sd) ** 2)))
    step_s, product, square = 0.06, 0.0, 0.0
    for part, lev in zip(size, level, strict=True):
        unit = part / (lev @ slope)
        product += float(unit[3:] @ unit[:-3])
        square += float(unit[3:] @ unit[3:])
    share = np.clip(product / max(square, 1e-12), 0.05, 0.95)
    return old.model_copy(
        update={
            "floor_sd": floor,
            "rate_ratio": float(slope[1]),
            "push_ratio": float(slope[2]),
            "memory_s": float(-step_s / np.log(share)),
        }
    )
