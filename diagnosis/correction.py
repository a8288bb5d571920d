"""The next version of a machine's twin profile from a diagnosis."""

from collections.abc import Sequence

from diagnosis.verdict import Diagnosis, VerdictKind
from sim_twin.effects.effect import Effect
from sim_twin.twin.profile import TwinProfile


def found_effects(found: Diagnosis) -> tuple[Effect, ...]:
    """The effects that an explained diagnosis would add to the twin; empty for every other verdict."""
    if found.verdict is not VerdictKind.EXPLAINED or not found.causes:
        return ()
    return tuple(
        Effect(
            effect=fitted.effect,
            joint=fitted.joint,
            parameters={name: p.value for name, p in fitted.parameters.items()},
        )
        for fitted in found.causes[0].effects
    )


def corrected_profile(
    profile: TwinProfile, found: Diagnosis, machine_id: str, note: str
) -> TwinProfile:
    """The next version of a profile: its effects, the effects found, and their 90 % intervals.

    Args:
        profile: that the throws were compared with.
        found: an explained diagnosis.
        machine_id: machine of the new profile.
        note: origin of the effects, for people.

    Raises:
        ValueError: there is nothing to add.
    """
    effects = found_effects(found)
    if not effects:
        raise ValueError(f"verdict '{found.verdict.value}' names no effect to add")
    intervals = {
        ".".join(part for part in (fitted.effect, fitted.joint, name) if part): p.ci90
        for fitted in found.causes[0].effects
        for name, p in fitted.parameters.items()
    }
    values = profile.model_dump()
    values |= {
        "machine_id": machine_id,
        "version_count": profile.version_count + 1,
        "note": note,
        "effects": [*values["effects"], *(effect.model_dump() for effect in effects)],
        "intervals": {**values["intervals"], **intervals},
    }
    return TwinProfile.model_validate(values)


def with_effects(profile: TwinProfile, effects: Sequence[Effect]) -> TwinProfile:
    """The next version of a profile, with these effects added."""
    return profile.model_copy(
        update={
            "effects": (*profile.effects, *effects),
            "version_count": profile.version_count + 1,
        }
    )
