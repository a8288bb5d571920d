"""The result of a diagnosis as one HTML page."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, cast

from diagnosis.report.curves import figure, interval_bar
from diagnosis.report.diagnosis_words import DiagnosisWords, entries, words_of
from diagnosis.report.vocabulary import (
    SENTENCES,
    STAGES,
    VERDICTS,
    channel_words,
    sentence,
    signature_facts,
)
from diagnosis.verdict import Diagnosis, StageGap, VerdictKind
from reports.html import render_page
from reports.number_format import crossrange, downrange, metres, percent

OPEN_FIGURES_COUNT: Final = 3
"""Figures that are shown; the others are folded."""
_SECTIONS: Final = {"ruled_out", "where", "parts", "unknown", "refused"}
"""Evidence that has a section of its own."""


def diagnosis_html(found: Diagnosis, title: str = "Gap") -> str:
    """The page.

    Args:
        found: the result, of throws or of one stage.
        title: what was diagnosed.
    """
    evidence, words = found.evidence, words_of(found)
    figures = [
        drawn
        for name, plot in found.plots.items()
        if (drawn := figure(str(name), plot)) is not None
    ]
    unknown = evidence.get("unknown")
    return render_page(
        Path(__file__).parent,
        "diagnosis.html.j2",
        found=found,
        heading=title,
        words=SENTENCES,
        verdict=VERDICTS[found.verdict],
        facts=words.facts,
        action=words.action,
        chain=_chain(found),
        causes=list(zip(found.causes, words.causes, strict=True)),
        next_experiment=_next_experiment(found, words),
        unknown=signature_facts(cast("Mapping[str, Any]", unknown))
        if isinstance(unknown, Mapping)
        else None,
        shrink=_shrink(found, words),
        figures=figures,
        open_count=OPEN_FIGURES_COUNT,
        ruled_out=words.ruled_out,
        parts=_parts(evidence.get("parts")),
        refused=[entry for entry in entries(evidence.get("refused")) if isinstance(entry, Mapping)],
        is_bad_data=found.verdict is VerdictKind.BAD_DATA,
        evidence=_other_evidence(evidence),
    )


def _chain(found: Diagnosis) -> dict[str, Any] | None:
    """Every stage in the order of the chain with its terms; None without stages."""
    if not found.stages:
        return None
    where, named = found.evidence.get("where"), entries(found.evidence.get("named"))
    # Without a gap the place is only the largest term and is not marked.
    is_marked = isinstance(where, Mapping) and found.verdict is not VerdictKind.NONE
    here = str(where.get("stage")) if isinstance(where, Mapping) and is_marked else ""
    numbers = [v for s in found.stages for v in (*s.ci90_m, s.miss_m.downrange)]
    is_metric = any(value != 0.0 for value in numbers)
    limit = max((abs(v) for v in numbers if not math.isnan(v)), default=0.0)
    links: list[dict[str, Any]] = []
    for stage, words in STAGES.items():
        terms = [s for s in found.stages if s.stage is stage]
        joints = [place["joint"] for place in named if place["stage"] == stage]
        is_here = stage == here or bool(joints) or (not here and not is_metric and bool(terms))
        links.append(
            {
                "words": words,
                "is_here": is_here,
                "joints": ", ".join(term.joint for term in terms if term.joint is not None),
                "sum": _along_and_across(terms),
                "terms": [_term(term, limit, term.joint in joints) for term in terms],
            }
        )
    return {"is_metric": is_metric, "links": links}


def _along_and_across(terms: Sequence[StageGap]) -> tuple[str, str]:
    return (
        downrange(sum(term.miss_m.downrange for term in terms)),
        crossrange(sum(term.miss_m.crossrange for term in terms)),
    )


def _term(term: StageGap, limit: float, is_named: bool) -> dict[str, Any]:
    along, across = _along_and_across([term])
    ends = sentence("interval_90", low=metres(term.ci90_m[0]), high=metres(term.ci90_m[1]))
    return {
        "joint": (term.joint or "") + (" (cause)" if is_named else ""),
        "along": along,
        "across": across,
        "ends": ends,
        "share": sentence("share_of_terms", share=percent(term.share_ratio)),
        "bar": interval_bar(term.miss_m.downrange, term.ci90_m, limit, f"{along}, {ends}"),
    }


def _next_experiment(found: Diagnosis, words: DiagnosisWords) -> dict[str, Any] | None:
    """What is undecided, and the motion that would decide it."""
    if found.ambiguity is None:
        return None
    motion = found.ambiguity.separating_motion
    return {
        "undecided": words.undecided,
        "motion": str(motion.get("words", "")),
        "facts": {key: value for key, value in motion.items() if key != "words"},
    }


def _shrink(found: Diagnosis, words: DiagnosisWords) -> dict[str, Any] | None:
    shrink = found.shrink
    if shrink is None:
        return None
    unit = str(found.evidence.get("residual_unit", "m"))
    return {
        "words": words.shrink,
        "unit": unit,
        "rows": (
            (SENTENCES["twin_before"], shrink.before_m),
            (SENTENCES["twin_after"], shrink.after_m),
        ),
        "largest": max(shrink.before_m, shrink.after_m, 1e-12),
    }


def _parts(parts: Any) -> list[tuple[str, str, Any]]:
    """Results of several joints of one recording: name, sentence and everything."""
    if not isinstance(parts, Mapping):
        return []
    return [
        (str(name), str(part.get("sentence", "")) if isinstance(part, Mapping) else "", part)
        for name, part in cast("Mapping[Any, Any]", parts).items()
    ]


def _other_evidence(evidence: Mapping[str, Any]) -> dict[str, Any]:
    """Evidence that has no section of its own."""
    rest = {
        str(key): value
        for key, value in evidence.items()
        if key not in _SECTIONS and value is not None
    }
    if isinstance(rest.get("leftover_sd"), Mapping):
        levels = cast("Mapping[Any, Any]", rest["leftover_sd"])
        rest["leftover_sd"] = {channel_words(str(name)): level for name, level in levels.items()}
    return rest
