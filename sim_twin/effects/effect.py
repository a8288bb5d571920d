"""One effect at one size, checked against the library; and what a set of them comes to for one throw.

An effect that the library does not know, a wrong joint, a misspelt parameter or a value out of bounds is
refused, so that nothing in a profile is silently left out.
"""

from collections.abc import Iterable, Mapping

from pydantic import BaseModel, ConfigDict, model_validator

from sim_twin.effects.library import DRIFT, EFFECTS, EffectSpec, ParameterSpec, StageName

__all__ = [
    "DRIFT",
    "EFFECTS",
    "Effect",
    "EffectSpec",
    "ParameterSpec",
    "StageName",
    "acting_effect",
    "deterministic",
    "effect_stage",
    "parameter_unit",
    "resolve",
]

BOUND_SLACK = 1e-9
"""Share of the range by which a value may lie beyond a bound: rounding of finite differences."""
_UNITS = (
    ("_rad_m_per_s", "rad/s"),
    ("_rad_per_s2", "rad/s2"),
    ("_rad_per_s", "rad/s"),
    ("_m_per_s", "m/s"),
    ("_per_s2", "1/s2"),
    ("_per_s", "1/s"),
    ("_rad_m", "rad"),
    ("_rad", "rad"),
    ("_kg", "kg"),
    ("_m", "m"),
    ("_s", "s"),
)


class Effect(BaseModel):
    """An effect of the library at a size; parameters left out are 0."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    effect: str
    joint: str | None = None
    parameters: Mapping[str, float]

    @model_validator(mode="after")
    def _fits_the_library(self) -> "Effect":
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
    """Name of what acts: the effect's own, or of the effect that drifts."""
    if effect.effect != DRIFT:
        return effect.effect
    return next(iter(effect.parameters)).split(".")[0]


def deterministic(effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """The effects without what is random: `release_jitter`."""
    return tuple(e for e in effects if acting_effect(e) != "release_jitter")


def effect_stage(effect: Effect) -> StageName:
    """Stage at which an effect acts; a drift acts where what it changes acts."""
    return EFFECTS[acting_effect(effect)].stage


def parameter_unit(name: str, joint: str | None = None) -> str:
    """Unit of a parameter, from its name; that of the telescope is linear. Ratios have none: ``1``."""
    for suffix, unit in _UNITS:
        if name.endswith(suffix):
            linear = joint == "telescope" and "_rad_m" in suffix
            return unit.replace("rad", "m") if linear else unit
    return "1"


Sizes = dict[tuple[str, str | None, str], float]
"""Size by effect, joint and parameter."""


def resolve(effects: Iterable[Effect], progress_ratio: float) -> Sizes:
    """What a set of effects comes to for one throw: sums of equal effects, drifts carried out.

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
