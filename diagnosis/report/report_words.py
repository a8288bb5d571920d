"""Numbers and names of a diagnosis for people: fixed digits, unit, a sign and a word on every error."""

import math
from collections.abc import Mapping
from typing import Any, cast

from diagnosis.verdict import Cause, FittedEffect, FittedParameter, Stage, VerdictKind
from sim_twin.effects.schema import DRIFT

MINUS = "−"
NONE = "–"

VERDICT_WORDS: Mapping[VerdictKind, str] = {
    VerdictKind.NONE: "No gap beyond a healthy machine's",
    VerdictKind.EXPLAINED: "Explained",
    VerdictKind.AMBIGUOUS: "Ambiguous: two causes fit",
    VerdictKind.UNKNOWN: "Unknown effect",
    VerdictKind.BAD_DATA: "Data cannot be used",
}

HEALTHY_OUT = "Both without what every healthy machine of the type is off its twin by."
"""Of the gap before and after: smaller than the miss that is stated first."""

STAGE_WORDS: Mapping[Stage, tuple[str, str]] = {
    Stage.ACTUATION: ("Actuation", "command to joint motion"),
    Stage.SWING: ("Swing", "joint motion to gripper"),
    Stage.RELEASE: ("Release", "command to opening"),
    Stage.FLIGHT: ("Flight", "release to impact"),
    Stage.AIM: ("Aim", "sensors, base, survey"),
}
"""Title of a stage and what it leads from and to."""


_CHANNEL_WORDS: Mapping[str, str] = {
    "release.switch": "the time of the opening",
    "flight.ball": "the tracked flight of the load",
    "flight.impact": "the impact",
}


def channel_words(channel: str) -> str:
    """What was measured in a channel of residuals (diagnosis.causes.residuals): "the speed of the boom"."""
    stage, _, rest = channel.partition(".")
    if stage == Stage.ACTUATION:
        return f"the speed of the {rest}"
    kind, _, axis = rest.partition(".")
    if stage == Stage.SWING and kind == "gyro":
        return f"the gripper's turning about its {axis} axis"
    if stage == Stage.SWING and kind == "accel":
        return f"the gripper's acceleration along its {axis} axis"
    return _CHANNEL_WORDS.get(channel, channel.replace(".", " ").replace("_", " "))


def unknown_facts(signature: Mapping[str, Any]) -> dict[str, Any]:
    """Where an unknown effect shows and what it looks like, by names that people read."""
    names = {"channel": "shows in", "leftover_sd": "standard deviations above a healthy machine"}
    facts = {names.get(key, key): value for key, value in signature.items() if value is not None}
    if "shows in" in facts:
        facts["shows in"] = channel_words(str(facts["shows in"]))
    return facts


def compared_words(evidence: Mapping[str, Any]) -> str | None:
    """What throws were compared with; None where nothing was compared, as for one stage alone."""
    if "reference" not in evidence:
        return None
    reference = evidence["reference"]
    if not isinstance(reference, Mapping):
        return "healthy machines of the type"
    count = cast("Mapping[str, Any]", reference).get("throws_count")
    return f"{count} healthy throws of this machine"


def fixed(value: float | None, digits: int = 2) -> str:
    """Fixed digits with a true minus sign and without "-0.00"; a dash for what is not known."""
    if value is None or not math.isfinite(value):
        return NONE
    text = f"{abs(value):.{digits}f}"
    return MINUS + text if value < 0 and float(text) != 0.0 else text


def metres(value: float | None) -> str:
    """A length."""
    return NONE if value is None or not math.isfinite(value) else f"{fixed(value)} m"


def percent(ratio: float | None) -> str:
    """A share."""
    if ratio is None or not math.isfinite(ratio):
        return NONE
    return f"{fixed(100.0 * ratio, 0)} %"


def probability(value: float) -> str:
    """A probability; never quite certain."""
    if value > 0.995:
        return "> 99 %"
    return "< 1 %" if value < 0.005 else percent(value)


def downrange(error_m: float) -> str:
    """Error along the target line: "+0.12 m long"."""
    return _error(error_m, "long", "short", "on range")


def crossrange(error_m: float) -> str:
    """Error across it, left positive as in frame `throw`: "+0.05 m left"."""
    return _error(error_m, "left", "right", "on line")


def _error(error_m: float, positive: str, negative: str, zero: str) -> str:
    if not math.isfinite(error_m):
        return NONE
    if abs(error_m) < 0.005:
        return f"0.00 m {zero}"
    return f"{'+' if error_m > 0.0 else ''}{fixed(error_m)} m {positive if error_m > 0.0 else negative}"


def effect_words(effect: str, joint: str | None) -> str:
    """An effect for people: "valve dead time, boom"; of a drift what drifts, "drift of valve lag, boom"."""
    kind, _, drifting = effect.partition(":")
    name = f"drift of {_parameter_name(drifting)}" if drifting else kind.replace("_", " ")
    return name if joint is None else f"{name}, {joint}"


def fitted_words(effect: FittedEffect) -> str:
    """An effect that was fitted; a drift by what drifts."""
    drifting = next((name for name in effect.parameters if "." in name), "").partition(".")[0]
    return effect_words(f"{DRIFT}:{drifting}" if drifting else effect.effect, effect.joint)


def cause_words(cause: Cause) -> str:
    """A hypothesis for people."""
    if cause.effects:
        return " + ".join(fitted_words(effect) for effect in cause.effects)
    return {"none": "no effect", "unknown": "something unknown"}.get(cause.name, cause.name)


def size_words(effect: FittedEffect) -> list[tuple[str, str, str]]:
    """Every parameter of an effect: name, value, 90 % interval."""
    return [(_parameter_name(name), *_size(p)) for name, p in effect.parameters.items()]


def _parameter_name(name: str) -> str:
    name = name.replace(".", ", ")
    for suffix in ("_rad_m_per_s", "_rad_per_s2", "_rad_per_s", "_per_s2", "_m_per_s", "_per_s"):
        if name.endswith(suffix):
            return name.removesuffix(suffix).replace("_", " ")
    for suffix in ("_rad_m", "_per_m", "_ratio", "_rad", "_kg", "_s", "_m"):
        if name.endswith(suffix):
            return name.removesuffix(suffix).replace("_", " ")
    return name.replace("_", " ")


def _size(parameter: FittedParameter) -> tuple[str, str]:
    scale, unit = 1.0, parameter.unit
    ends = (*parameter.ci90, parameter.value)
    largest = max((abs(v) for v in ends if math.isfinite(v)), default=0.0)
    if unit == "s" and largest < 1.0:
        scale, unit = 1e3, "ms"
    elif unit == "rad" and largest < 1.0:
        scale, unit = 1e3, "mrad"
    elif unit in {"m", "m/s"} and largest < 0.1:
        scale, unit = 1e3, "mm" if unit == "m" else "mm/s"
    elif unit in {"", "1", "ratio"}:
        scale, unit = 100.0, "%"
    digits = 0 if largest * scale >= 100.0 else 1 if largest * scale >= 10.0 else 2
    low, high = (fixed(v * scale, digits) for v in parameter.ci90)
    tail = f" {unit}" if unit else ""
    return f"{fixed(parameter.value * scale, digits)}{tail}", f"{low} to {high}{tail}"
