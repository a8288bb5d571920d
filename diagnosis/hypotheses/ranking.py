"""Probabilities of the hypotheses and of "unknown", and the rivals that these throws cannot separate."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import expit

from diagnosis.hypotheses.exploration import Hypothesis
from diagnosis.hypotheses.gap_problem import GapProblem
from diagnosis.hypotheses.release_jitter import JitterFit
from diagnosis.inference.evidence import total
from diagnosis.inference.model_selection import bagged_probability, expected_log_odds
from diagnosis.linearisation.model_error import nonsmooth_blocks
from diagnosis.linearisation.parameters import Group
from diagnosis.linearisation.residual_power import EXCITED_BLOCKS, INSENSITIVE_BLOCKS
from diagnosis.linearisation.unmodelled_effects import group_of
from diagnosis.tuning import (
    CROWDED_LEVEL_SD,
    CROWDED_WIDTH_SD,
    DOUBT_PROBABILITY,
    FORM_LEFT_RATIO,
    FORM_LEVEL_SD,
    FORM_LOG_EVIDENCE,
    QUIET_LEVEL_SD,
    QUIET_WIDTH_SD,
    RIVAL_PROBABILITY,
    STICKING_LEVEL_SD,
    SURE_PROBABILITY,
    UNKNOWN_LEVEL_SD,
    UNKNOWN_WIDTH_SD,
)
from machine.conventions import Array


@dataclass(frozen=True, slots=True)
class Ranked:
    """Hypotheses with their probabilities, best first."""

    hypotheses: list[Hypothesis]
    """Sets of the library's effects."""
    probability: Array
    """(hypotheses,) that each is true; the rest is "unknown"."""
    unknown: float
    shape: Group | None
    """The strongest evidence for "unknown": the unmodelled effect of the most probable hypothesis with
    one, or of the openings (release_jitter.py); None where residual power is stronger."""
    ahead: float
    """Log evidence of the best hypothesis over no effect."""
    levels: Mapping[str, float]
    """By block: residual power of the best hypothesis, in standard deviations of healthy sets."""
    jitter: JitterFit
    jitter_probability: float
    rival: Hypothesis | None
    """A hypothesis that these throws cannot separate from the best."""
    rival_log_odds: float
    """Expected log odds of the best over the rival in these throws."""

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
        return self.none_probability >= DOUBT_PROBABILITY

    @property
    def is_unknown(self) -> bool:
        """Whether something unknown is more probable than the best hypothesis and its rival together."""
        either = zip(self.hypotheses, self.probability, strict=True)
        named = sum(float(p) for h, p in either if h is self.best or h is self.rival)
        return self.unknown > named

    @property
    def best(self) -> Hypothesis:
        """The most probable one."""
        return self.hypotheses[0]


def rank(problem: GapProblem, hypotheses: Sequence[Hypothesis], jitter: JitterFit) -> Ranked:
    """Weigh the hypotheses against each other and against "unknown"."""
    logs = np.stack([h.log_evidence for h in hypotheses], axis=1)
    none = next(i for i, h in enumerate(hypotheses) if not h.members)
    shapes = [_shape(problem, h) for h in hypotheses]
    is_unmodelled = np.array([shape is not None for shape in shapes])
    probability = bagged_probability(logs, np.array([len(h.members) for h in hypotheses]))
    unmodelled = min(float(probability[is_unmodelled].sum()), 1.0)
    order = np.argsort(-np.where(is_unmodelled, -1.0, probability), kind="stable")[
        : (~is_unmodelled).sum()
    ]
    named = probability[order] / max(1.0 - unmodelled, 1e-9)
    ordered = [hypotheses[int(i)] for i in order]
    levels = unknown_levels(problem, ordered[0], hypotheses[none])
    ahead = float(logs[0, order[0]] - logs[0, none])
    odds = [unknown_log_odds(ordered[0], ahead, *one) for one in levels.items()]
    left = float(expit(max(odds, default=-np.inf)))
    follows = float(expit(jitter.log_odds) * expit(jitter.follows_log_odds))
    unknown = 1.0 - (1.0 - left) * (1.0 - unmodelled) * (1.0 - follows)
    likeliest = shapes[int(np.argmax(np.where(is_unmodelled, logs[0], -np.inf)))]
    loudest = [(left, None), (follows, (group_of("opening"), None)), (unmodelled, likeliest)]
    rival, expected = _rival(problem, ordered, named)
    return Ranked(
        hypotheses=ordered,
        probability=named * (1.0 - unknown),
        unknown=unknown,
        shape=max(loudest, key=lambda one: one[0])[1],
        ahead=ahead,
        levels=levels,
        jitter=jitter,
        jitter_probability=float(expit(jitter.log_odds)),
        rival=rival,
        rival_log_odds=expected,
    )


def _shape(problem: GapProblem, hypothesis: Hypothesis) -> Group | None:
    """The unmodelled effect of a hypothesis, if it has one."""
    layout = problem.layout
    return next((layout.groups[g] for g in hypothesis.members if layout.is_unmodelled(g)), None)


def unknown_log_odds(best: Hypothesis, ahead: float, block: str, level: float) -> float:
    """Log odds of something unknown, by the residual power of the best hypothesis in a block.

    Args:
        best: the hypothesis.
        ahead: its log evidence over no effect.
        block: by name.
        level: residual power there, in standard deviations of healthy sets.
    """
    if not best.members:
        return (level - QUIET_LEVEL_SD) / QUIET_WIDTH_SD
    level -= FORM_LEVEL_SD * min(max(ahead / FORM_LOG_EVIDENCE, 0.0), 2.0)
    own = [e.effect for e in best.effects if block == f"actuation.{e.joint}"]
    level -= STICKING_LEVEL_SD * ("stiction" in own)
    if len(own) > 1:
        return (level - CROWDED_LEVEL_SD) / CROWDED_WIDTH_SD
    return (level - UNKNOWN_LEVEL_SD) / UNKNOWN_WIDTH_SD


def unknown_levels(problem: GapProblem, best: Hypothesis, none: Hypothesis) -> dict[str, float]:
    """Residual power of every block that is a measure of it, in standard deviations of healthy sets.

    A block that the best hypothesis has almost brought back to the level of healthy machines counts as
    healthy. Where no effect is best, nothing is attributed to model error (`GapProblem.none_levels`).
    """
    healthy = problem.model.unknown_level
    nonsmooth = nonsmooth_blocks(best.effects)
    levels: dict[str, float] = {}
    left = best.levels if best.members else problem.none_levels
    for name, level in left.items():
        is_excited = nonsmooth and name not in nonsmooth and name.startswith(EXCITED_BLOCKS)
        if name not in healthy or name.startswith(INSENSITIVE_BLOCKS) or is_excited:
            continue
        middle, sd = healthy[name]
        before = np.exp(none.levels[name]) - np.exp(middle)
        is_form = np.exp(level) - np.exp(middle) < FORM_LEFT_RATIO * before
        levels[name] = 0.0 if is_form else (level - middle) / sd
    return levels


def _rival(
    problem: GapProblem, ordered: Sequence[Hypothesis], probability: Array
) -> tuple[Hypothesis | None, float]:
    """The next cause where the throws leave the choice open, and the best's expected log odds over it."""
    best = ordered[0]
    if not best.members or probability[0] >= SURE_PROBABILITY:
        return None, np.inf
    for other, share in zip(ordered[1:], probability[1:], strict=True):
        # A set and its subset are no alternatives.
        nested = set(best.members) <= set(other.members) or set(other.members) <= set(best.members)
        if share >= RIVAL_PROBABILITY and not nested:
            data = total(best.information)
            return other, expected_log_odds(
                data, problem.layout.priors, best.evidence, other.members
            )
    return None, np.inf
