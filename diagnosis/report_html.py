"""The result as one HTML page that needs nothing else: verdict, causes, stages, curves, the JSON itself."""

from collections.abc import Sequence
from html import escape
from typing import Any, Final

from diagnosis.verdict import Diagnosis

_COLOURS: Final = {"measured": "#111", "ideal": "#c60", "explained": "#06c"}
_STYLE: Final = (
    "body{font:15px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#111}"
    "table{border-collapse:collapse}td,th{padding:.2rem .8rem .2rem 0;text-align:left;vertical-align:top}"
    "th{font-weight:600}svg{width:100%;height:auto}pre{overflow:auto;font-size:12px}"
)


def report_page(found: Diagnosis, title: str) -> str:
    """The page.

    Args:
        found: the result.
        title: what was diagnosed.
    """
    causes = [
        (f"{cause.probability:.2f}", cause.name, "; ".join(_numbers(e) for e in cause.effects))
        for cause in found.causes
    ]
    parts = [
        f"<h1>{escape(title)}: {escape(found.verdict.value)}</h1><p>{escape(found.sentence)}</p>",
        _table(("probability", "cause", "size with 90 % interval"), causes),
    ]
    if found.ambiguity is not None:
        motion = str(found.ambiguity.separating_motion.get("words", ""))
        parts.append(
            f"<h2>To decide</h2><p>{escape(found.ambiguity.why)}</p><p>{escape(motion)}</p>"
        )
    parts += [_curves(name, plot) for name, plot in found.plots.items()]
    text = found.model_dump_json(indent=1, exclude={"plots"})
    parts.append(
        f"<details><summary>All of the result</summary><pre>{escape(text)}</pre></details>"
    )
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{escape(title)}</title>'
        f"<style>{_STYLE}</style><body>{''.join(parts)}</body></html>\n"
    )


def _numbers(effect: Any) -> str:
    values = ", ".join(
        f"{name} {p.value:.3g} {p.unit} ({p.ci90[0]:.3g} to {p.ci90[1]:.3g})"
        for name, p in effect.parameters.items()
    )
    joint = f" {effect.joint}" if effect.joint else ""
    return f"{effect.effect}{joint}: {values}"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    top = "".join(f"<th>{escape(cell)}</th>" for cell in head)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return f"<table><tr>{top}</tr>{body}</table>"


def _curves(name: str, plot: Any) -> str:
    """One plot as SVG: measured, ideal and explained over x."""
    x = [float(value) for value in plot.get("x", [])]
    lines = {key: [float(v) for v in plot[key]] for key in _COLOURS if key in plot}
    if len(x) < 2 or not lines:
        return ""
    low = min(min(values) for values in lines.values())
    high = max(max(values) for values in lines.values())
    width, height = 900.0, 260.0
    across, up = width / max(x[-1] - x[0], 1e-12), height / max(high - low, 1e-12)
    drawn = "".join(
        f'<polyline fill="none" stroke="{_COLOURS[key]}" stroke-width="1.4" points="'
        + " ".join(
            f"{(a - x[0]) * across:.1f},{(high - b) * up:.1f}" for a, b in zip(x, y, strict=True)
        )
        + '"/>'
        for key, y in lines.items()
    )
    legend = ", ".join(f'<span style="color:{_COLOURS[key]}">{key}</span>' for key in lines)
    unit, x_unit = escape(str(plot.get("unit", ""))), escape(str(plot.get("x_unit", "")))
    return (
        f"<h2>{escape(name)}</h2>"
        f"<p>{legend}; {low:.3g} to {high:.3g} {unit} over {x[-1] - x[0]:.3g} {x_unit}</p>"
        f'<svg viewBox="0 0 {width:g} {height:g}">{drawn}</svg>'
    )
