"""What people read of a diagnosis: causes, sizes, reasons. The report and the console's Gap page show it."""

from collections.abc import Mapping, Sequence
from typing import Any, cast

from pydantic import BaseModel, ConfigDict

from diagnosis.report.effect_sentences import inspection
from diagnosis.report.vocabulary import (
    SENTENCES,
    cause_words,
    channel_words,
    effect_words,
    fitted_words,
    reference_words,
    ruled_out_words,
    sentence,
    shrink_words,
    size_words,
)
from diagnosis.separating_motions import stage_motion_words
from diagnosis.verdict import Cause, Diagnosis, VerdictKind
from reports.number_format import crossrange, downrange, metres, probability


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class SizeWords(_Part):
    """A parameter of an effect: "extra dead time", "62.0 ms", "55.0 to 70.0 ms"."""

    name: str
    value: str
    interval: str
    """At 90 %."""


class EffectWords(_Part):
    """An effect: "valve dead time, boom"."""

    title: str
    sizes: tuple[SizeWords, ...]


class CauseWords(_Part):
    """A hypothesis: its effects, "no effect" or "something unknown"."""

    title: str
    probability: str
    effects: tuple[EffectWords, ...]


class ReasonWords(_Part):
    """An effect that was ruled out, and why."""

    name: str
    why: str


class FactWords(_Part):
    """A number of the diagnosis: "Throws used", "12"."""

    name: str
    value: str


class DiagnosisWords(_Part):
    """Texts beside a `Diagnosis`."""

    facts: tuple[FactWords, ...]
    """What stands under the verdict."""
    action: str
    """What to do next; empty for one stage."""
    causes: tuple[CauseWords, ...]
    """In the order of the diagnosis' causes."""
    ruled_out: tuple[ReasonWords, ...]
    undecided: str
    """What these data cannot separate; empty where the diagnosis is not ambiguous."""
    shrink: str
    """How far the gap shrinks; empty where that was not measured."""


def words_of(found: Diagnosis) -> DiagnosisWords:
    """The texts of a diagnosis."""
    ambiguity = found.ambiguity
    return DiagnosisWords(
        facts=tuple(FactWords(name=name, value=value) for name, value in _facts(found)),
        action=_action(found),
        causes=tuple(_cause(cause) for cause in found.causes),
        ruled_out=tuple(_reason(entry) for entry in entries(found.evidence.get("ruled_out"))),
        undecided=""
        if ambiguity is None
        else sentence("undecided", members=" or ".join(ambiguity.members), why=ambiguity.why),
        shrink=_shrink(found),
    )


def _facts(found: Diagnosis) -> list[tuple[str, str]]:
    gap, evidence = found.gap, found.evidence
    facts: list[tuple[str, str]] = []
    if gap.impact_rms_m is not None:
        facts.append((SENTENCES["impact_rms"], metres(gap.impact_rms_m)))
    if gap.healthy_rms_m is not None:
        facts.append((SENTENCES["healthy_rms"], metres(gap.healthy_rms_m)))
    if gap.downrange_bias_m is not None:
        facts.append((SENTENCES["along"], downrange(gap.downrange_bias_m)))
    if gap.crossrange_bias_m is not None:
        facts.append((SENTENCES["across"], crossrange(gap.crossrange_bias_m)))
    if gap.trajectory_rms_ratio is not None:
        facts.append((SENTENCES["residual"], f"{gap.trajectory_rms_ratio:.2f}"))
    used = entries(evidence.get("throws_used"))
    if used:
        facts.append((SENTENCES["throws_used"], str(len(used))))
    twin = evidence.get("twin")
    if isinstance(twin, Mapping):
        known = cast("Mapping[str, Any]", twin)
        version = sentence(
            "twin_version", machine=known.get("machine_id"), version=known.get("version_count")
        )
        facts.append((SENTENCES["twin"], version))
    compared = reference_words(evidence)
    if compared is not None:
        facts.append((SENTENCES["compared_with"], compared))
    return facts


def _action(found: Diagnosis) -> str:
    """What a person does next."""
    if "reference" not in found.evidence and found.verdict is not VerdictKind.BAD_DATA:
        return ""
    match found.verdict:
        case VerdictKind.NONE:
            more = [SENTENCES["next_commission"]] if found.evidence["reference"] is None else []
            return " ".join([SENTENCES["next_none"], *more])
        case VerdictKind.EXPLAINED:
            effects = found.causes[0].effects if found.causes else ()
            places = dict.fromkeys(inspection(effect) for effect in effects)
            return sentence("next_explained", places="; ".join(places))
        case VerdictKind.AMBIGUOUS:
            motion = {} if found.ambiguity is None else found.ambiguity.separating_motion
            return sentence("next_ambiguous", motion=motion.get("words", ""))
        case VerdictKind.UNKNOWN:
            unknown = found.evidence.get("unknown")
            if not isinstance(unknown, Mapping):
                return ""
            known = cast("Mapping[str, Any]", unknown)
            return sentence(
                "next_unknown",
                part=channel_words(str(known.get("channel", ""))),
                motion=stage_motion_words(str(known.get("stage", ""))),
            )
        case VerdictKind.BAD_DATA:
            return SENTENCES["next_bad_data"]


def entries(value: Any) -> list[Any]:
    """The entries of a list in evidence; empty for anything else."""
    if not isinstance(value, Sequence) or isinstance(value, str):
        return []
    return list(cast("Sequence[Any]", value))


def _cause(cause: Cause) -> CauseWords:
    effects = [
        EffectWords(
            title=fitted_words(effect),
            sizes=tuple(
                SizeWords(name=name, value=value, interval=interval)
                for name, value, interval in size_words(effect)
            ),
        )
        for effect in cause.effects
    ]
    return CauseWords(
        title=cause_words(cause), probability=probability(cause.probability), effects=tuple(effects)
    )


def _reason(entry: Any) -> ReasonWords:
    if not isinstance(entry, Mapping):
        return ReasonWords(name=str(entry), why="")
    facts = cast("Mapping[str, Any]", entry)
    joint = facts.get("joint")
    return ReasonWords(
        name=effect_words(str(facts.get("effect", "")), None if joint is None else str(joint)),
        why=ruled_out_words(str(facts.get("why", "")), facts.get("log_odds")),
    )


def _shrink(found: Diagnosis) -> str:
    if found.shrink is None:
        return ""
    evidence = found.evidence
    unit = str(evidence.get("residual_unit", "m"))
    return shrink_words(
        found.shrink,
        by_channels=evidence.get("shrink_measure") == "channels",
        samples="throws" if unit == "m" and found.gap.impact_rms_m is not None else "pieces",
    )
