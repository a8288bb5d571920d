"""Inline SVG in the style of the reports: elements, axes with round ticks, lines and dots."""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from markupsafe import Markup, escape

Point = tuple[float, float]


def element(name: str, content: str | None = None, /, **attributes: str | float) -> Markup:
    """One element; attributes and plain text are escaped.

    Args:
        name: of the element.
        content: text or markup; None for an empty element.
        attributes: ``class_`` stands for ``class`` and ``text_anchor`` for ``text-anchor``; coordinates are
            rounded to a tenth of a unit.
    """
    listed = Markup("").join(
        Markup(' {}="{}"').format(
            key.rstrip("_").replace("_", "-"),
            f"{value:.1f}".removesuffix(".0") if isinstance(value, int | float) else value,
        )
        for key, value in attributes.items()
    )
    if content is None:
        return Markup("<{}{}/>").format(name, listed)
    return Markup("<{}{}>{}</{}>").format(name, listed, content, name)


def drawing(width: float, height: float, words: str, content: Iterable[Markup]) -> Markup:
    """The whole drawing; `words` describes it for a screen reader."""
    body = element("title", words) + Markup("").join(content)
    label = {"role": "img", "aria_label": words}
    return element("svg", body, viewBox=f"0 0 {width:g} {height:g}", **label)


class Margins(NamedTuple):
    """Space about the plotting area."""

    left: float
    right: float
    top: float
    bottom: float


class Axes:
    """Linear axes on a drawing; y points up."""

    def __init__(self, x: Point, y: Point, width: float, height: float, margins: Margins) -> None:
        """Axes from `x[0]` to `x[1]` and from `y[0]` to `y[1]`."""
        self.x, self.y, self.width, self.height, self.margins = x, y, width, height, margins

    def at(self, x: float, y: float) -> Point:
        """Place of a point on the drawing."""
        m = self.margins
        across = self.width - m.left - m.right
        up = self.height - m.top - m.bottom
        return (
            m.left + across * (x - self.x[0]) / (self.x[1] - self.x[0]),
            m.top + up * (self.y[1] - y) / (self.y[1] - self.y[0]),
        )

    def line(self, css: str, a: Point, b: Point) -> Markup:
        """A straight line."""
        (x1, y1), (x2, y2) = self.at(*a), self.at(*b)
        return element("line", class_=css, x1=x1, y1=y1, x2=x2, y2=y2)

    def path(self, css: str, points: Iterable[Sequence[float]]) -> Markup:
        """A polyline."""
        drawn = " ".join("{:.1f},{:.1f}".format(*self.at(float(a), float(b))) for a, b in points)
        return element("polyline", class_=css, points=drawn)

    def dots(self, css: str, points: Iterable[Sequence[float]], radius: float) -> Markup:
        """A circle at each point."""
        places = [self.at(float(a), float(b)) for a, b in points]
        return Markup("").join(
            element("circle", class_=css, cx=x, cy=y, r=radius) for x, y in places
        )

    def x_tick(self, value: float, drop: float = 15.0) -> Markup:
        """Grid line and number at a value of x."""
        x, y = self.at(value, self.y[0])
        number = element("text", tick_label(value), x=x, y=y + drop, text_anchor="middle")
        return self.line("grid", (value, self.y[0]), (value, self.y[1])) + number

    def y_tick(self, value: float, css: str = "grid") -> Markup:
        """Grid line and number at a value of y."""
        x, y = self.at(self.x[0], value)
        number = element("text", tick_label(value), x=x - 6.0, y=y + 4.0, text_anchor="end")
        return self.line(css, (self.x[0], value), (self.x[1], value)) + number


def text(words: str, x: float, y: float, anchor: str = "start") -> Markup:
    """Text at a place on the drawing."""
    return element("text", escape(words), x=x, y=y, text_anchor=anchor)


def round_ticks(low: float, high: float, count: int) -> list[float]:
    """Round numbers within a range, about `count` of them."""
    raw = 0.6 * (high - low) / max(count, 1)
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power >= raw)
    first = math.ceil(low / step - 1e-9)
    last = math.floor(high / step + 1e-9)
    return [index * step for index in range(first, last + 1)]


def tick_label(value: float) -> str:
    """A tick's number with a true minus sign."""
    return f"{value:.4g}".replace("-", "−")
