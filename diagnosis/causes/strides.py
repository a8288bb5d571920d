"""Sizes of effects whose slopes are no guide: larger and smaller, stride by stride, as far as that helps."""

from collections.abc import Sequence

import numpy as np

from diagnosis.causes.problem import Problem
from diagnosis.causes.trials import BENT_EFFECTS, CURVED_EFFECTS, Seed, try_sets
from diagnosis.causes.weighing import Trial, best_of_each, by_member
from sim_twin.effects.table import effects_where

STRIDING = effects_where(lambda effect: effect.growth not in ("linear", "threshold"))
"""Effects whose slopes are no guide to other sizes."""
LONG_STRIDES_RATIO = (1.5, 1.2)
"""Of looks: slopes led a slew's speed limit of 0.4 from 0.6 to 0.71, a boom's hysteresis of 0.12 from 0.2 to
0.19, 0.18 and on, and a boom's dead time of 0.148 s from 0.08 s to 0.036 s."""
SHORT_STRIDES_RATIO = (1.1, 1.05)
"""Of what was settled: a slew's limit was left at 0.57, 250 of log evidence behind what it had at 0.5, and
with a gain at its joint a dipper's at 0.7, 50 behind 0.63."""


def look(problem: Problem, seeds: Sequence[Seed]) -> list[Trial]:
    """A first look at sets, each at the best of its sizes."""
    return best_of_each(try_sets(problem, seeds, is_rough=True))


def followed(problem: Problem, looks: Sequence[Trial]) -> list[Seed]:
    """Where looks were simulated, and where striding effects looked better beside it."""
    found = list(looks)
    for ratio in LONG_STRIDES_RATIO:
        found = best_of_each([*found, *look(problem, _beside(problem, found, STRIDING, ratio))])
    moved = [t for t in found if t not in looks]
    return [(t.members, t.at) for t in (*looks, *moved)]


def polished(problem: Problem, trials: Sequence[Trial]) -> list[Trial]:
    """Trials, their effects that bend or curve where they are told best within a few short strides."""
    found = list(trials)
    for ratio in SHORT_STRIDES_RATIO:
        beside = try_sets(problem, _beside(problem, found, (*BENT_EFFECTS, *CURVED_EFFECTS), ratio))
        found = best_of_each([*found, *beside])
    return found


def _beside(
    problem: Problem, trials: Sequence[Trial], effects: Sequence[str], ratio: float
) -> list[Seed]:
    """Where trials were simulated, some effects so many times larger and smaller, if they have any."""
    groups = problem.layout.groups
    seeds: list[Seed] = []
    for trial in trials:
        parts = by_member(trial.plain, trial.members, trial.at)
        strides = [m for m in parts if groups[m][0] in effects]
        for times in (ratio, 1.0 / ratio) if strides else ():
            sizes = [part * (times if m in strides else 1.0) for m, part in parts.items()]
            seeds.append((trial.members, np.concatenate(sizes)))
    return seeds
