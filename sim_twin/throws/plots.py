"""Accuracy plots in files: the paper's range plot, and landings with 1 sigma ellipses.

Every plot names the number of throws and the seed.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from machine.conventions import Array
from machine.errors import UsageError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ELLIPSE_POINT_COUNT = 120
SUFFIXES = (".png", ".svg", ".pdf")


class TargetScatter(NamedTuple):
    """Landings at one target range."""

    range_m: float
    downrange_error_m: Array
    """(landed,)"""
    crossrange_error_m: Array
    """(landed,)"""
    throw_count: int


def ellipse_points(x: Array, y: Array, sigma_ratio: float = 1.0) -> Array:
    """Outline (120, 2) of the ellipse of `sigma_ratio` standard deviations about the mean of points.

    Raises:
        ValueError: fewer than two points.
    """
    if x.size < 2:
        raise ValueError(f"an ellipse needs two landings, there are {x.size}")
    covariance = np.cov(np.stack([x, y]))
    size, axes = np.linalg.eigh(covariance)
    angle = np.linspace(0.0, 2.0 * np.pi, ELLIPSE_POINT_COUNT)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    outline: Array = sigma_ratio * circle * np.sqrt(np.maximum(size, 0.0)) @ axes.T
    return outline + np.array([x.mean(), y.mean()])


def check_plot_path(path: Path) -> None:
    """Check that a plot can be written to a file.

    Raises:
        UsageError: the suffix is not png, svg or pdf, or the folder does not exist.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise UsageError(
            f"cannot write a plot to {path}: the name must end with {', '.join(SUFFIXES)}"
        )
    if not path.parent.is_dir():
        raise UsageError(f"cannot write the plot {path}: the folder {path.parent} does not exist")


def plot_accuracy(
    path: Path, targets: Sequence[TargetScatter], *, title: str, reach_m: float
) -> None:
    """Write the accuracy plot of a campaign.

    Left: mean impact range and its 1 sigma over the target's range, with the line of a perfect throw and
    the arm's static reach. Right: landings of all targets about their target, frame `throw`, equal axes.

    Args:
        path: file; its suffix selects png, svg or pdf.
        targets: landings per target.
        title: first line of the figure; names plant, policy and seed.
        reach_m: static reach of the arm.

    Raises:
        UsageError: the suffix is none of these, or the folder cannot be written.
    """
    check_plot_path(path)
    figure = accuracy_figure(targets, title=title, reach_m=reach_m)
    try:
        figure.savefig(path, dpi=150)
    except OSError as error:
        raise UsageError(f"cannot write the plot {path}: {error.strerror}") from error


def accuracy_figure(targets: Sequence[TargetScatter], *, title: str, reach_m: float) -> "Figure":
    """The figure that `plot_accuracy` writes."""
    # Imported here: callers that do not plot need no matplotlib.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 5.4), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    thrown = sum(t.throw_count for t in targets)
    landed = sum(t.downrange_error_m.size for t in targets)
    figure.suptitle(f"{title}\n{landed} of {thrown} throws landed", fontsize=11)
    _range_axes(left, targets, reach_m)
    _scatter_axes(right, targets)
    return figure


def _range_axes(axes: Any, targets: Sequence[TargetScatter], reach_m: float) -> None:
    ranges = np.array([t.range_m for t in targets])
    margin = 0.35
    ends = np.array([ranges.min() - margin, ranges.max() + margin])
    axes.plot(ends, ends, color="0.6", linewidth=1.0, label="target")
    axes.axvline(
        reach_m, color="0.6", linestyle=":", linewidth=1.0, label=f"static reach {reach_m:g} m"
    )
    for target in targets:
        if target.downrange_error_m.size == 0:
            continue
        impact = target.range_m + target.downrange_error_m
        spread = float(impact.std(ddof=1)) if impact.size > 1 else 0.0
        axes.errorbar(
            target.range_m, float(impact.mean()), yerr=spread, fmt="o", color="tab:blue", capsize=4
        )
        axes.annotate(
            f"n={impact.size}\nσ={spread:.2f}",
            (target.range_m, float(impact.mean()) - spread),
            textcoords="offset points",
            xytext=(0, -24),
            ha="center",
            fontsize=7,
        )
    axes.set_xlabel("target range / m")
    axes.set_ylabel("impact range / m (mean and 1 σ)")
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(alpha=0.3)
    axes.legend(loc="upper left", fontsize=8)


def _scatter_axes(axes: Any, targets: Sequence[TargetScatter]) -> None:
    for number, target in enumerate(targets):
        colour = f"C{number % 10}"
        down, cross = target.downrange_error_m, target.crossrange_error_m
        if down.size == 0:
            continue
        axes.plot(cross, down, "x", color=colour, markersize=4, alpha=0.55)
        label = f"{target.range_m:g} m, n={down.size}"
        if down.size > 1:
            outline = ellipse_points(cross, down)
            axes.plot(outline[:, 0], outline[:, 1], color=colour, linewidth=1.8, label=label)
    axes.plot(0.0, 0.0, "o", color="red", markersize=5, label="target")
    axes.invert_xaxis()  # crossrange is positive to the left, seen from the machine
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("crossrange error / m (left positive)")
    axes.set_ylabel("downrange error / m")
    axes.grid(alpha=0.3)
    axes.legend(loc="best", fontsize=8)
