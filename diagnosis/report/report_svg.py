"""Drawings of the report as inline SVG: intervals about zero, and curves measured against twin."""

import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any, Final, NamedTuple

Series = list[float]

MAX_POINTS_COUNT: Final = 1200
ROLES: Final[Mapping[str, tuple[str, str]]] = {
    "measured": ("measured", "measured"),
    "ideal": ("before", "twin before"),
    "twin": ("before", "twin before"),
    "before": ("before", "twin before"),
    "twin_before": ("before", "twin before"),
    "explained": ("after", "twin after"),
    "after": ("after", "twin after"),
    "twin_after": ("after", "twin after"),
}
"""Name of a series -> its line and its words."""


class Curve(NamedTuple):
    """One line of a drawing."""

    role: str
    words: str
    y: Series


def interval_bar(value: float, ends: tuple[float, float], limit: float, words: str) -> str:
    """A value and its interval about zero, on the scale +-`limit`."""
    half = 100.0

    def at(number: float) -> float:
        if not math.isfinite(number) or limit <= 0.0:
            return half
        return half + (half - 4.0) * max(-1.0, min(1.0, number / limit))

    return (
        f'<svg viewBox="0 0 200 18" role="img" aria-label="{escape(words)}">'
        f"<title>{escape(words)}</title>"
        f'<line class="axis" x1="{half:g}" y1="1" x2="{half:g}" y2="17"/>'
        f'<line class="interval" x1="{at(ends[0]):.1f}" y1="9" x2="{at(ends[1]):.1f}" y2="9"/>'
        f'<line class="mark" x1="{at(value):.1f}" y1="3" x2="{at(value):.1f}" y2="15"/></svg>'
    )


def figure(name: str, plot: Any) -> str:
    """A plot of the diagnosis: the curves, what twin and measurement differ by, and other channels.

    Args:
        name: of the plot.
        plot: ``{x, x_unit, unit, measured, ...}``; series of another length than x are left out.
    """
    if not isinstance(plot, Mapping):
        return ""
    x = _numbers(plot.get("x"))
    series = {
        str(key): y
        for key, value in plot.items()
        if key != "x" and len(x) > 1 and len(y := _numbers(value)) == len(x)
    }
    curves = [Curve(*ROLES[key], y) for key, y in series.items() if key in ROLES]
    others = [
        Curve("other", key.replace("_", " "), y) for key, y in series.items() if key not in ROLES
    ]
    if not curves and not others:
        return ""
    unit, x_unit = str(plot.get("unit", "")), str(plot.get("x_unit", "s"))
    parts = [f"<h3>{escape(name.replace('_', ' '))}</h3>", _legend(curves)]
    if curves:
        parts.append(_panel(x, curves, unit, x_unit, 210.0))
        measured = next((c.y for c in curves if c.role == "measured"), None)
        left = [
            Curve(c.role, c.words, [m - v for m, v in zip(measured, c.y, strict=True)])
            for c in curves
            if measured is not None and c.role != "measured"
        ]
        if left:
            parts.append('<p class="dim">Measured minus twin</p>')
            parts.append(_panel(x, left, unit, x_unit, 120.0, is_about_zero=True))
    for other in others:
        parts.append(f'<p class="dim">{escape(other.words)}</p>')
        parts.append(_panel(x, [other], "", x_unit, 90.0))
    return f"<figure style='margin:0'>{''.join(parts)}</figure>"


def _numbers(value: Any) -> Series:
    """A list of numbers; what is no number becomes NaN, what is no list becomes empty."""
    if not isinstance(value, Sequence) or isinstance(value, str):
        return []
    return [
        float(v) if isinstance(v, int | float) and not isinstance(v, bool) else math.nan
        for v in value
    ]


def _legend(curves: Sequence[Curve]) -> str:
    items = "".join(
        f'<span><svg viewBox="0 0 26 8"><polyline class="{c.role}" points="0,4 26,4"/></svg>'
        f"{escape(c.words)}</span>"
        for c in curves
    )
    return f'<p class="legend">{items}</p>'


def _panel(
    x: Series,
    curves: Sequence[Curve],
    unit: str,
    x_unit: str,
    height: float,
    is_about_zero: bool = False,
) -> str:
    """Axes with round ticks and the lines; `is_about_zero` keeps the line of zero in the picture."""
    left, right, top, bottom, width = 62.0, 8.0, 6.0, 20.0, 1000.0
    xs = [v for v in x if math.isfinite(v)]
    ys = [v for curve in curves for v in curve.y if math.isfinite(v)]
    if not xs or not ys:
        return '<p class="dim">No finite values.</p>'
    x_low, x_high = _span(min(xs), max(xs))
    ys += [0.0] if is_about_zero else []
    y_low, y_high = _span(min(ys), max(ys))
    across = (width - left - right) / (x_high - x_low)
    up = (height - top - bottom) / (y_high - y_low)

    def place(a: float, b: float) -> tuple[float, float]:
        return left + (a - x_low) * across, top + (y_high - b) * up

    parts = [
        f'<svg viewBox="0 0 {width:g} {height:g}" role="img" aria-label="'
        f'{escape(", ".join(c.words for c in curves))} over {escape(x_unit)}">'
    ]
    for tick in round_ticks(y_low, y_high, 4 if height > 150.0 else 3):
        y = place(x_low, tick)[1]
        kind = "axis" if tick == 0.0 else "grid"
        parts.append(
            f'<line class="{kind}" x1="{left:g}" y1="{y:.1f}" x2="{width - right:g}" y2="{y:.1f}"/>'
            f'<text x="{left - 6:g}" y="{y + 4:.1f}" text-anchor="end">{label(tick)}</text>'
        )
    for tick in round_ticks(x_low, x_high, 8):
        a = place(tick, y_low)[0]
        parts.append(
            f'<line class="grid" x1="{a:.1f}" y1="{top:g}" x2="{a:.1f}" y2="{height - bottom:g}"/>'
            f'<text x="{a:.1f}" y="{height - 5:g}" text-anchor="middle">{label(tick)}</text>'
        )
    parts.append(
        f'<text x="{width - right:g}" y="{height - 5:g}" text-anchor="end">{escape(x_unit)}</text>'
        f'<text x="4" y="{top + 10:g}">{escape(unit)}</text>'
    )
    for curve in curves:
        for points in _pieces(x, curve.y):
            drawn = " ".join("{:.1f},{:.1f}".format(*place(a, b)) for a, b in points)
            parts.append(f'<polyline class="{curve.role}" points="{drawn}"/>')
    return "".join(parts) + "</svg>"


def _pieces(x: Series, y: Series) -> list[list[tuple[float, float]]]:
    """Points of a line, thinned, in pieces between values that are missing."""
    step = max(1, math.ceil(len(x) / MAX_POINTS_COUNT))
    pieces: list[list[tuple[float, float]]] = [[]]
    for a, b in zip(x[::step], y[::step], strict=True):
        if math.isfinite(a) and math.isfinite(b):
            pieces[-1].append((a, b))
        elif pieces[-1]:
            pieces.append([])
    return [piece for piece in pieces if len(piece) > 1]


def _span(low: float, high: float) -> tuple[float, float]:
    if high - low > 1e-9 * max(abs(low), abs(high), 1e-9):
        return low, high
    half = max(abs(low) * 0.05, 1e-6)
    return low - half, high + half


def round_ticks(low: float, high: float, count: int) -> list[float]:
    """Round numbers within a range: `count` of them or a few more."""
    raw = 0.6 * (high - low) / max(count, 1)
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power >= raw)
    first = math.ceil(low / step - 1e-9)
    last = math.floor(high / step + 1e-9)
    return [index * step for index in range(first, last + 1)]


def label(value: float) -> str:
    """A tick's number with a true minus sign."""
    return f"{value:.4g}".replace("-", "−")
