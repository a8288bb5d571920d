"""Drawings of an evaluation as inline SVG in the report's colours: range plot, landings, sensitivity."""

import math
from collections.abc import Sequence
from html import escape

import numpy as np

from diagnosis.evaluation.conditions import ConditionRow
from diagnosis.evaluation.goals import Goal
from diagnosis.evaluation.measures import TargetRow
from diagnosis.evaluation.paper import PaperScatter
from diagnosis.evaluation.sensitivity import FactorShift
from diagnosis.report.report_svg import label, round_ticks
from machine.conventions import Array
from sim_twin.throws.plots import ellipse_points

SIZE = 460.0
MARGIN = 52.0
MAX_POINTS = 400
"""Landings drawn at a target: more only blacken the picture."""


class _Axes:
    """Equal or unequal scales on a square drawing; y up."""

    def __init__(
        self, x: tuple[float, float], y: tuple[float, float], height: float = SIZE
    ) -> None:
        self._x, self._y, self.height = x, y, height

    def at(self, x: float, y: float) -> tuple[float, float]:
        inner = SIZE - MARGIN - 12.0
        tall = self.height - MARGIN - 12.0
        return (
            MARGIN + inner * (x - self._x[0]) / (self._x[1] - self._x[0]),
            12.0 + tall * (self._y[1] - y) / (self._y[1] - self._y[0]),
        )

    def line(self, css: str, a: tuple[float, float], b: tuple[float, float]) -> str:
        (x1, y1), (x2, y2) = self.at(*a), self.at(*b)
        return f'<line class="{css}" x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"/>'

    def path(self, css: str, points: Array) -> str:
        drawn = " ".join("{:.1f},{:.1f}".format(*self.at(float(a), float(b))) for a, b in points)
        return f'<polyline class="{css}" points="{drawn}"/>'

    def dots(self, css: str, points: Array, radius: float) -> str:
        parts = [
            '<circle class="{}" cx="{:.1f}" cy="{:.1f}" r="{:g}"/>'.format(
                css, *self.at(float(a), float(b)), radius
            )
            for a, b in points
        ]
        return "".join(parts)

    def frame(self, x_words: str, y_words: str) -> str:
        parts: list[str] = []
        for tick in round_ticks(min(self._x), max(self._x), 6):
            parts.append(self.line("grid", (tick, self._y[0]), (tick, self._y[1])))
            x, y = self.at(tick, self._y[0])
            parts.append(
                f'<text x="{x:.1f}" y="{y + 15:.1f}" text-anchor="middle">{label(tick)}</text>'
            )
        for tick in round_ticks(*self._y, 6):
            parts.append(self.line("grid", (self._x[0], tick), (self._x[1], tick)))
            x, y = self.at(self._x[0], tick)
            parts.append(
                f'<text x="{x - 6:.1f}" y="{y + 4:.1f}" text-anchor="end">{label(tick)}</text>'
            )
        middle = 0.5 * (self.height - MARGIN)
        parts.append(
            f'<text x="{0.5 * (SIZE + MARGIN):.0f}" y="{self.height - 6:.0f}" text-anchor="middle">'
            f"{escape(x_words)}</text>"
            f'<text transform="translate(13 {middle:.0f}) rotate(-90)" text-anchor="middle">'
            f"{escape(y_words)}</text>"
        )
        return "".join(parts)


def _svg(axes: _Axes, content: Sequence[str], words: str) -> str:
    return (
        f'<svg viewBox="0 0 {SIZE:g} {axes.height:g}" role="img" aria-label="{escape(words)}">'
        f"<title>{escape(words)}</title>{''.join(content)}</svg>"
    )


def range_plot(targets: Sequence[TargetRow], reach_m: float, words: str) -> str:
    """The paper's range plot: mean impact and 1 sigma, downrange and crossrange, about each target.

    Axes are target range and impact range; the thick bars are one standard deviation downrange, the short
    ones across are one standard deviation crossrange, on the same scale.
    """
    ranges = [t.range_m for t in targets]
    ends = (min(*ranges, reach_m) - 0.5, max(ranges) + 0.5)
    axes = _Axes(ends, ends)
    parts = [axes.frame("target range / m", "impact range / m")]
    parts.append(axes.line("other", (ends[0], ends[0]), (ends[1], ends[1])))
    parts.append(axes.line("axis", (reach_m, ends[0]), (reach_m, ends[1])))
    x, y = axes.at(reach_m, ends[1])
    parts.append(f'<text x="{x + 4:.1f}" y="{y + 12:.1f}">static reach</text>')
    for target in targets:
        mean, sd = target.mean_downrange_error_m.value, target.sd_downrange_m.value
        if mean is None:
            continue
        at = target.range_m + mean
        if sd is not None:
            parts.append(
                axes.line("interval", (target.range_m, at - sd), (target.range_m, at + sd))
            )
        across = target.sd_crossrange_m.value
        if across is not None:
            parts.append(
                axes.line("mark", (target.range_m - across, at), (target.range_m + across, at))
            )
        parts.append(axes.dots("dot", np.array([[target.range_m, at]]), 3.0))
    return _svg(axes, parts, words)


def spread_plot(targets: Sequence[TargetRow], goals: Sequence[Goal], words: str) -> str:
    """Standard deviations over the target range with their intervals, and the most that is asked."""
    ranges = [t.range_m for t in targets]
    ends = (min(ranges) - 0.5, max(ranges) + 0.5)
    intervals = [
        end
        for t in targets
        for estimate in (t.sd_downrange_m, t.sd_crossrange_m)
        for end in estimate.ci95 or ()
    ]
    top = 1.08 * max([*intervals, *(goal.sd_m for goal in goals)])
    axes = _Axes(ends, (0.0, top), 0.7 * SIZE)
    parts = [axes.frame("target range / m", "standard deviation / m")]
    left = ends[0]
    steps: list[tuple[float, float]] = []
    for goal in goals:
        steps += [(left, goal.sd_m), (goal.range_max_m, goal.sd_m)]
        left = goal.range_max_m
    parts.append(axes.path("other", np.array(steps)))
    for name, css, shift_m in (
        ("sd_downrange_m", "dot", 0.0),
        ("sd_crossrange_m", "dot hollow", 0.07),
    ):
        for target in targets:
            estimate = getattr(target, name)
            if estimate.value is None:
                continue
            at = target.range_m + shift_m
            low, high = estimate.ci95 or (estimate.value, estimate.value)
            parts.append(axes.line("interval thin", (at, low), (at, high)))
            parts.append(axes.dots(css, np.array([[at, estimate.value]]), 3.5))
    return _svg(axes, parts, words)


def landing_plot(target: TargetRow, paper: PaperScatter | None, words: str) -> str:
    """Landings about the target with the 1 sigma ellipse, and the paper's ellipse (dashed, axes parallel)."""
    points = np.column_stack([target.crossrange_error_m, target.downrange_error_m]).reshape(-1, 2)
    drawn: list[Array] = [points]
    outline = ellipse_points(points[:, 0], points[:, 1]) if len(points) > 1 else None
    theirs = None
    if paper is not None:
        angle = np.linspace(0.0, 2.0 * math.pi, 90)
        theirs = np.column_stack(
            [
                paper.mean_crossrange_m + paper.sd_crossrange_m * np.cos(angle),
                paper.mean_range_m - target.range_m + paper.sd_downrange_m * np.sin(angle),
            ]
        )
        drawn.append(theirs)
    half = 1.1 * max(float(np.abs(np.concatenate(drawn)).max(initial=0.2)), 0.2)
    # Crossrange is positive to the left, seen from the machine.
    axes = _Axes((half, -half), (-half, half))
    parts = [axes.frame("crossrange error / m, left positive", "downrange error / m")]
    parts.append(axes.dots("landing", points[:MAX_POINTS], 2.2))
    if theirs is not None:
        parts.append(axes.path("before", theirs))
    if outline is not None:
        parts.append(axes.path("after thick", outline))
    parts.append(axes.dots("dot target", np.zeros((1, 2)), 4.0))
    return _svg(axes, parts, words)


def front_plot(rows: Sequence[ConditionRow], words: str, *, by_speed: bool) -> str:
    """Standard deviation downrange over the time to the release or its speed, a line a range.

    The careful end of each line is marked.
    """
    name = "release_speed_m_per_s" if by_speed else "start_to_release_s"
    known = [r for r in rows if r.sd_downrange_m is not None and getattr(r, name) is not None]
    points = np.array([(getattr(r, name), r.sd_downrange_m) for r in known]).reshape(-1, 2)
    if not known:
        return _svg(_Axes((0.0, 1.0), (0.0, 1.0)), [], words)
    axes = _Axes(
        (float(points[:, 0].min()) - 0.4, float(points[:, 0].max()) + 0.4),
        (0.0, 1.15 * float(points[:, 1].max())),
    )
    x_words = "release speed / m/s" if by_speed else "start to release / s"
    parts = [axes.frame(x_words, "sd downrange / m")]
    for range_m in sorted({r.range_m for r in known}):
        line = points[[r.range_m == range_m for r in known]]
        parts.append(axes.path("after thick", line))
        parts.append(axes.dots("dot", line, 3.0))
        parts.append(axes.dots("dot target", line[:1], 4.0))
        x, y = axes.at(*line[0].tolist())
        # On the side to which no line goes: fast throws are released sooner, at more speed.
        shift, anchor = (-8.0, "end") if by_speed else (8.0, "start")
        parts.append(
            f'<text x="{x + shift:.1f}" y="{y + 4:.1f}" text-anchor="{anchor}">{range_m:g} m</text>'
        )
    return _svg(axes, parts, words)


def sensitivity_plot(shifts: Sequence[FactorShift], words: str) -> str:
    """Mean downrange shift of each factor, low and high, with 95 % intervals."""
    ends = [v for s in shifts for e in (s.low_ci95_m, s.high_ci95_m) if e is not None for v in e]
    half = 1.15 * max((abs(v) for v in ends), default=0.1)
    height = 60.0 + 46.0 * len(shifts)
    axes = _Axes((-half, half), (0.0, float(len(shifts))), height)
    parts: list[str] = []
    for tick in round_ticks(-half, half, 6):
        parts.append(axes.line("grid", (tick, 0.0), (tick, float(len(shifts)))))
        x, y = axes.at(tick, 0.0)
        parts.append(
            f'<text x="{x:.1f}" y="{y + 15:.1f}" text-anchor="middle">{label(tick)}</text>'
        )
    parts.append(axes.line("axis", (0.0, 0.0), (0.0, float(len(shifts)))))
    for row, shift in enumerate(shifts):
        level = len(shifts) - row - 0.62
        x, y = axes.at(-half, level + 0.42)
        parts.append(
            f'<text x="{x + 4:.1f}" y="{y + 4:.1f}">{escape(shift.name)} {escape(shift.change)}</text>'
        )
        for css, value, interval, offset in (
            ("before", shift.low_m, shift.low_ci95_m, 0.08),
            ("after", shift.high_m, shift.high_ci95_m, -0.12),
        ):
            if value is None or interval is None:
                continue
            at = level + offset
            parts.append(axes.line(f"{css} thick", (interval[0], at), (interval[1], at)))
            parts.append(axes.dots(f"dot {css}", np.array([[value, at]]), 3.5))
    parts.append(
        f'<text x="{0.5 * (SIZE + MARGIN):.0f}" y="{height - 6:.0f}" text-anchor="middle">'
        "shift of the mean downrange error / m</text>"
    )
    return _svg(axes, parts, words)
