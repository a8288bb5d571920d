"""What a record could not have shown: the size up to which each effect that was not found may be there.

A verdict "none" is only worth what the record could have told.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from diagnosis.alone.fit import Fit, fit
from diagnosis.alone.intervals import intervals
from diagnosis.alone.problem import Problem
from diagnosis.alone.selection import SHAPE_EFFECTS, Selection


class Limit(NamedTuple):
    """The upper end of the 90 % interval of an effect's size, fitted beside the effects that were found."""

    effect: str
    parameter: str
    below: float
    unit: str

    def in_words(self) -> str:
        """For the sentence of a verdict."""
        return f"{self.effect} up to {self.below:.2g} {self.unit}".removesuffix(" 1")


MOST_LIMITS_COUNT: Final = 8
CLEAN_RATIO: Final = 1.5
"""A residual of as many times the noise is noise; a larger one has errors that no average takes away."""


def hidden_limits(problem: Problem, selection: Selection) -> tuple[Limit, ...]:
    """Limits of the effects that are not in the best structure, one a parameter."""
    best = selection.best.fit
    taken = {option.effect for option in best.options}
    limits: list[Limit] = []
    for option in problem.options:
        if option.effect in taken or option.effect in SHAPE_EFFECTS:
            continue
        taken.add(option.effect)
        found = fit(problem, (*best.options, option), best.as_mapping())
        ranges = intervals(problem, selection.correlation_samples, found)
        for p in option.parameters:
            name = f"{option.key}.{p.name}"
            low, high = ranges[name]
            size = max(abs(low), abs(high), _size_of_what_is_left(problem, found, name))
            limits.append(Limit(option.effect, p.name, min(size, p.high), p.unit))
    return tuple(limits[:MOST_LIMITS_COUNT])


def _size_of_what_is_left(problem: Problem, found: Fit, name: str) -> float:
    """Size at which the effect alone moves the response as much as what the fit leaves; 0 if that is noise.

    Errors of the record (a lens, a scale that changes with the distance) can hide as much of the effect
    beyond what scale, start and speed take up.
    """
    left = math.sqrt(found.mean_square)
    if left < CLEAN_RATIO * problem.noise:
        return 0.0
    own = np.array([one == name for one in found.names])
    basis, _ = np.linalg.qr(found.jacobian[:, ~own])
    column = found.jacobian[:, own]
    pattern = math.sqrt(float(np.mean((column - basis @ (basis.T @ column)) ** 2)))
    return left / max(pattern, 1e-12)
