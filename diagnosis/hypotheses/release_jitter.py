"""Release jitter: an effect that moves a spread and not a mean, weighed separately.

The times from opening command to switch, with free mean and linear trend, are compared under normal
distributions of a healthy machine's standard deviation and of larger ones. A spread that follows the
gripper's swing at the command is neither jitter nor another effect of the library (unmodelled_effects.py,
"opening").
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from diagnosis.healthy.noise import NoiseModel
from diagnosis.loading.prepared import PreparedThrow
from diagnosis.tuning import FOLLOWS_LOG_PRIOR, JITTER_LOG_PRIOR, JITTER_TREND_SD_S
from machine.conventions import Array
from sim_twin.effects.effect import Effect
from sim_twin.effects.table import EFFECTS
from sim_twin.twin.profile import TwinProfile

JITTER = "release_jitter"
PARAMETER = "extra_sd_s"
GRID_COUNT = 61
MIN_COUNT = 5
OPENING_NUISANCES = ("release_delay_s", "switch_lag_s")
"""Deviations of the opening of a healthy machine between throws."""


class JitterFit(NamedTuple):
    """Evidence and size of additional jitter."""

    log_odds: float
    """Of additional jitter against none, prior odds included."""
    size_s: float
    """Posterior mean of the additional standard deviation."""
    ci90_s: tuple[float, float]
    follows_log_odds: float = -np.inf
    """Of a spread that follows the swing, against jitter."""

    def effect(self) -> Effect:
        """As an effect of the library."""
        return Effect(effect=JITTER, parameters={PARAMETER: self.size_s})


NOTHING = JitterFit(-np.inf, 0.0, (0.0, 0.0))


def fit_jitter(
    prepared: Sequence[PreparedThrow], profile: TwinProfile, model: NoiseModel
) -> JitterFit:
    """Weigh additional jitter; none where the switch reported in fewer than `MIN_COUNT` throws."""
    switched = [(p, block) for p in prepared if (block := p.block("release.switch")) is not None]
    if len(switched) < MIN_COUNT:
        return NOTHING
    command = np.array([p.throw.open_command_t_s for p, _ in switched])
    opening = np.array([float(p.measured[block.rows][0]) for p, block in switched])
    progress = np.array([p.input.progress_ratio for p, _ in switched])
    swing = np.array([_swing(p) for p, _ in switched])
    late = opening - command - profile.release_delay_s
    healthy = np.linalg.norm([model.throw_scatter.sd_of(name) for name in OPENING_NUISANCES])
    spec = EFFECTS[JITTER].parameters[0]
    sizes = np.linspace(spec.low, spec.high, GRID_COUNT)

    def of_sizes(*more: Array) -> Array:
        basis = np.column_stack([np.ones_like(late), progress - 0.5, *more])
        return np.array([_log_density(late, basis, np.hypot(healthy, s)) for s in sizes])

    logs = of_sizes()
    # Half-normal prior of the library's width over the sizes above the tolerance.
    wide = np.where(sizes > spec.tolerance, np.exp(-0.5 * (sizes / spec.prior_sd) ** 2), 0.0)
    log_prior = np.log(np.maximum(wide / wide.sum(), 1e-300))
    posterior = np.exp(logs + log_prior - _log_sum(logs + log_prior))
    cumulative = np.cumsum(posterior)
    low, high = np.interp((0.05, 0.95), cumulative, sizes)
    # Beside a dependence on the swing, the spread may be that of a healthy machine.
    either = np.logaddexp(log_prior, np.where(sizes == 0.0, 0.0, -np.inf)) - np.log(2.0)
    follows = [_log_sum(of_sizes(one) + either) for one in _standard(swing)]
    share = _log_mean(follows) - _log_sum(logs + log_prior)
    return JitterFit(
        log_odds=float(_log_sum(logs + log_prior) - logs[0] + JITTER_LOG_PRIOR),
        size_s=float(posterior @ sizes),
        ci90_s=(float(low), float(high)),
        follows_log_odds=share + FOLLOWS_LOG_PRIOR,
    )


def _swing(prepared: PreparedThrow) -> Array:
    """Regressors of an opening at its command (6,): angles and rates of the passive joints, and norms."""
    motion, at_s = prepared.motion, prepared.throw.open_command_t_s
    angle, rate = (
        np.array([np.interp(at_s, motion.t_s, track) for track in table.T])
        for table in (motion.swing_rad, motion.swing_rate_rad_per_s)
    )
    return np.r_[angle, rate, np.linalg.norm(angle), np.linalg.norm(rate)]


def _log_sum(logs: Array) -> float:
    return float(np.logaddexp.reduce(logs))


def _log_mean(logs: Sequence[float]) -> float:
    """Log of the mean of exponentials; -inf for an empty sequence."""
    return _log_sum(np.array(logs)) - float(np.log(len(logs))) if logs else -np.inf


def _standard(table: Array) -> list[Array]:
    """Columns (n,) with mean 0 and standard deviation 1; constant columns are left out."""
    sd = table.std(axis=0)
    return [(one - one.mean()) / own for one, own in zip(table.T, sd, strict=True) if own > 1e-6]


def _log_density(late: Array, basis: Array, sd: float) -> float:
    """Log density of a normal with free coefficients of the basis (n, k), up to a constant."""
    count = basis.shape[1]
    inner = basis.T @ basis + np.eye(count) * (sd / JITTER_TREND_SD_S) ** 2
    left = late - basis @ np.linalg.solve(inner, basis.T @ late)
    log_det = float(np.linalg.slogdet(inner)[1]) + 2.0 * count * float(np.log(JITTER_TREND_SD_S))
    freedom = late.size - count
    return -0.5 * (float(late @ left) / sd**2 + log_det) - freedom * float(np.log(sd))
