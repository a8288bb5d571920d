"""Evidence of a result as HTML: what was ruled out or refused, results of parts, and all else as it is."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any, Final, cast

from diagnosis.report.report_words import channel_words, effect_words

MAX_ITEMS_COUNT: Final = 60
MAX_DEPTH_COUNT: Final = 5
LONG_COUNT: Final = 1200
"""Characters of markup from which evidence is folded."""
LARGE: Final = 1e4
"""Log evidence is told apart by units: not in powers of ten."""
_TOLD: Final = {"ruled_out", "where", "parts", "unknown", "refused"}
"""Evidence with a section of its own."""


def section(title: str, content: str) -> str:
    """A titled section; `content` is markup."""
    return f"<section><h2>{escape(title)}</h2>{content}</section>"


def ruled_out_section(entries: Any) -> str:
    """Effects that the data speak against, and why; empty if there are none."""
    if not isinstance(entries, Sequence) or isinstance(entries, str) or not entries:
        return ""
    rows: list[str] = []
    for entry in cast("Sequence[Any]", entries):
        if not isinstance(entry, Mapping):
            rows.append(f"<tr><td>{escape(str(entry))}</td><td></td></tr>")
            continue
        facts = cast("Mapping[str, Any]", entry)
        name = effect_words(str(facts.get("effect", "")), _text(facts.get("joint")))
        odds = facts.get("log_odds")
        why = str(facts.get("why", ""))
        if isinstance(odds, int | float):
            why = f"natural log odds {odds:+.1f} against no effect. {why}".strip()
        rows.append(f"<tr><td>{escape(name)}</td><td>{escape(why)}</td></tr>")
    return section(
        "Ruled out",
        f"<details><summary>{len(rows)} effects that these data speak against</summary>"
        f"<table><tr><th>effect</th><th>why</th></tr>{''.join(rows)}</table></details>",
    )


def parts_section(parts: Any) -> str:
    """Results of several joints of one recording, each in short."""
    if not isinstance(parts, Mapping):
        return ""
    content: list[str] = []
    for name, part in cast("Mapping[Any, Any]", parts).items():
        sentence = part.get("sentence", "") if isinstance(part, Mapping) else ""
        content.append(
            f"<h3>{escape(str(name))}</h3><p>{escape(str(sentence))}</p>"
            f"<details><summary>All of it</summary>{facts_tree(part)}</details>"
        )
    return section("Parts", "".join(content))


def refused_section(entries: Any, is_open: bool) -> str:
    """Logs that were not used, and why; empty if there are none."""
    if not isinstance(entries, Sequence) or isinstance(entries, str) or not entries:
        return ""
    rows = "".join(
        f"<tr><td>{escape(str(entry.get('path', '')))}</td>"
        f"<td>{escape(str(entry.get('reason', '')))}</td></tr>"
        for entry in cast("Sequence[Any]", entries)
        if isinstance(entry, Mapping)
    )
    return section(
        "Refused data",
        f"<details{' open' if is_open else ''}><summary>{len(entries)} logs were not used</summary>"
        f"<table><tr><th>log</th><th>reason and remedy</th></tr>{rows}</table></details>",
    )


def evidence_section(evidence: Mapping[str, Any]) -> str:
    """All evidence that has no section of its own; empty if there is none."""
    rest = {key: value for key, value in evidence.items() if key not in _TOLD and value is not None}
    if isinstance(rest.get("leftover_sd"), Mapping):
        levels = cast("Mapping[Any, Any]", rest["leftover_sd"])
        rest["leftover_sd"] = {channel_words(str(name)): level for name, level in levels.items()}
    if not rest:
        return ""
    rows = "".join(
        f"<tr><th>{escape(str(key).replace('_', ' '))}</th><td>{_folded(facts_tree(value))}</td></tr>"
        for key, value in rest.items()
    )
    return section("Evidence", f'<div class="scroll"><table>{rows}</table></div>')


def _folded(content: str) -> str:
    """Closed at first when it is long."""
    if len(content) <= LONG_COUNT:
        return content
    return f"<details><summary>show</summary>{content}</details>"


def _text(value: Any) -> str | None:
    return None if value is None else str(value)


def facts_tree(value: Any, depth: int = 0) -> str:
    """Nested facts as markup, escaped; long lists are cut and say so."""
    if isinstance(value, Mapping | list | tuple) and not value:
        return "–"
    if isinstance(value, Mapping) and depth < MAX_DEPTH_COUNT:
        items = list(cast("Mapping[Any, Any]", value).items())
        shown = "".join(
            f"<dt>{escape(str(key).replace('_', ' '))}</dt><dd>{facts_tree(item, depth + 1)}</dd>"
            for key, item in items[:MAX_ITEMS_COUNT]
        )
        return f'<dl class="tree">{shown}</dl>{_cut(len(items))}'
    if isinstance(value, Sequence) and not isinstance(value, str) and depth < MAX_DEPTH_COUNT:
        entries = list(cast("Sequence[Any]", value))
        if any(isinstance(entry, Mapping) for entry in entries):
            shown = "".join(
                f"<li>{facts_tree(e, depth + 1)}</li>" for e in entries[:MAX_ITEMS_COUNT]
            )
            return f"<ol>{shown}</ol>{_cut(len(entries))}"
        listed = ", ".join(facts_tree(entry, depth + 1) for entry in entries[:MAX_ITEMS_COUNT])
        return f"{listed}{_cut(len(entries))}"
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "–"}[value]
    if not isinstance(value, float):
        return escape(str(value))
    return f"{value:.4g}" if abs(value) < LARGE else f"{value:.1f}"


def _cut(count: int) -> str:
    return "" if count <= MAX_ITEMS_COUNT else f" … and {count - MAX_ITEMS_COUNT} more"
