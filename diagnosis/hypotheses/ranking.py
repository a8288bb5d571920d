"""Probabilities of the sets of effects and of "unknown", and the rival that these throws cannot separate."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import expit, softmax

from diagnosis.hypotheses.candidate import CandidateSet, fitted_effects
from diagnosis.hypotheses.gap_problem import GapProblem
from diagnosis.hypotheses.marginal_likelihood import MarginalLikelihood
from diagnosis.hypotheses.release_jitter import JitterFit
from diagnosis.hypotheses.search import linear_gains
from diagnosis.hypotheses.unknown_check import (
    Left,
    conflicts,
    left_by,
    unknown_probability,
)
from diagnosis.linearisation.information import Set
from diagnosis.linearisation.parameters import Group
from diagnosis.linearisation.unmodelled_effects import group_of
from diagnosis.tuning import OPEN_PROBABILITY, SURE_PROBABILITY
from machine.conventions import Array
from sim_twin.effects.effect import Effect


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """A set of effects at its best sizes."""

    members: Set
    effects: tuple[Effect, ...]
    candidate: CandidateSet

    @property
    def log_evidence(self) -> float:
        """Log evidence, up to a constant of the throws; prior odds included."""
        return self.candidate.log_evidence


@dataclass(frozen=True, slots=True)
class Ranked:
    """Hypotheses with their probabilities, best first."""

    likelihood: MarginalLikelihood
    hypotheses: list[Hypothesis]
    probability: Array
    """(hypotheses,) that each is true; the rest is "unknown"."""
    unknown: float
    left: Mapping[str, Left]
    """What the best hypothesis leaves in every part of the chain."""
    resembles: Group | None
    """The unmodelled effect that explains most of what is left where most is left; ``opening`` where the
    spread of the openings follows the swing; None where none explains any."""
    jitter: JitterFit
    jitter_probability: float
    rival: Hypothesis | None
    """A hypothesis that these throws cannot separate from the best."""

    @property
    def rival_log_odds(self) -> float:
        """Log odds of the best over the rival."""
        return np.inf if self.rival is None else self.best.log_evidence - self.rival.log_evidence

    @property
    def none_probability(self) -> float:
        """Probability of no effect, given that it is nothing unknown."""
        shares = zip(self.hypotheses, self.probability, strict=True)
        return sum(float(p) for h, p in shares if not h.members) / max(1.0 - self.unknown, 1e-9)

    @property
    def has_jitter(self) -> bool:
        """Whether additional jitter is more probable than not."""
        return self.jitter_probability > 0.5

    @property
    def is_doubtful(self) -> bool:
        """Whether "no effect" is too probable for a claim."""
        return self.none_probability >= OPEN_PROBABILITY

    @property
    def is_unknown(self) -> bool:
        """Whether something unknown is more probable than not."""
        return self.unknown > 0.5

    @property
    def best(self) -> Hypothesis:
        """The most probable one."""
        return self.hypotheses[0]


def rank(
    problem: GapProblem,
    likelihood: MarginalLikelihood,
    candidates: Sequence[CandidateSet],
    jitter: JitterFit,
) -> Ranked:
    """Weigh the sets against each other, and the best one against "unknown"."""
    hypotheses = [
        Hypothesis(c.members, fitted_effects(problem.layout, c.members, c.sizes), c)
        for c in candidates
    ]
    probability = softmax(np.array([h.log_evidence for h in hypotheses]))
    best = candidates[0]
    mean = best.healthy_mean
    left = left_by(likelihood, best.change, mean)
    conflict = conflicts(likelihood, mean)
    left = {
        part: left.get(part, Left(0.0, 0.0))._replace(conflict_ratio=conflict.get(part, 0.0))
        for part in {**left, **conflict}
    }
    follows = float(expit(jitter.log_odds) * expit(jitter.follows_log_odds))
    of_left = unknown_probability(left)
    unknown = 1.0 - (1.0 - of_left) * (1.0 - follows)
    resembles = (
        (group_of("opening"), None) if follows > of_left else _resembled(likelihood, best, left)
    )
    return Ranked(
        likelihood=likelihood,
        hypotheses=hypotheses,
        probability=probability * (1.0 - unknown),
        unknown=unknown,
        left=left,
        resembles=resembles,
        jitter=jitter,
        jitter_probability=float(expit(jitter.log_odds)),
        rival=_rival(hypotheses, probability),
    )


def _resembled(
    likelihood: MarginalLikelihood, best: CandidateSet, left: Mapping[str, Left]
) -> Group | None:
    """The unmodelled effect with the highest evidence beside a set, at the part that leaves most."""
    layout = likelihood.problem.layout
    part = max(left, key=lambda name: left[name].ratio)
    there = [
        g
        for g, (_, joint) in enumerate(layout.groups)
        if layout.is_unmodelled(g) and joint is not None and part == f"actuation.{joint}"
    ]
    gains = linear_gains(likelihood, best, there)
    found = max(there, key=lambda g: gains[g][0], default=None)
    # Without the prior odds: that something is unknown is settled by the check.
    if found is None or gains[found][0] <= layout.priors.log_prior[found]:
        return None
    return layout.groups[found]


def _rival(hypotheses: Sequence[Hypothesis], probability: Array) -> Hypothesis | None:
    """The next cause where the throws leave the choice open."""
    if not hypotheses[0].members or probability[0] >= SURE_PROBABILITY:
        return None
    others = zip(hypotheses[1:], probability[1:], strict=True)
    return next((h for h, p in others if h.members and p >= OPEN_PROBABILITY), None)
