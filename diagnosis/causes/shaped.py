"""Sets of effects with a shape of an unheard-of one beside them."""

from collections.abc import Sequence

import numpy as np

from diagnosis.causes.evidence import Set, SetEvidence, weigh
from diagnosis.causes.parameters import ROUGH_EFFECTS, Group
from diagnosis.causes.problem import Problem
from diagnosis.causes.shapes import group_of
from diagnosis.causes.weighing import Seen, Trial, own_evidence
from sim_twin.effects.table import effects_where

METERING_EFFECTS = effects_where(lambda effect: effect.shapes_speed)
SHAPED_COUNT = 5
"""Sets with a shape that are weighed."""
LEAST_OWN_LOG_EVIDENCE = 4.0
"""That a shape has to tell by what no name explains of it. In seven sets with unknown
effects the leading shapes told 6 to 38 by that; a stranger's gain of 0.15 beside a late sensor was a valve
whose speed grows with the command in another way, 11 ahead of the late sensor alone, and told 1.3."""


def with_shapes(problem: Problem, trials: Sequence[Trial]) -> list[Seen]:
    """The best sets of a trial's effects and a shape of an unheard-of one.

    Shapes are linear in their sizes: there is nothing to simulate.
    """
    groups = problem.layout.groups
    shapes = [g for g in range(len(groups)) if problem.layout.is_unheard(g)]
    found: list[tuple[float, Set, int]] = []
    for place, t in enumerate(trials):
        own = own_evidence(t)
        named = [groups[m] for m in t.members]
        for shape in (g for g in shapes if not _is_form_of(named, groups[g])):
            members = (*t.members, shape)
            weighed = weigh(t.base, t.priors, members)
            log_evidence = t.base.log_evidence + weighed.log_odds
            if log_evidence > own and _of_its_own(t, weighed) > LEAST_OWN_LOG_EVIDENCE:
                found.append((log_evidence, members, place))
    found.sort(key=lambda one: -one[0])
    return [(place, members) for _, members, place in found[:SHAPED_COUNT]]


def _is_form_of(named: Sequence[Group], shape: Group) -> bool:
    """Whether a shape may be what the form of named effects leaves at its joint.

    Nobody knows that of an effect that makes a joint rough. A valve's own metering, of which a dead band and
    a gain are the simplest form, makes its speed grow with the command in another way: beside a dead band of
    0.08 and 0.11 that was 28 ahead of the gain of 0.35 that was there.
    """
    own = {effect for effect, joint in named if joint == shape[1]}
    is_metered = not own.isdisjoint(METERING_EFFECTS) and shape[0] == group_of("command")
    return is_metered or not own.isdisjoint(ROUGH_EFFECTS)


def _of_its_own(trial: Trial, weighed: SetEvidence) -> float:
    """Log evidence that the shape at a set's end tells by what no name explains of it, at its size there."""
    index = trial.priors.groups[weighed.members[-1]]
    size = weighed.mean[-index.size :]
    return 0.5 * float(size @ trial.base.precision[np.ix_(index, index)] @ size)
