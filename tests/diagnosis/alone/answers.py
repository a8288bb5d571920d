"""What a diagnosis of one stage said, for tests."""

from diagnosis.verdict import Diagnosis


def effects(found: Diagnosis) -> set[str]:
    """Names of the effects of the first cause."""
    return {effect.effect for effect in found.causes[0].effects}


def value(found: Diagnosis, effect: str, parameter: str) -> tuple[float, float, float]:
    """Low end, value and high end of one parameter."""
    (one,) = [e for e in found.causes[0].effects if e.effect == effect]
    fitted = one.parameters[parameter]
    return fitted.ci90[0], fitted.value, fitted.ci90[1]


def notes_of(found: Diagnosis) -> str:
    """All notes in one."""
    return " ".join(found.evidence["notes"])
