"""One posterior predictive check: whether what the best set leaves is what healthy throws leave.

The power that remains in each channel is compared with that of healthy throws of another day. It counts as
unknown where it is significantly more, and more than the form error of the set: a share of the power that
would remain without its effects, the healthy parameters as they are.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import expit

from diagnosis.hypotheses.gap_problem import GapProblem
from diagnosis.hypotheses.marginal_likelihood import MarginalLikelihood, stage_of
from diagnosis.hypotheses.prior_conflict import prior_shift
from diagnosis.linearisation.residual_power import INSENSITIVE_BLOCKS, log_level, throw_powers
from diagnosis.tuning import (
    CONFLICT_SD,
    FORM_ERROR_RATIO,
    UNKNOWN_LEVEL_SD,
    UNKNOWN_LEVEL_SD_OF_TYPE,
    UNKNOWN_WIDTH_RATIO,
)
from machine.conventions import Array


class Left(NamedTuple):
    """What a set of effects leaves in one part of the chain."""

    level_sd: float
    """Standard deviations above healthy throws of another day."""
    excess_ratio: float
    """Power above healthy throws, over what may remain."""
    conflict_ratio: float = 0.0
    """How far the machine's own parameters had to move, over what another day may move them."""

    @property
    def ratio(self) -> float:
        """The larger of both."""
        return max(self.excess_ratio, self.conflict_ratio)


def levels_of(
    likelihood: MarginalLikelihood, changes: Sequence[Array], mean: Array
) -> dict[str, float]:
    """Log power per row of every channel (`log_level`) that a prediction leaves.

    Args:
        likelihood: of the throws.
        changes: of every throw's prediction, in the channels' units.
        mean: (p,) of the healthy parameters.
    """
    problem, left = likelihood.problem, likelihood.left_over(changes, mean)
    power = throw_powers(
        [
            {b.name: (float(rest[b.rows] @ rest[b.rows]), rest[b.rows].size) for b in p.blocks}
            for p, rest in zip(problem.prepared, left, strict=True)
        ]
    )
    return {name: log_level(one, problem.model.dropped_ratio) for name, one in power.items()}


def left_by(
    likelihood: MarginalLikelihood, changes: Sequence[Array], mean: Array
) -> dict[str, Left]:
    """What a set leaves in every part of the chain; arguments as of `levels_of`."""
    nothing = [np.zeros_like(change) for change in changes]
    with_effects = levels_of(likelihood, changes, mean)
    return check(likelihood.problem, with_effects, levels_of(likelihood, nothing, mean))


def check(
    problem: GapProblem, levels: Mapping[str, float], without: Mapping[str, float]
) -> dict[str, Left]:
    """What a set leaves in every part of the chain.

    Args:
        problem: of the throws.
        levels: log power per row that the set leaves, by channel.
        without: the same without its effects. Healthy parameters that are fitted without them absorb a part
            of what they explain, so that the power of no effect at its best says too little.
    """
    healthy = problem.model.unknown_level
    level_sd = UNKNOWN_LEVEL_SD if problem.is_own else UNKNOWN_LEVEL_SD_OF_TYPE
    rows = {b.name: 0 for p in problem.prepared for b in p.blocks}
    for p in problem.prepared:
        for block in p.blocks:
            rows[block.name] += block.rows.stop - block.rows.start
    found: dict[str, Left] = {}
    names = [n for n in levels if n in healthy and not n.startswith(INSENSITIVE_BLOCKS)]
    for stage in dict.fromkeys(stage_of(name) for name in names):
        own = [name for name in names if stage_of(name) == stage]
        usual, spread, left, before = 0.0, 0.0, 0.0, 0.0
        for name in own:
            middle, sd = healthy[name]
            usual += rows[name] * np.exp(middle)
            spread += rows[name] * np.exp(middle) * (np.exp(sd) - 1.0)
            left += rows[name] * np.exp(levels[name])
            before += rows[name] * np.exp(without[name])
        may_remain = level_sd * spread + FORM_ERROR_RATIO * max(before - usual, 0.0)
        found[stage] = Left(float((left - usual) / spread), float((left - usual) / may_remain))
    return found


def conflicts(likelihood: MarginalLikelihood, mean: Array) -> dict[str, float]:
    """How much further a set moves the healthy parameters of each part than another day does."""
    scatter = likelihood.problem.layout.priors.scatter
    shifts = prior_shift(scatter, likelihood.covariance, mean)
    return {part: shift.excess_sd / CONFLICT_SD for part, shift in shifts.items()}


def unknown_probability(left: Mapping[str, Left]) -> float:
    """Probability of something unknown, by the channel with the largest excess."""
    most = max((one.ratio for one in left.values()), default=0.0)
    return float(expit(np.log(max(most, 1e-9)) / UNKNOWN_WIDTH_RATIO))
