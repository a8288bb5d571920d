"""Reports of a training run: progress lines, metrics as CSV and JSON, learning curve."""

import csv
import json
import os
from dataclasses import asdict, dataclass, fields
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np

from training.environment.episode import EpisodeFailure

if TYPE_CHECKING:
    from training.measure import Accuracy
    from training.ppo import IterationMetrics

CSV_FILE = "metrics.csv"
CURVE_FILE = "learning_curve.png"
SUMMARY_FILE = "metrics.json"


@dataclass(frozen=True)
class ProgressRow:
    """Metrics of one iteration."""

    iteration_count: int
    environment_step_count: int
    wall_s: float
    """Wall time of the run so far, compilation and parts before a resume included."""
    reward_ratio: float
    """Mean reward of a control step."""
    episode_count: int
    landed_ratio: float
    """Share of the episodes that ended with a landing."""
    miss_mean_m: float
    """Mean miss of the landings, with exploration noise; NaN without landings."""
    miss_rms_m: float
    within_quarter_ratio: float
    """Share of the landings within 0.25 m of the target."""
    duration_s: float
    """Mean length of an episode."""
    numeric_ratio: float
    collision_ratio: float
    limit_ratio: float
    swing_ratio: float
    timeout_ratio: float
    learning_rate_ratio: float
    divergence_ratio: float
    entropy_ratio: float
    value_loss_ratio: float
    deviation_ratio: float
    """Mean standard deviation of the actions."""


def progress_rows(
    metrics: "IterationMetrics", first_iteration: int, steps_each: int, wall_s: tuple[float, float]
) -> list[ProgressRow]:
    """Rows of consecutive iterations; the wall time is interpolated between its two values."""
    host = {name: np.asarray(value) for name, value in metrics._asdict().items()}
    count = host["reward"].shape[0]
    times = np.linspace(wall_s[0], wall_s[1], count + 1)[1:]
    rows: list[ProgressRow] = []
    for i in range(count):
        done, landed = max(float(host["done"][i]), 1.0), float(host["landed"][i])
        landings = landed or float("nan")
        failure = host["failure"][i] / done
        rows.append(
            ProgressRow(
                iteration_count=first_iteration + i + 1,
                environment_step_count=(first_iteration + i + 1) * steps_each,
                wall_s=round(float(times[i]), 3),
                reward_ratio=float(host["reward"][i]) / steps_each,
                episode_count=int(host["done"][i]),
                landed_ratio=landed / done,
                miss_mean_m=float(host["miss"][i]) / landings,
                miss_rms_m=float(np.sqrt(host["miss_squared"][i] / landings)),
                within_quarter_ratio=float(host["within_quarter"][i]) / max(landed, 1.0),
                duration_s=float(host["duration"][i]) / done,
                numeric_ratio=float(failure[EpisodeFailure.NUMERIC]),
                collision_ratio=float(failure[EpisodeFailure.COLLISION]),
                limit_ratio=float(failure[EpisodeFailure.LIMIT]),
                swing_ratio=float(failure[EpisodeFailure.SWING]),
                timeout_ratio=float(failure[EpisodeFailure.TIMEOUT]),
                learning_rate_ratio=float(host["learning_rate"][i]),
                divergence_ratio=float(host["divergence"][i]),
                entropy_ratio=float(host["entropy"][i]),
                value_loss_ratio=float(host["value_loss"][i]),
                deviation_ratio=float(host["deviation"][i]),
            )
        )
    return rows


def progress_line(row: ProgressRow, total: int) -> str:
    """A row as a line of text."""
    rate = row.environment_step_count / max(row.wall_s, 1e-9) / 1e6
    miss = f"{row.miss_mean_m:.3f} m" if isfinite(row.miss_mean_m) else "-"
    return (
        f"iteration {row.iteration_count}/{total}  {row.wall_s:6.1f} s  {rate:5.2f} M steps/s  "
        f"landed {100.0 * row.landed_ratio:5.1f} %  miss {miss}  "
        f"within 0.25 m {100.0 * row.within_quarter_ratio:5.1f} %  reward {row.reward_ratio:+.3f}  "
        f"kl {row.divergence_ratio:.4f}  rate {row.learning_rate_ratio:.1e}  sd {row.deviation_ratio:.3f}"
    )


def append_rows(path: Path, rows: list[ProgressRow]) -> None:
    """Append to the CSV, with a header if it is new."""
    fresh = not path.is_file()
    with path.open("a", newline="", encoding="utf-8") as stream:
        _write(stream, rows, header=fresh)


def keep_rows(path: Path, iteration_count: int) -> list[ProgressRow]:
    """Remove the rows after an iteration from the CSV; return the others.

    A killed run may have written rows after its last checkpoint, or half a line; those iterations are run
    again. The file is replaced atomically.
    """
    if not path.is_file():
        return []
    kept = [row for row in read_rows(path) if row.iteration_count <= iteration_count]
    partial = path.with_suffix(".partial.csv")
    with partial.open("w", newline="", encoding="utf-8") as stream:
        _write(stream, kept, header=True)
    os.replace(partial, path)
    return kept


def _write(stream: TextIO, rows: list[ProgressRow], *, header: bool) -> None:
    writer = csv.DictWriter(stream, [field.name for field in fields(ProgressRow)])
    if header:
        writer.writeheader()
    writer.writerows(asdict(row) for row in rows)


def read_rows(path: Path) -> list[ProgressRow]:
    """Rows of the CSV; none without a file. An incomplete last line is ignored."""
    if not path.is_file():
        return []
    whole = {field.name for field in fields(ProgressRow) if field.type in (int, "int")}
    text = path.read_bytes().decode("utf-8")
    complete = text[: text.rfind("\n") + 1]
    rows: list[dict[str, Any]] = [
        {k: int(v) if k in whole else float(v) for k, v in row.items()}
        for row in csv.DictReader(complete.splitlines())
    ]
    return [ProgressRow(**row) for row in rows]


def write_summary(path: Path, rows: list[ProgressRow], accuracy: "list[Accuracy]") -> None:
    """Write the last row and the accuracy by distance as JSON; null for values that are not finite."""
    content = {
        "last": _finite(asdict(rows[-1])) if rows else None,
        "accuracy": [_finite(asdict(entry)) for entry in accuracy],
    }
    path.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def _finite(row: dict[str, Any]) -> dict[str, Any]:
    """The row with None in place of values that are not finite."""
    return {k: None if isinstance(v, float) and not isfinite(v) else v for k, v in row.items()}


def plot_curve(path: Path, rows: list[ProgressRow], title: str) -> None:
    """Plot miss and share of landings over the control steps."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 4.5), layout="constrained")
    FigureCanvasAgg(figure)
    left = figure.add_subplot()
    steps = [row.environment_step_count / 1e6 for row in rows]
    left.plot(steps, [row.miss_mean_m for row in rows], color="#1c7ed6", label="mean miss, m")
    left.plot(steps, [row.miss_rms_m for row in rows], color="#74c0fc", label="rms miss, m")
    left.set_yscale("log")
    left.set_xlabel("control steps, million")
    left.set_ylabel("miss of the landings (with exploration noise), m")
    right = left.twinx()
    right.plot(steps, [100.0 * r.landed_ratio for r in rows], color="#2f9e44", label="landed, %")
    right.set_ylim(0.0, 101.0)
    right.set_ylabel("episodes that end with a landing, %")
    lines = [*left.get_lines(), *right.get_lines()]
    left.legend(lines, [str(line.get_label()) for line in lines], loc="center right")
    left.set_title(title)
    left.grid(alpha=0.3)
    figure.savefig(path, dpi=120)
