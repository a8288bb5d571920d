"""Titles, sentences and units of a diagnosis for people.

The report and the server make texts of them (diagnosis_words.py). The console's Gap page has titles and
sentences without numbers in ``web/src/api/vocabulary.ts``, which ``make types`` writes from
`vocabulary_tables`.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple, cast

from diagnosis.verdict import Cause, FittedEffect, FittedParameter, Shrink, Stage, VerdictKind
from reports.number_format import fixed, percent
from sim_twin.effects.effect import DRIFT


class VerdictWords(NamedTuple):
    """Words of one verdict."""

    title: str
    short: str
    """For lists."""
    stage_mark: str
    """What the marked stage is: the cause, unexplained, or only the largest."""
    needs_attention: bool
    """The person has to act before the result can be used."""


VERDICTS: Mapping[VerdictKind, VerdictWords] = {
    VerdictKind.NONE: VerdictWords(
        "No gap beyond a healthy machine's", "No gap", "largest", needs_attention=False
    ),
    VerdictKind.EXPLAINED: VerdictWords("Explained", "Explained", "cause", needs_attention=False),
    VerdictKind.AMBIGUOUS: VerdictWords(
        "Ambiguous: two causes fit", "Ambiguous", "cause", needs_attention=True
    ),
    VerdictKind.UNKNOWN: VerdictWords(
        "Unknown effect", "Unknown effect", "unexplained", needs_attention=True
    ),
    VerdictKind.BAD_DATA: VerdictWords("Data cannot be used", "Bad data", "", needs_attention=True),
}


class StageWords(NamedTuple):
    """Title of a stage, and what it leads from and to."""

    title: str
    link: str


STAGES: Mapping[Stage, StageWords] = {
    Stage.ACTUATION: StageWords("Actuation", "command to joint motion"),
    Stage.SWING: StageWords("Swing", "joint motion to gripper"),
    Stage.RELEASE: StageWords("Release", "command to opening"),
    Stage.FLIGHT: StageWords("Flight", "release to impact"),
    Stage.AIM: StageWords("Aim", "sensors, base, survey"),
}
"""In the order of the chain."""


class ShownUnit(NamedTuple):
    """Unit in which small values of another unit are shown."""

    below: float
    """Magnitude in the original unit below which this unit is used."""
    scale: float
    unit: str


SHOWN_UNITS: Mapping[str, ShownUnit] = {
    "s": ShownUnit(1.0, 1e3, "ms"),
    "rad": ShownUnit(1.0, 1e3, "mrad"),
    "m": ShownUnit(0.1, 1e3, "mm"),
    "m/s": ShownUnit(0.1, 1e3, "mm/s"),
}
RATIO_UNITS = ("", "1", "ratio")
"""Units of ratios, which are shown in percent."""
UNIT_SUFFIXES = (
    "_rad_m_per_s", "_rad_per_s2", "_rad_per_s", "_m_per_s", "_per_s2", "_per_s", "_per_m", "_rad_m",
    "_ratio", "_rad", "_kg", "_s", "_m",
)  # fmt: skip
"""Units at the end of parameter names, longer ones first; titles leave them out."""

SENTENCES: Mapping[str, str] = {
    "none": "no effect",
    "unknown": "something unknown",
    "drift": "drift of {parameter}",
    "effect_of_joint": "{effect}, {joint}",
    "interval": "{low} to {high}",
    "interval_90": "90 % interval {low} to {high}",
    "log_odds": "natural log odds {odds} against no effect",
    "compared_with_machine": "{count} of this machine",
    "healthy_throw": "healthy throw",
    "compared_with_type": "healthy machines of the type",
    "health_kept": "{words}; its model is kept from {time}",
    "drifts": "from the first throw to the last, {clause}",
    "interval_is": "90 % interval {interval}",
    "at_bound": "at the end of the range that is searched: it may be more",
    "which_miss": (
        "The miss is that of the replay: the twin is given the valve commands of each throw as they were "
        "sent. The preview chose other commands, so its miss is another one."
    ),
    "next_none": "Nothing to do: keep the twin as it is.",
    "next_commission": "To see smaller effects, commission the machine: it keeps reference throws.",
    "next_explained": (
        "Look at {places}. If the machine stays as it is, apply the result to its twin; "
        "diagnose again after a repair."
    ),
    "next_ambiguous": "Record {motion}; then diagnose again.",
    "next_unknown": (
        "Look at {part}; nothing is applied to the twin. Record {motion}, and diagnose that stage alone."
    ),
    "next_bad_data": "Mend or replace the refused logs: each has its remedy below. Then diagnose again.",
    "undecided": "Undecided: {members}; {why}.",
    "where": (
        "Metres of miss that each stage adds, along the target line and across it; the bar is the 90 % "
        "interval along it, of the mean over the throws. The terms sum to measured minus twin. Shares "
        "compare root mean squares over the throws: a term may be large and its mean small."
    ),
    "where_single_stage": (
        "One stage was recorded on its own: its share is all of the gap, in the recorded channel."
    ),
    "no_term": "no term",
    "not_recorded": "not recorded",
    "share_of_terms": "{share} of all terms",
    "removes": "Removes {share} of the {gap} on {count} held-out {samples}, {interval}.",
    "widens": (
        "Widens the {gap} by {growth} on {count} held-out {samples} (removes {share}, {interval})."
    ),
    "removable_gap": "removable gap",
    "channel_gap": "gap in the channels that it moves",
    "predicted": "Predicted before it was added: {share}.",
    "removable": "{share} of the gap is removable, the rest is noise and jitter.",
    "miss_is_no_measure": "The miss itself is no measure here; it is given for comparison.",
    "without_type_error": (
        "Both values are without the error that every healthy machine of the type has against its twin."
    ),
    "twin_before": "twin before",
    "twin_after": "twin after",
    "measured": "measured",
    "measured_minus_twin": "measured minus twin",
    "impact_rms": "Replay misses by (root mean square)",
    "healthy_rms": "While the machine was healthy",
    "along": "Along, measured minus twin",
    "across": "Across",
    "throws_used": "Throws used",
    "twin": "Twin",
    "twin_version": "{machine}, version {version}",
    "compared_with": "Compared with",
    "residual": "Residual over a healthy machine's",
    "section_where": "Where",
    "section_which": "Which",
    "section_next": "Next experiment",
    "section_action": "What to do",
    "section_shrink": "How far it shrinks",
    "section_plots": "Measured against twin",
    "section_ruled_out": "Ruled out",
    "section_refused": "Refused logs",
    "column_probability": "Probability",
    "column_cause": "Cause",
    "column_size": "Size, 90 % interval",
}
"""Sentences and terms; names in braces are filled in."""

SERIES: Mapping[str, tuple[str, ...]] = {
    "measured": ("measured",),
    "twin_before": ("ideal", "twin", "before", "twin_before"),
    "twin_after": ("explained", "after", "twin_after"),
}
"""Role of a series in a plot -> the names under which diagnoses store it."""

_PARTS: Mapping[str, str] = {
    "swing": "the swing of the gripper",
    "release": "the opening",
    "flight": "the flight of the load",
    "aim": "the pose of base and sensors",
}


def vocabulary_tables() -> dict[str, Any]:
    """The tables that the console needs, as JSON values."""
    return {
        "verdicts": {kind.value: words._asdict() for kind, words in VERDICTS.items()},
        "stages": [{"stage": stage.value, **words._asdict()} for stage, words in STAGES.items()],
        "sentences": dict(SENTENCES),
        "series": {role: list(names) for role, names in SERIES.items()},
    }


def sentence(name: str, **values: object) -> str:
    """A sentence of `SENTENCES` with its values filled in."""
    return SENTENCES[name].format(**values)


def channel_words(part: str) -> str:
    """What a part of the chain is that leaves a residual: "the speed of the boom"."""
    stage, _, joint = part.partition(".")
    if stage == Stage.ACTUATION and joint:
        return f"the speed of the {joint}"
    return _PARTS.get(part, part.replace(".", " ").replace("_", " "))


def signature_facts(signature: Mapping[str, Any]) -> dict[str, Any]:
    """Where an unknown effect shows and what it resembles, under names for people."""
    names = {"channel": "shows in", "leftover_sd": "standard deviations above a healthy machine"}
    facts = {names.get(key, key): value for key, value in signature.items() if value is not None}
    if "shows in" in facts:
        facts["shows in"] = channel_words(str(facts["shows in"]))
    return facts


def reference_words(evidence: Mapping[str, Any]) -> str | None:
    """What the throws were compared with; None for one stage, which is compared with nothing."""
    if "reference" not in evidence:
        return None
    reference = evidence["reference"]
    if not isinstance(reference, Mapping):
        return compared_words(0)
    known = cast("Mapping[str, Any]", reference)
    words = compared_words(int(known.get("throws_count", 0)))
    days = list(cast("Mapping[str, int]", known.get("days", {})))
    words = f"{words}, {', '.join(days)}" if days else words
    kept_utc = known.get("kept_utc")
    return (
        words if kept_utc is None else sentence("health_kept", words=words, time=_minute(kept_utc))
    )


def _minute(utc: Any) -> str:
    """YYYY-MM-DDTHH:MM:SSZ to the minute, for people."""
    return f"{str(utc)[:16].replace('T', ' ')} UTC"


def plot_source(throw_id: Any, thrown_utc: Any) -> str:
    """Which throw a plot shows; empty where it is not known."""
    if not isinstance(throw_id, str):
        return ""
    time = "" if not isinstance(thrown_utc, str) else f", {_minute(thrown_utc)}"
    return f"{throw_id}{time}"


def compared_words(reference_throw_count: int) -> str:
    """What throws are compared with: healthy throws of the machine, or its type where there are none."""
    if reference_throw_count == 0:
        return SENTENCES["compared_with_type"]
    plural = "" if reference_throw_count == 1 else "s"
    count = f"{reference_throw_count} {SENTENCES['healthy_throw']}{plural}"
    return sentence("compared_with_machine", count=count)


def effect_words(effect: str, joint: str | None) -> str:
    """An effect: "valve dead time, boom"; a drift by what drifts, "drift of valve lag, boom"."""
    kind, _, drifting = effect.partition(":")
    name = kind.replace("_", " ")
    if drifting:
        name = sentence("drift", parameter=parameter_words(drifting))
    return name if joint is None else sentence("effect_of_joint", effect=name, joint=joint)


def fitted_words(effect: FittedEffect) -> str:
    """An effect with fitted parameters; a drift by what drifts."""
    drifting = next((name for name in effect.parameters if "." in name), "").partition(".")[0]
    return effect_words(f"{DRIFT}:{drifting}" if drifting else effect.effect, effect.joint)


def cause_words(cause: Cause) -> str:
    """A hypothesis: its effects, "no effect" or "something unknown"."""
    if cause.effects:
        return " + ".join(fitted_words(effect) for effect in cause.effects)
    return SENTENCES[cause.name] if cause.name in ("none", "unknown") else cause.name


def parameter_words(name: str) -> str:
    """A parameter without its unit: "extra dead time"."""
    name = name.replace(".", ", ")
    suffix = next((suffix for suffix in UNIT_SUFFIXES if name.endswith(suffix)), "")
    return name.removesuffix(suffix).replace("_", " ")


def size_words(effect: FittedEffect) -> list[tuple[str, str, str]]:
    """Every parameter of an effect: name, value, 90 % interval."""
    return [(parameter_words(name), *_size(p)) for name, p in effect.parameters.items()]


def _size(parameter: FittedParameter) -> tuple[str, str]:
    """Value and interval in the unit in which they have the fewest zeros."""
    ends = (*parameter.ci90, parameter.value)
    largest = max((abs(v) for v in ends if math.isfinite(v)), default=0.0)
    scale, unit = 1.0, parameter.unit
    shown = SHOWN_UNITS.get(unit)
    if shown is not None and largest < shown.below:
        scale, unit = shown.scale, shown.unit
    elif unit in RATIO_UNITS:
        scale, unit = 100.0, "%"
    digits = 0 if largest * scale >= 100.0 else 1 if largest * scale >= 10.0 else 2
    low, high = (fixed(v * scale, digits) for v in parameter.ci90)
    tail = f" {unit}" if unit else ""
    interval = sentence("interval", low=low, high=high)
    return f"{fixed(parameter.value * scale, digits)}{tail}", f"{interval}{tail}"


def ruled_out_words(why: str, odds: object) -> str:
    """Why an effect was ruled out."""
    parts = [why] if why else []
    if isinstance(odds, int | float):
        parts.insert(0, sentence("log_odds", odds=fixed(odds, 1)))
    return "; ".join(parts)


def shrink_words(shrink: Shrink, *, by_channels: bool, samples: str = "throws") -> str:
    """How far the gap shrinks on held-out samples.

    Args:
        shrink: the result of the cross-validation.
        by_channels: measured on recorded channels, because the effect does not move the impact.
        samples: what was held out: throws, or pieces of a record.
    """
    gap = SENTENCES["channel_gap" if by_channels else "removable_gap"]
    low, high = (percent(end) for end in shrink.ci90)
    parts = [
        sentence(
            "widens" if shrink.ratio < 0.0 else "removes",
            share=percent(shrink.ratio),
            growth=percent(-shrink.ratio),
            gap=gap,
            count=shrink.held_out_throws,
            samples=samples,
            interval=sentence("interval_90", low=low, high=high),
        )
    ]
    if shrink.predicted_ratio is not None:
        parts.append(sentence("predicted", share=percent(shrink.predicted_ratio)))
    if by_channels:
        parts.append(SENTENCES["miss_is_no_measure"])
    else:
        parts.append(sentence("removable", share=percent(shrink.removable_ratio)))
    if samples == "throws":
        parts.append(SENTENCES["without_type_error"])
    return " ".join(parts)
