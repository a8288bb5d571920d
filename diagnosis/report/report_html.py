"""The result as one HTML page that needs nothing else: no script, no network, light and dark.

Everything that comes from data (file names, notes, channel names) is escaped; the page's own policy forbids
scripts and requests in case that was not enough.
"""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any, Final, cast

from diagnosis.report.evidence_html import (
    evidence_section,
    facts_tree,
    parts_section,
    refused_section,
    ruled_out_section,
    section,
)
from diagnosis.report.report_svg import figure, interval_bar
from diagnosis.report.report_words import (
    HEALTHY_OUT,
    STAGE_WORDS,
    VERDICT_WORDS,
    cause_words,
    compared_words,
    crossrange,
    downrange,
    fitted_words,
    metres,
    percent,
    probability,
    size_words,
    unknown_facts,
)
from diagnosis.verdict import Cause, Diagnosis, Stage, StageGap, VerdictKind
from reports.html import TEMPLATES

OPEN_FIGURES_COUNT: Final = 6
_STYLE: Final = TEMPLATES / "report.css"
_POLICY: Final = (
    "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'"
)
_LOOK: Final = {VerdictKind.AMBIGUOUS, VerdictKind.UNKNOWN, VerdictKind.BAD_DATA}


def report_html(found: Diagnosis, title: str = "Gap") -> str:
    """The page.

    Args:
        found: the result, of throws or of one stage.
        title: what was diagnosed.
    """
    body = "".join(
        (
            _verdict(found, title),
            _chain(found),
            _causes(found.causes),
            _next(found),
            _unknown(found.evidence.get("unknown")),
            _shrink(found),
            _plots(found.plots),
            ruled_out_section(found.evidence.get("ruled_out")),
            parts_section(found.evidence.get("parts")),
            refused_section(
                found.evidence.get("refused"), is_open=found.verdict is VerdictKind.BAD_DATA
            ),
            evidence_section(found.evidence),
        )
    )
    return page(f"{title}: {VERDICT_WORDS[found.verdict]}", body)


def page(title: str, body: str, more_style: str = "") -> str:
    """A whole page of sections, in the report's style and under its policy; `body` is markup."""
    style = _STYLE.read_text(encoding="utf-8") + more_style
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
        f"<title>{escape(title)}</title><style>{style}</style></head>"
        f"<body><main>{body}</main></body></html>\n"
    )


def _verdict(found: Diagnosis, title: str) -> str:
    gap = found.gap
    facts: list[tuple[str, str]] = []
    if gap.impact_rms_m is not None:
        facts.append(("Twin misses by (root mean square)", metres(gap.impact_rms_m)))
    if gap.downrange_bias_m is not None:
        facts.append(("Along, measured minus twin", downrange(gap.downrange_bias_m)))
    if gap.crossrange_bias_m is not None:
        facts.append(("Across", crossrange(gap.crossrange_bias_m)))
    if gap.trajectory_rms_ratio is not None:
        facts.append(("Residual over a healthy machine's", f"{gap.trajectory_rms_ratio:.2f}"))
    used = found.evidence.get("throws_used")
    if isinstance(used, Sequence) and not isinstance(used, str):
        facts.append(("Throws used", str(len(cast("Sequence[object]", used)))))
    twin = found.evidence.get("twin")
    if isinstance(twin, Mapping):
        facts.append(("Twin", f"{twin['machine_id']}, version {twin['version_count']}"))
    compared = compared_words(found.evidence)
    if compared is not None:
        facts.append(("Compared with", compared))
    listed = "".join(f"<div><dt>{escape(a)}</dt><dd>{escape(b)}</dd></div>" for a, b in facts)
    look = "true" if found.verdict in _LOOK else "false"
    return (
        f"<h1>{escape(title)}</h1><section>"
        f'<span class="kind" data-look="{look}">{escape(VERDICT_WORDS[found.verdict])}</span>'
        f'<p class="sentence">{escape(found.sentence)}</p><dl class="facts">{listed}</dl></section>'
    )


def _chain(found: Diagnosis) -> str:
    """All stages as a flow; a stage that was not looked at says so."""
    if not found.stages:
        return ""
    where = found.evidence.get("where")
    # Without a gap the place is only the largest term: nothing to point at.
    is_pointed = isinstance(where, Mapping) and found.verdict is not VerdictKind.NONE
    here = str(where.get("stage")) if isinstance(where, Mapping) and is_pointed else ""
    named = found.evidence.get("named", ())
    is_metric = any(value != 0.0 for s in found.stages for value in (*s.ci90_m, s.miss_m.downrange))
    limit = max(
        (abs(v) for s in found.stages for v in (*s.ci90_m, s.miss_m.downrange) if v == v),
        default=0.0,
    )
    cards: list[str] = []
    for stage, (name, link) in STAGE_WORDS.items():
        terms = [s for s in found.stages if s.stage is stage]
        joints = [place["joint"] for place in named if place["stage"] == stage]
        is_marked = stage == here or (not here and not is_metric and bool(terms))
        content = (
            _terms(terms, limit, joints)
            if is_metric and terms
            else _without_metres(stage, terms, is_metric)
        )
        is_marked = is_marked or any(place["stage"] == stage for place in named)
        cards.append(
            f'<li data-here="{str(is_marked).lower()}"><h3>{escape(name)}</h3>'
            f'<p class="dim">{escape(link)}</p>{content}</li>'
        )
    note = (
        "Metres of miss that each stage adds, along the target line and across it; the bar is the 90 % "
        "interval along it, of the mean over the throws. The terms sum to measured minus twin. Shares "
        "compare root mean squares over the throws: a term may be large and its mean small."
        if is_metric
        else "One stage was recorded alone: its share is all of the gap, in the recorded channel."
    )
    return section(
        "Where", f'<p class="dim">{escape(note)}</p><ol class="chain">{"".join(cards)}</ol>'
    )


def _terms(terms: Sequence[StageGap], limit: float, named: Sequence[str]) -> str:
    parts: list[str] = []
    if len(terms) > 1:
        along = sum(term.miss_m.downrange for term in terms)
        across = sum(term.miss_m.crossrange for term in terms)
        parts.append(
            f'<p class="big">{escape(downrange(along))}<br>{escape(crossrange(across))}</p>'
        )
    for term in terms:
        joint = escape(term.joint or "") + (" (cause)" if term.joint in named else "")
        along, across = downrange(term.miss_m.downrange), crossrange(term.miss_m.crossrange)
        ends = f"90 % interval {metres(term.ci90_m[0])} to {metres(term.ci90_m[1])}"
        head = (
            f'<p class="big">{escape(along)}<br>{escape(across)}</p>'
            if len(terms) == 1
            else f"<p><strong>{joint}</strong> {escape(along)}, {escape(across)}</p>"
        )
        parts.append(
            f'<div class="term">{head}'
            f"{interval_bar(term.miss_m.downrange, term.ci90_m, limit, f'{along}, {ends}')}"
            f'<p class="dim">{escape(ends)} along; {percent(term.share_ratio)} of all terms</p></div>'
        )
    return "".join(parts)


def _without_metres(stage: Stage, terms: Sequence[StageGap], is_metric: bool) -> str:
    if not terms:
        return f'<p class="dim">{"no term" if is_metric else "not recorded"}</p>'
    joints = ", ".join(term.joint for term in terms if term.joint is not None)
    return f'<p class="big">{"this stage" if not joints else escape(joints)}</p>'


def _causes(causes: Sequence[Cause]) -> str:
    if not causes:
        return ""
    rows = [
        f'<tr><td class="odds"><span class="share"><i style="width:{100.0 * cause.probability:.1f}%">'
        f"</i></span>{escape(probability(cause.probability))}</td><td>{escape(cause_words(cause))}</td>"
        f"<td>{_sizes(cause)}</td></tr>"
        for cause in causes
    ]
    return section(
        "Which",
        '<div class="scroll"><table><tr><th>probability</th><th>cause</th><th>size, 90 % interval</th></tr>'
        f"{''.join(rows)}</table></div>",
    )


def _sizes(cause: Cause) -> str:
    lines = [
        f"{escape(fitted_words(effect)) + ': ' if len(cause.effects) > 1 else ''}"
        f'{escape(name)} <strong>{escape(value)}</strong> <span class="dim">({escape(ends)})</span>'
        for effect in cause.effects
        for name, value, ends in size_words(effect)
    ]
    return "<br>".join(lines)


def _next(found: Diagnosis) -> str:
    if found.ambiguity is None:
        return ""
    motion = found.ambiguity.separating_motion
    words = str(motion.get("words", ""))
    rest = {key: value for key, value in motion.items() if key != "words"}
    members = " or ".join(found.ambiguity.members)
    return section(
        "Next experiment",
        f"<p>Undecided: {escape(members)}; {escape(found.ambiguity.why)}.</p>"
        f"<p><strong>{escape(words)}</strong></p>{facts_tree(rest)}",
    )


def _unknown(signature: Any) -> str:
    if not isinstance(signature, Mapping):
        return ""
    return section(
        "What is left unexplained", facts_tree(unknown_facts(cast("Mapping[str, Any]", signature)))
    )


def _shrink(found: Diagnosis) -> str:
    shrink = found.shrink
    if shrink is None:
        return ""
    unit = str(found.evidence.get("residual_unit", "m"))
    largest = max(shrink.before_m, shrink.after_m, 1e-12)
    rows = "".join(
        f'<tr><td>{name}</td><td class="number">{value:.3g} {escape(unit)}</td><td style="width:60%">'
        f'<span class="share" style="width:100%"><i style="width:{100.0 * value / largest:.1f}%">'
        "</i></span></td></tr>"
        for name, value in (("twin before", shrink.before_m), ("twin after", shrink.after_m))
    )
    what = "throws" if unit == "m" and found.gap.impact_rms_m is not None else "pieces"
    is_by_channels = found.evidence.get("shrink_measure") == "channels"
    gap = "gap in the channels that it moves" if is_by_channels else "removable gap"
    words = (
        f"Adding the cause removes {percent(shrink.ratio)} of the {gap} on "
        f"{shrink.held_out_throws} held-out {what}, 90 % interval {percent(shrink.ci90[0])} to "
        f"{percent(shrink.ci90[1])}."
    )
    if shrink.predicted_ratio is not None:
        words += f" Predicted before it was added: {percent(shrink.predicted_ratio)}."
    words += (
        " The miss itself is no measure here; below, for comparison."
        if is_by_channels
        else f" {percent(shrink.removable_ratio)} of the gap is removable; the rest is noise and jitter."
    )
    if what == "throws":
        words += f" {HEALTHY_OUT}"
    return section("How far it shrinks", f"<p>{escape(words)}</p><table>{rows}</table>")


def _plots(plots: Mapping[str, Any]) -> str:
    drawn = [text for name, plot in plots.items() if (text := figure(str(name), plot))]
    if not drawn:
        return ""
    rest = drawn[OPEN_FIGURES_COUNT:]
    folded = (
        f"<details><summary>{len(rest)} more</summary>{''.join(rest)}</details>" if rest else ""
    )
    return section("Measured against twin", "".join(drawn[:OPEN_FIGURES_COUNT]) + folded)
