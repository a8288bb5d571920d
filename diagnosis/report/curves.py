"""Drawings of a diagnosis: intervals about zero, and series measured against the twin."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

from markupsafe import Markup

from diagnosis.report.vocabulary import SENTENCES, SERIES, plot_source
from reports.svg import Axes, Margins, drawing, element, round_ticks, text

Series = list[float]

MAX_POINTS_COUNT: Final = 1200
WIDTH: Final = 1000.0
MARGINS: Final = Margins(left=62.0, right=8.0, top=6.0, bottom=20.0)
STYLES: Final[Mapping[str, str]] = {
    "measured": "measured",
    "twin_before": "before",
    "twin_after": "after",
}
"""Role of a series -> class of its line."""
_ROLES: Final = {name: role for role, names in SERIES.items() for name in names}


class Curve(NamedTuple):
    """One line of a drawing."""

    css: str
    words: str
    y: Series


class Panel(NamedTuple):
    """One drawing and its caption; None where there are no finite values."""

    caption: str
    picture: Markup | None


class Figure(NamedTuple):
    """A plot of the diagnosis: series, their differences, and other channels."""

    title: str
    legend: tuple[Curve, ...]
    panels: tuple[Panel, ...]
    source: str = ""
    """Which throw it shows, and when that was."""


def interval_bar(value: float, ends: tuple[float, float], limit: float, words: str) -> Markup:
    """A value and its interval about zero, on a scale from `-limit` to `limit`."""
    half = 100.0

    def at(number: float) -> float:
        if not math.isfinite(number) or limit <= 0.0:
            return half
        return half + (half - 4.0) * max(-1.0, min(1.0, number / limit))

    lines = [
        element("line", class_="axis", x1=half, y1=1.0, x2=half, y2=17.0),
        element("line", class_="interval", x1=at(ends[0]), y1=9.0, x2=at(ends[1]), y2=9.0),
        element("line", class_="mark", x1=at(value), y1=3.0, x2=at(value), y2=15.0),
    ]
    return drawing(200.0, 18.0, words, lines)


def figure(name: str, plot: Any) -> Figure | None:
    """Draw one plot of the diagnosis; None if it holds no series.

    Args:
        name: of the plot.
        plot: ``{x, x_unit, unit, measured, ...}``; series of another length than x are left out.
    """
    if not isinstance(plot, Mapping):
        return None
    x = _numbers(plot.get("x"))
    series = {
        str(key): y
        for key, value in plot.items()
        if key != "x" and len(x) > 1 and len(y := _numbers(value)) == len(x)
    }
    curves = [
        Curve(STYLES[role], SENTENCES[role], y)
        for key, y in series.items()
        if (role := _ROLES.get(key)) is not None
    ]
    others = [
        Curve("other", key.replace("_", " "), y) for key, y in series.items() if key not in _ROLES
    ]
    if not curves and not others:
        return None
    unit, x_unit = str(plot.get("unit", "")), str(plot.get("x_unit", "s"))
    panels: list[Panel] = []
    if curves:
        panels.append(Panel("", _panel(x, curves, unit, x_unit, 210.0)))
        measured = next((c.y for c in curves if c.css == "measured"), None)
        differences = [
            Curve(c.css, c.words, [m - v for m, v in zip(measured, c.y, strict=True)])
            for c in curves
            if measured is not None and c.css != "measured"
        ]
        if differences:
            picture = _panel(x, differences, unit, x_unit, 120.0, is_about_zero=True)
            panels.append(Panel(SENTENCES["measured_minus_twin"].capitalize(), picture))
    panels += [Panel(other.words, _panel(x, [other], "", x_unit, 90.0)) for other in others]
    source = plot_source(plot.get("throw_id"), plot.get("thrown_utc"))
    return Figure(name.replace("_", " "), tuple(curves), tuple(panels), source)


def _numbers(value: Any) -> Series:
    """A list of numbers; an entry that is no number becomes NaN, a value that is no list becomes empty."""
    if not isinstance(value, Sequence) or isinstance(value, str):
        return []
    return [
        float(v) if isinstance(v, int | float) and not isinstance(v, bool) else math.nan
        for v in value
    ]


def _panel(
    x: Series,
    curves: Sequence[Curve],
    unit: str,
    x_unit: str,
    height: float,
    is_about_zero: bool = False,
) -> Markup | None:
    """Axes with round ticks and the lines; `is_about_zero` includes zero in the range."""
    xs = [v for v in x if math.isfinite(v)]
    ys = [v for curve in curves for v in curve.y if math.isfinite(v)]
    if not xs or not ys:
        return None
    ys += [0.0] if is_about_zero else []
    axes = Axes(_span(min(xs), max(xs)), _span(min(ys), max(ys)), WIDTH, height, MARGINS)
    parts = [
        axes.y_tick(tick, "axis" if tick == 0.0 else "grid")
        for tick in round_ticks(*axes.y, 4 if height > 150.0 else 3)
    ]
    parts += [axes.x_tick(tick) for tick in round_ticks(*axes.x, 8)]
    parts.append(text(x_unit, WIDTH - MARGINS.right, height - 5.0, "end"))
    parts.append(text(unit, 4.0, MARGINS.top + 10.0))
    parts += [axes.path(c.css, points) for c in curves for points in _pieces(x, c.y)]
    return drawing(WIDTH, height, f"{', '.join(c.words for c in curves)} over {x_unit}", parts)


def _pieces(x: Series, y: Series) -> list[list[tuple[float, float]]]:
    """Points of a line, thinned, in pieces between missing values."""
    step = max(1, math.ceil(len(x) / MAX_POINTS_COUNT))
    pieces: list[list[tuple[float, float]]] = [[]]
    for a, b in zip(x[::step], y[::step], strict=True):
        if math.isfinite(a) and math.isfinite(b):
            pieces[-1].append((a, b))
        elif pieces[-1]:
            pieces.append([])
    return [piece for piece in pieces if len(piece) > 1]


def _span(low: float, high: float) -> tuple[float, float]:
    """The range of the data, widened if it is empty."""
    if high - low > 1e-9 * max(abs(low), abs(high), 1e-9):
        return low, high
    half = max(abs(low) * 0.05, 1e-6)
    return low - half, high + half
