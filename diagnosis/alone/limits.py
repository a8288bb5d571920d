"""What a record could not have shown: the size up to which each effect that was not found may be there.

A verdict "none" is only worth what the record could have told.
"""

from typing import Final, NamedTuple

from diagnosis.alone.fit import Problem, fit
from diagnosis.alone.selection import SHAPE_EFFECTS, Selection, intervals


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
        ranges = intervals(problem, selection, found)
        for p in option.parameters:
            low, high = ranges[f"{option.key}.{p.name}"]
            limits.append(Limit(option.effect, p.name, max(abs(low), abs(high)), p.unit))
    return tuple(limits[:MOST_LIMITS_COUNT])
