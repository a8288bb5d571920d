"""Drawings of the accuracy report: range plot, standard deviations, landings, pace, sensitivity."""

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from evaluation.conditions import ConditionRow
from evaluation.measures import TargetRow
from evaluation.paper import PaperScatter
from evaluation.requirements import Requirement
from evaluation.sensitivity import FactorShift
from reports.svg import Axes, Margins, Point, drawing, round_ticks, text
from sim_twin.throws.plots import ellipse_points

SIZE = 460.0
MARGINS = Margins(left=52.0, right=12.0, top=12.0, bottom=52.0)
MAX_POINTS = 400
"""Landings drawn at a target; more of them cover each other."""


def _axes(x: Point, y: Point, height: float = SIZE) -> Axes:
    return Axes(x, y, SIZE, height, MARGINS)


def _x_words(axes: Axes, words: str) -> Markup:
    middle = 0.5 * (SIZE + MARGINS.left)
    return text(words, round(middle), round(axes.height - 6.0), "middle")


def _frame(axes: Axes, x_words: str, y_words: str) -> Markup:
    """Grid, numbers and the words of both axes."""
    middle = 0.5 * (axes.height - MARGINS.bottom)
    y_label = Markup(
        '<text transform="translate(13 {:.0f}) rotate(-90)" text-anchor="middle">{}</text>'
    ).format(middle, y_words)
    ticks = [axes.x_tick(tick) for tick in round_ticks(min(axes.x), max(axes.x), 6)]
    ticks += [axes.y_tick(tick) for tick in round_ticks(*axes.y, 6)]
    return Markup("").join([*ticks, _x_words(axes, x_words), y_label])


def _draw(axes: Axes, words: str, parts: Sequence[Markup]) -> Markup:
    return drawing(SIZE, axes.height, words, parts)


def range_plot(targets: Sequence[TargetRow], reach_m: float, words: str) -> Markup:
    """The paper's range plot: mean impact and one standard deviation about each target.

    Axes are target range and impact range. Thick bars are one standard deviation downrange, short bars across
    are one standard deviation crossrange on the same scale.
    """
    ranges = [t.range_m for t in targets]
    ends = (min(*ranges, reach_m) - 0.5, max(ranges) + 0.5)
    axes = _axes(ends, ends)
    parts = [_frame(axes, "target range / m", "impact range / m")]
    parts.append(axes.line("other", (ends[0], ends[0]), (ends[1], ends[1])))
    parts.append(axes.line("axis", (reach_m, ends[0]), (reach_m, ends[1])))
    x, y = axes.at(reach_m, ends[1])
    parts.append(text("static reach", x + 4.0, y + 12.0))
    for target in targets:
        mean, sd = target.mean_downrange_error_m.value, target.sd_downrange_m.value
        if mean is None:
            continue
        at = target.range_m + mean
        if sd is not None:
            ends_down = (target.range_m, at - sd), (target.range_m, at + sd)
            parts.append(axes.line("interval", *ends_down))
        across = target.sd_crossrange_m.value
        if across is not None:
            ends_across = (target.range_m - across, at), (target.range_m + across, at)
            parts.append(axes.line("mark", *ends_across))
        parts.append(axes.dots("dot", [(target.range_m, at)], 3.0))
    return _draw(axes, words, parts)


def spread_plot(
    targets: Sequence[TargetRow], requirements: Sequence[Requirement], words: str
) -> Markup:
    """Standard deviations over the target range with their intervals, and the required ones."""
    ranges = [t.range_m for t in targets]
    ends = (min(ranges) - 0.5, max(ranges) + 0.5)
    intervals = [
        end
        for t in targets
        for estimate in (t.sd_downrange_m, t.sd_crossrange_m)
        for end in estimate.ci95 or ()
    ]
    top = 1.08 * max([*intervals, *(required.sd_m for required in requirements)])
    axes = _axes(ends, (0.0, top), 0.7 * SIZE)
    parts = [_frame(axes, "target range / m", "standard deviation / m")]
    left = ends[0]
    steps: list[Point] = []
    for required in requirements:
        steps += [(left, required.sd_m), (required.range_max_m, required.sd_m)]
        left = required.range_max_m
    parts.append(axes.path("other", steps))
    for name, css, shift_m in (
        ("sd_downrange_m", "dot", 0.0),
        ("sd_crossrange_m", "dot hollow", 0.07),
    ):
        for target in targets:
            estimate = getattr(target, name)
            if estimate.value is None:
                continue
            x = target.range_m + shift_m
            low, high = estimate.ci95 or (estimate.value, estimate.value)
            parts.append(axes.line("interval thin", (x, low), (x, high)))
            parts.append(axes.dots(css, [(x, estimate.value)], 3.5))
    return _draw(axes, words, parts)


def landing_plot(target: TargetRow, paper: PaperScatter | None, words: str) -> Markup:
    """Landings about the target with the ellipse of one standard deviation.

    The paper's ellipse is dashed; its axes are taken parallel to the frame because it states no covariance.
    """
    points = np.column_stack([target.crossrange_error_m, target.downrange_error_m]).reshape(-1, 2)
    drawn = [points]
    outline = ellipse_points(points[:, 0], points[:, 1]) if len(points) > 1 else None
    reported = None
    if paper is not None:
        angle = np.linspace(0.0, 2.0 * np.pi, 90)
        reported = np.column_stack(
            [
                paper.mean_crossrange_m + paper.sd_crossrange_m * np.cos(angle),
                paper.mean_range_m - target.range_m + paper.sd_downrange_m * np.sin(angle),
            ]
        )
        drawn.append(reported)
    half = 1.1 * max(float(np.abs(np.concatenate(drawn)).max(initial=0.2)), 0.2)
    # Crossrange is positive to the left, seen from the machine.
    axes = _axes((half, -half), (-half, half))
    parts = [_frame(axes, "crossrange error / m, left positive", "downrange error / m")]
    parts.append(axes.dots("landing", points[:MAX_POINTS], 2.2))
    if reported is not None:
        parts.append(axes.path("before", reported))
    if outline is not None:
        parts.append(axes.path("after thick", outline))
    parts.append(axes.dots("dot target", [(0.0, 0.0)], 4.0))
    return _draw(axes, words, parts)


def pace_plot(rows: Sequence[ConditionRow], words: str, *, by_speed: bool) -> Markup:
    """Downrange standard deviation over time to release or release speed, one line per range.

    The careful end of each line is marked.
    """
    name = "release_speed_m_per_s" if by_speed else "start_to_release_s"
    known = [r for r in rows if r.sd_downrange_m is not None and getattr(r, name) is not None]
    points = np.array([(getattr(r, name), r.sd_downrange_m) for r in known]).reshape(-1, 2)
    if not known:
        return _draw(_axes((0.0, 1.0), (0.0, 1.0)), words, [])
    axes = _axes(
        (float(points[:, 0].min()) - 0.4, float(points[:, 0].max()) + 0.4),
        (0.0, 1.15 * float(points[:, 1].max())),
    )
    x_words = "release speed / m/s" if by_speed else "start to release / s"
    parts = [_frame(axes, x_words, "sd downrange / m")]
    for range_m in sorted({r.range_m for r in known}):
        line = points[[r.range_m == range_m for r in known]]
        parts.append(axes.path("after thick", line))
        parts.append(axes.dots("dot", line, 3.0))
        parts.append(axes.dots("dot target", line[:1], 4.0))
        x, y = axes.at(*line[0].tolist())
        # On the side without a line: fast throws are released sooner and at more speed.
        shift, anchor = (-8.0, "end") if by_speed else (8.0, "start")
        parts.append(text(f"{range_m:g} m", x + shift, y + 4.0, anchor))
    return _draw(axes, words, parts)


def sensitivity_plot(shifts: Sequence[FactorShift], words: str) -> Markup:
    """Shift of the mean downrange error for each factor, low and high, with 95 % intervals."""
    ends = [v for s in shifts for e in (s.low_ci95_m, s.high_ci95_m) if e is not None for v in e]
    half = 1.15 * max((abs(v) for v in ends), default=0.1)
    count = len(shifts)
    axes = _axes((-half, half), (0.0, float(count)), 60.0 + 46.0 * count)
    parts = [axes.x_tick(tick) for tick in round_ticks(-half, half, 6)]
    parts.append(axes.line("axis", (0.0, 0.0), (0.0, float(count))))
    for row, shift in enumerate(shifts):
        level = count - row - 0.62
        x, y = axes.at(-half, level + 0.42)
        parts.append(text(f"{shift.name} {shift.change}", x + 4.0, y + 4.0))
        for css, value, interval, offset in (
            ("before", shift.low_m, shift.low_ci95_m, 0.08),
            ("after", shift.high_m, shift.high_ci95_m, -0.12),
        ):
            if value is None or interval is None:
                continue
            at = level + offset
            parts.append(axes.line(f"{css} thick", (interval[0], at), (interval[1], at)))
            parts.append(axes.dots(f"dot {css}", [(value, at)], 3.5))
    parts.append(_x_words(axes, "shift of the mean downrange error / m"))
    return _draw(axes, words, parts)
