"""Release jitter: the one effect that moves a spread and not a mean, weighed by itself.

The times from the opening command to the switch, with mean and linear trend free, against normal
distributions of a healthy machine's spread and of wider ones.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from diagnosis.healthy.noise import NoiseModel
from diagnosis.loading.prepared import PreparedThrow
from machine.conventions import Array
from sim_twin.effects.effect import EFFECTS, Effect
from sim_twin.twin.profile import TwinProfile

JITTER = "release_jitter"
PARAMETER = "extra_sd_s"
LOG_PRIOR = -5.0
GRID_COUNT = 61
MIN_COUNT = 5
OPENING_NUISANCES = ("release_delay_s", "switch_lag_s")
"""What moves the opening of a healthy machine from throw to throw."""


class JitterFit(NamedTuple):
    """What the switch says about extra jitter."""

    log_odds: float
    """For extra jitter against none, prior odds included."""
    size_s: float
    """Posterior mean of the extra standard deviation."""
    ci90_s: tuple[float, float]

    def effect(self) -> Effect:
        """As an effect of the library."""
        return Effect(effect=JITTER, parameters={PARAMETER: self.size_s})


NOTHING = JitterFit(-np.inf, 0.0, (0.0, 0.0))


def fit_jitter(
    prepared: Sequence[PreparedThrow], profile: TwinProfile, model: NoiseModel
) -> JitterFit:
    """Weigh extra jitter; nothing where the switch spoke in fewer than 5 throws."""
    rows = [
        (p.throw.open_command_t_s, float(p.measured[block.rows][0]), p.input.progress_ratio)
        for p in prepared
        if (block := p.block("release.switch")) is not None
    ]
    if len(rows) < MIN_COUNT:
        return NOTHING
    command, opening, progress = np.array(rows).T
    late = opening - command - profile.release_delay_s
    healthy = np.linalg.norm([model.throw_scatter.sd_of(name) for name in OPENING_NUISANCES])
    spec = EFFECTS[JITTER].parameters[0]
    sizes = np.linspace(spec.low, spec.high, GRID_COUNT)
    logs = np.array([_log_density(late, progress, np.hypot(healthy, s)) for s in sizes])
    # Half-normal prior over the sizes that count as an effect, of the library's width.
    wide = np.where(sizes > spec.tolerance, np.exp(-0.5 * (sizes / spec.prior_sd) ** 2), 0.0)
    log_prior = np.log(np.maximum(wide / wide.sum(), 1e-300))
    posterior = np.exp(logs + log_prior - logsumexp(logs + log_prior))
    cumulative = np.cumsum(posterior)
    low, high = np.interp((0.05, 0.95), cumulative, sizes)
    return JitterFit(
        log_odds=float(logsumexp(logs + log_prior) - logs[0] + LOG_PRIOR),
        size_s=float(posterior @ sizes),
        ci90_s=(float(low), float(high)),
    )


def _log_density(late: Array, progress: Array, sd: float) -> float:
    """Normal with free mean and trend (wide priors), marginalised."""
    basis = np.column_stack([np.ones_like(late), progress - 0.5])
    inner = basis.T @ basis + np.eye(2) * (sd / 0.2) ** 2
    left = late - basis @ np.linalg.solve(inner, basis.T @ late)
    log_det = float(np.linalg.slogdet(inner)[1])
    freedom = late.size - 2
    return -0.5 * (float(late @ left) / sd**2 + log_det) - freedom * float(np.log(sd))
