"""Probabilities of the refined hypotheses, of "unknown", and which of them these throws cannot tell apart."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import expit

from diagnosis.causes.evidence import total
from diagnosis.causes.form_error import rough_blocks
from diagnosis.causes.hypotheses import Hypothesis
from diagnosis.causes.jitter import JitterFit
from diagnosis.causes.leftovers import DEAF_BLOCKS, SHAKEN_BLOCKS
from diagnosis.causes.parameters import Group
from diagnosis.causes.problem import Problem
from diagnosis.causes.selection import bagged_probability, expected_log_odds
from diagnosis.causes.shapes import group_of
from machine.conventions import Array

UNKNOWN_LEVEL_SD = 5.5
UNKNOWN_WIDTH_SD = 1.0
"""Leftover power, in standard deviations of healthy sets, at which "unknown" is as likely as not. On 340 sets
of two challenges healthy ones left 3.2 at most, unknown effects that no shape shows mostly 6 to 27, and known
ones 5.2 at most but a late sensor before a late valve (5.7) and a pump (5.5)."""
QUIET_LEVEL_SD = 4.5
QUIET_WIDTH_SD = 0.5
"""The same where no effect is best: nothing has a form then that could leave more. Of 40 healthy sets (seed
680363348) one left 3.8, the others 2.4 at most; command drop-outs that had been none left 4.9."""
CROWDED_LEVEL_SD = 3.4
CROWDED_WIDTH_SD = 0.4
"""The same at a joint where the best set has two effects or more: together they take most of what a foreign
one does. Of 425 sets (seeds 680363348, 1741499251, unknown ones of 1618984247) known ones with two effects at
a joint left 3.2 there at most, less what the form of large ones leaves (below), but for two with a stiction
(4.8 and 5.2); foreign ones that no shape shows left 3.6, and 6.1 and more."""
STICKING_LEVEL_SD = 2.5
"""So many more standard deviations at a joint that sticks: it rings as it breaks loose, and the twin's does
not. Two dippers that stuck (seed 1240021187), at their size, left 4.2 and 6.6; of 125 unknown effects in five
challenges one was taken for stiction first (steps of a command, 7.4, flagged for a shape)."""
FORM_LEVEL_SD = 1.0
FORM_LOG_EVIDENCE = 1000.0
"""So many more standard deviations for so much log evidence of the best set over none, twice at most: the
form of a large effect leaves more. Of 366 sets (seeds 416359738, 1618964378, 13753978) six with a pump, a
sticking boom or a late IMU 1900 and more ahead of none left 4.9 to 6.4; unknown ones beside a set that was
ahead by 480 and more left 5.8 to 27."""
FORM_LEFT_RATIO = 0.1
"""Of a block's excess over healthy machines: less is the form of a large effect, not another one. On
development sets right causes left 0.03 to 0.07 of it, unknown effects 0.3 to 1.0, known ones that were not
found 0.13 to 1."""
SURE_PROBABILITY = 0.8
"""Above this a cause is claimed alone."""
RIVAL_PROBABILITY = 0.15
"""Another cause as probable as this is not ruled out (by eye)."""
DOUBT_PROBABILITY = 0.15
"""As long as "none" is as probable as this, no effect is claimed. On 300 healthy sets with reference throws
(seed 20261130, code 7a94a8b) it was less on ten; five of them were none for what they gained held out."""


@dataclass(frozen=True, slots=True)
class Ranked:
    """Hypotheses with their probabilities, best first."""

    hypotheses: list[Hypothesis]
    """Of the library's effects."""
    probability: Array
    """(hypotheses,) that each is true; the rest is "unknown"."""
    unknown: float
    shape: Group | None
    """What speaks loudest for "unknown": that of the likeliest hypothesis with one, or of the openings
    (jitter.py); None where what is left is louder."""
    ahead: float
    """Log evidence of the best hypothesis over no effect."""
    levels: Mapping[str, float]
    """By block: leftover power of the best hypothesis, in standard deviations of healthy sets."""
    jitter: JitterFit
    jitter_probability: float
    rival: Hypothesis | None
    """What these throws cannot tell from the best hypothesis."""
    rival_log_odds: float
    """For the best over the rival, as these throws would give on average."""

    @property
    def none_probability(self) -> float:
        """That there is no effect, given that it is nothing unknown."""
        shares = zip(self.hypotheses, self.probability, strict=True)
        return sum(float(p) for h, p in shares if not h.members) / max(1.0 - self.unknown, 1e-9)

    @property
    def has_jitter(self) -> bool:
        """Whether extra jitter is more probable than not."""
        return self.jitter_probability > 0.5

    @property
    def is_doubtful(self) -> bool:
        """Whether "no effect" is too probable for a claim."""
        return self.none_probability >= DOUBT_PROBABILITY

    @property
    def is_unknown(self) -> bool:
        """Whether something unknown is more probable than what would be named: the best, and its rival."""
        either = zip(self.hypotheses, self.probability, strict=True)
        named = sum(float(p) for h, p in either if h is self.best or h is self.rival)
        return self.unknown > named

    @property
    def best(self) -> Hypothesis:
        """The most probable one."""
        return self.hypotheses[0]


def rank(problem: Problem, hypotheses: Sequence[Hypothesis], jitter: JitterFit) -> Ranked:
    """Weigh the hypotheses against each other and against "unknown"."""
    logs = np.stack([h.log_evidence for h in hypotheses], axis=1)
    none = next(i for i, h in enumerate(hypotheses) if not h.members)
    shapes = [_shape(problem, h) for h in hypotheses]
    is_shaped = np.array([shape is not None for shape in shapes])
    probability = bagged_probability(logs, np.array([len(h.members) for h in hypotheses]))
    shaped = min(float(probability[is_shaped].sum()), 1.0)
    order = np.argsort(-np.where(is_shaped, -1.0, probability), kind="stable")[: (~is_shaped).sum()]
    named = probability[order] / max(1.0 - shaped, 1e-9)
    ordered = [hypotheses[int(i)] for i in order]
    levels = unknown_levels(problem, ordered[0], hypotheses[none])
    ahead = float(logs[0, order[0]] - logs[0, none])
    odds = [unknown_log_odds(ordered[0], ahead, *one) for one in levels.items()]
    left = float(expit(max(odds, default=-np.inf)))
    follows = float(expit(jitter.log_odds) * expit(jitter.follows_log_odds))
    unknown = 1.0 - (1.0 - left) * (1.0 - shaped) * (1.0 - follows)
    likeliest = shapes[int(np.argmax(np.where(is_shaped, logs[0], -np.inf)))]
    loudest = [(left, None), (follows, (group_of("opening"), None)), (shaped, likeliest)]
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


def _shape(problem: Problem, hypothesis: Hypothesis) -> Group | None:
    """The shape of an unheard-of effect that a hypothesis has beside effects of the library."""
    layout = problem.layout
    return next((layout.groups[g] for g in hypothesis.members if layout.is_unheard(g)), None)


def unknown_log_odds(best: Hypothesis, ahead: float, block: str, level: float) -> float:
    """For something unknown, by what the best hypothesis leaves in a block.

    Args:
        best: the hypothesis.
        ahead: its log evidence over no effect.
        block: by name.
        level: what is left there, in sd of healthy sets.
    """
    if not best.members:
        return (level - QUIET_LEVEL_SD) / QUIET_WIDTH_SD
    level -= FORM_LEVEL_SD * min(max(ahead / FORM_LOG_EVIDENCE, 0.0), 2.0)
    own = [e.effect for e in best.effects if block == f"actuation.{e.joint}"]
    level -= STICKING_LEVEL_SD * ("stiction" in own)
    if len(own) > 1:
        return (level - CROWDED_LEVEL_SD) / CROWDED_WIDTH_SD
    return (level - UNKNOWN_LEVEL_SD) / UNKNOWN_WIDTH_SD


def unknown_levels(problem: Problem, best: Hypothesis, none: Hypothesis) -> dict[str, float]:
    """Leftover power of every block that has a say (`DEAF_BLOCKS`) against healthy sets, in their sd.

    A block that the best hypothesis has almost brought back to a healthy level counts as healthy. Where the
    best is no effect, nothing is excused as the form of one (`Problem.none_levels`).
    """
    healthy = problem.model.unknown_level
    rough = rough_blocks(best.effects)
    levels: dict[str, float] = {}
    left = best.levels if best.members else problem.none_levels
    for name, level in left.items():
        is_shaken = rough and name not in rough and name.startswith(SHAKEN_BLOCKS)
        if name not in healthy or name.startswith(DEAF_BLOCKS) or is_shaken:
            continue
        middle, sd = healthy[name]
        before = np.exp(none.levels[name]) - np.exp(middle)
        is_form = np.exp(level) - np.exp(middle) < FORM_LEFT_RATIO * before
        levels[name] = 0.0 if is_form else (level - middle) / sd
    return levels


def _rival(
    problem: Problem, ordered: Sequence[Hypothesis], probability: Array
) -> tuple[Hypothesis | None, float]:
    """The next cause, where the throws leave the choice open; and what they would favour the best by."""
    best = ordered[0]
    if not best.members or probability[0] >= SURE_PROBABILITY:
        return None, np.inf
    for other, share in zip(ordered[1:], probability[1:], strict=True):
        # A set and a part of it are no either-or.
        nested = set(best.members) <= set(other.members) or set(other.members) <= set(best.members)
        if share >= RIVAL_PROBABILITY and not nested:
            data = total(best.information)
            return other, expected_log_odds(
                data, problem.layout.priors, best.evidence, other.members
            )
    return None, np.inf
