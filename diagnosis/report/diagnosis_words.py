"""What people read of a diagnosis: causes, sizes, reasons. The report and the console's Gap page show it."""

from collections.abc import Mapping, Sequence
from typing import Any, cast

from pydantic import BaseModel, ConfigDict

from diagnosis.report.vocabulary import (
    cause_words,
    effect_words,
    fitted_words,
    ruled_out_words,
    sentence,
    shrink_words,
    size_words,
)
from diagnosis.verdict import Cause, Diagnosis
from reports.number_format import probability


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


class DiagnosisWords(_Part):
    """Texts beside a `Diagnosis`."""

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
        causes=tuple(_cause(cause) for cause in found.causes),
        ruled_out=tuple(_reason(entry) for entry in entries(found.evidence.get("ruled_out"))),
        undecided=""
        if ambiguity is None
        else sentence("undecided", members=" or ".join(ambiguity.members), why=ambiguity.why),
        shrink=_shrink(found),
    )


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
