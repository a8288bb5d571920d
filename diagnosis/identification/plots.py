"""Plots of an identification: drive responses, histogram of release delays, measured and predicted swing."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from diagnosis.identification.drive_record import drive_record
from diagnosis.identification.quantity import AxisSwing, Quantity
from diagnosis.identification.release_delay import (
    PAPER_COUNT,
    PAPER_MEAN_S,
    PAPER_SD_S,
    ReleaseDelay,
)
from diagnosis.identification.response import JointResponse
from diagnosis.identification.response_estimation import simulate
from diagnosis.loading.throw_data import ThrowData
from machine.conventions import CONTROL_PERIOD_S, Array, IntArray
from machine.spec import MachineSpec

SHOWN_TICKS = 1500
BUSY_TICKS = 200
"""Length of the motion that a plotted stretch is centred on, ticks."""


def _figure(rows: int, columns: int, title: str, size: tuple[float, float]) -> tuple[Figure, Any]:
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=11)
    return figure, np.ravel(figure.subplots(rows, columns))


def response_figure(
    throws: Sequence[ThrowData], spec: MachineSpec, joints: Sequence[JointResponse], title: str
) -> Figure:
    """Measured and modelled speed of each joint, 15 s of what was used: where it moves most, each way."""
    figure, axes = _figure(2, 2, title, (12.0, 7.0))
    for number, (axis, joint) in enumerate(zip(axes, joints, strict=True)):
        axis.set_title(joint.joint, fontsize=10)
        axis.set_xlabel("time, the stretches with the most motion / s")
        axis.set_ylabel("speed / " + ("m/s" if number == 3 else "rad/s"))
        if joint.best is None:
            axis.text(0.5, 0.5, "cannot be known\nfrom these logs", ha="center", va="center")
            continue
        record = drive_record(throws, spec, number)
        b = joint.best
        lag = 2.0 * b["damping_ratio"] / b["natural_frequency_rad_per_s"]
        x = np.array([[b["dead_time_s"], lag, b["damping_ratio"], b["gain_ratio"]]] * 2)
        model = simulate(record, x)
        begin = 0
        for shown in _busiest(record.steady):
            t = (begin + np.arange(shown.size)) * CONTROL_PERIOD_S
            axis.plot(t, record.steady[shown], color="0.7", linewidth=0.8)
            axis.plot(t, record.measured[shown], color="k", linewidth=0.8)
            axis.plot(t, model[shown], color="tab:blue", linewidth=1.0)
            begin += shown.size
        # Every stretch has the same three lines.
        axis.legend(axis.get_lines()[:3], ("commanded", "measured", "model"), fontsize=8)
    return figure


def _busiest(speed: Array) -> list[IntArray]:
    """Indices of the stretches about the most motion in each direction, in their order."""
    if speed.size <= SHOWN_TICKS:
        return [np.arange(speed.size)]
    width = SHOWN_TICKS // 2
    starts: list[int] = []
    for side in (1.0, -1.0):
        energy = np.concatenate([[0.0], np.cumsum(np.maximum(side * speed, 0.0) ** 2)])
        busiest = int(np.argmax(energy[BUSY_TICKS:] - energy[:-BUSY_TICKS])) + BUSY_TICKS // 2
        starts.append(min(max(busiest - width // 2, 0), speed.size - width))
    return [np.arange(start, start + width) for start in sorted(set(starts))]


def release_figure(found: ReleaseDelay, title: str) -> Figure:
    """Histogram of the openings beside the paper's normal distribution."""
    figure, axes = _figure(1, 1, title, (7.5, 4.6))
    axis = axes[0]
    delays_ms = 1e3 * np.asarray(found.delays_s)
    axis.hist(delays_ms, bins="auto", color="tab:blue", alpha=0.55, density=True)
    ends = (min(delays_ms.min(), 210.0), max(delays_ms.max(), 305.0))
    t = np.linspace(*ends, 200)
    for mean, sd, colour, words in (
        (PAPER_MEAN_S, PAPER_SD_S, "k", f"paper, {PAPER_COUNT} releases"),
        (found.mean.value, found.sd.value, "tab:blue", f"here, {delays_ms.size} releases"),
    ):
        if mean is None or sd is None:
            continue
        m, s = 1e3 * mean, 1e3 * sd
        density = np.exp(-0.5 * ((t - m) / s) ** 2) / (s * np.sqrt(2.0 * np.pi))
        axis.plot(t, density, color=colour, label=f"{words}: {m:.0f} ± {s:.0f} ms")
    axis.set_xlabel("command to free flight / ms")
    axis.set_ylabel("density / 1/ms")
    axis.legend(fontsize=9)
    return figure


def swing_figure(axes_found: Sequence[AxisSwing], title: str) -> Figure:
    """Measured against predicted angle of the longest swing of each axis (the paper's figure)."""
    figure, axes = _figure(2, 1, title, (9.0, 6.4))
    for axis, found in zip(axes, axes_found, strict=True):
        axis.set_ylabel(f"{found.joint} / rad")
        axis.grid(alpha=0.3)
        if not found.plot:
            axis.text(0.5, 0.5, "cannot be known from these logs", ha="center", va="center")
            continue
        t = found.plot["t_s"]
        axis.plot(t, found.plot["measured_rad"], color="k", label="measured, gyro")
        axis.plot(t, found.plot["predicted_rad"], "--", color="tab:blue", label="predicted")
        axis.set_title(
            f"viscous {_short(found.viscous_friction_per_s)}, dry "
            f"{_short(found.coulomb_friction_rad_per_s2)}, length {_short(found.length_m)}",
            fontsize=9,
        )
        axis.legend(fontsize=8, loc="upper right")
    axes[-1].set_xlabel("time / s")
    return figure


def _short(known: Quantity) -> str:
    return "?" if known.value is None else f"{known.value:.3g} {known.unit}"
