"""One effect at one size, checked against the table; and the sizes that a set of effects has in one throw.

An effect that the table does not have, a wrong joint, a misspelt parameter or a value out of bounds is
refused, so that nothing in a profile is silently left out.
"""

from collections.abc import Iterable, Mapping

from pydantic import BaseModel, ConfigDict, model_validator

from sim_twin.effects.schema import DRIFT, StageName
from sim_twin.effects.table import EFFECTS

BOUND_SLACK = 1e-9
"""Share of the range by which a value may lie beyond a bound: rounding of finite differences."""


class Effect(BaseModel):
    """An effect of the table at a size; parameters left out are 0."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    effect: str
    joint: str | None = None
    parameters: Mapping[str, float]

    @model_validator(mode="after")
    def _fits_the_table(self) -> "Effect":
        spec = EFFECTS.get(self.effect)
        if spec is None:
            raise ValueError(f"no effect '{self.effect}'; the library has {', '.join(EFFECTS)}")
        if self.effect == DRIFT and len(self.parameters) != 1:
            raise ValueError(f"{DRIFT} needs exactly one parameter '<effect>.<parameter>'")
        for name, value in self.parameters.items():
            try:
                bounds = spec.parameter(name)
            except KeyError as error:
                raise ValueError(str(error.args[0])) from error
            slack = BOUND_SLACK * (bounds.high - bounds.low)
            if not bounds.low - slack <= value <= bounds.high + slack:
                raise ValueError(
                    f"{self.effect}: {name} = {value:g} is outside {bounds.low:g} to {bounds.high:g}"
                )
        self._check_joint(EFFECTS[acting_effect(self)].joints)
        return self

    def _check_joint(self, joints: tuple[str, ...]) -> None:
        if joints and self.joint not in joints:
            raise ValueError(
                f"{self.effect} acts on one joint: name one of {', '.join(joints)}, not {self.joint}"
            )
        if not joints and self.joint is not None:
            raise ValueError(f"{self.effect} acts on the whole machine, not on '{self.joint}'")

    def __hash__(self) -> int:
        """By name, joint and sizes, so that sets of effects can be keys."""
        return hash((self.effect, self.joint, tuple(sorted(self.parameters.items()))))


def acting_effect(effect: Effect) -> str:
    """Name of the effect that acts: the one that drifts for a drift."""
    if effect.effect != DRIFT:
        return effect.effect
    return next(iter(effect.parameters)).split(".")[0]


def deterministic(effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """The effects without those that are random."""
    return tuple(e for e in effects if not EFFECTS[acting_effect(e)].is_random)


def effect_stage(effect: Effect) -> StageName:
    """Stage at which an effect acts; that of the drifting effect for a drift."""
    return EFFECTS[acting_effect(effect)].stage


Sizes = dict[tuple[str, str | None, str], float]
"""Size by effect, joint and parameter."""


def resolve(effects: Iterable[Effect], progress_ratio: float) -> Sizes:
    """Sizes that a set of effects has in one throw: sums of equal effects, with drifts applied.

    Args:
        effects: any number, in any order; two of the same kind add up.
        progress_ratio: place of the throw in its set, 0 for the first and 1 for the last.
    """
    sizes: Sizes = {}
    for effect in effects:
        for name, value in effect.parameters.items():
            kind, parameter, size = effect.effect, name, float(value)
            if kind == DRIFT:
                kind, parameter = name.split(".")
                size *= progress_ratio
            key = (kind, effect.joint, parameter)
            sizes[key] = sizes.get(key, 0.0) + size
    return sizes
