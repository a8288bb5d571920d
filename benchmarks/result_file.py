"""Result files of measurements: `benchmarks/results/<name>.json`, the source of the tables in docs.

A file holds the command that makes it again, seed, commit, date, kind of host, and rows of values with
intervals where there are any.
"""

import os
import platform
import subprocess
import sys
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from sim_twin.confidence_intervals import proportion_interval

ROOT = Path(__file__).parents[1]
RESULTS = Path(__file__).parent / "results"


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Value(_Strict):
    """A measured value with its interval."""

    value: float | None
    """None: unknown."""
    low: float | None = None
    high: float | None = None


class Row(_Strict):
    """One line of a table."""

    labels: dict[str, str]
    """What was measured: the same keys in every row, in the order of the table's columns."""
    n: int = Field(ge=0)
    """Repetitions, throws or samples behind the values."""
    values: dict[str, Value]
    """By name with the unit in it, in the order of the table's columns."""


class Result(_Strict):
    """Content of a result file."""

    name: str
    """File name without ``.json``."""
    title: str
    command: str
    """Command line that makes the file again."""
    seed: int | None
    """None: the measurement has no random numbers, or several seeds, which are labels."""
    commit: str
    """Short hash; ``+`` where the working tree had changes."""
    date: str
    """Day of the measurement, UTC, YYYY-MM-DD."""
    host: str
    """Cores, processor and accelerator."""
    interval: str = "95 %"
    """Kind of the intervals `low` to `high`."""
    rows: list[Row]
    notes: str = ""


def read_result(path: Path) -> Result:
    """Read and check a result file."""
    return Result.model_validate_json(path.read_text(encoding="utf-8"))


def write_result(result: Result, path: Path | None = None) -> Path:
    """Write a result to its place, or to `path`; return where."""
    path = path or RESULTS / f"{result.name}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(result.model_dump_json(indent=1) + "\n", encoding="utf-8")
    return path


def describe(
    name: str,
    title: str,
    rows: Sequence[Row],
    *,
    seed: int | None,
    notes: str = "",
    accelerator: str = "no GPU",
) -> Result:
    """A result of the running program: its command line, commit, date and host are filled in."""
    script = Path(sys.argv[0]).resolve()
    inside = script.is_relative_to(ROOT)
    shown = ".".join(script.relative_to(ROOT).with_suffix("").parts) if inside else script.stem
    return Result(
        name=name,
        title=title,
        command=" ".join(["python -m", shown, *sys.argv[1:]]),
        seed=seed,
        commit=current_commit(),
        date=datetime.now(UTC).date().isoformat(),
        host=f"{len(os.sched_getaffinity(0))} cores {_processor()}, {accelerator}",
        rows=list(rows),
        notes=notes,
    )


def row(n: int, labels: Mapping[str, object], values: Mapping[str, float | Value | None]) -> Row:
    """A row; plain numbers are values without an interval, NaN is unknown."""
    return Row(
        labels={key: str(label) for key, label in labels.items()},
        n=n,
        values={
            key: value if isinstance(value, Value) else plain(value)
            for key, value in values.items()
        },
    )


def plain(value: float | None) -> Value:
    """A value without an interval; None where it is not finite."""
    return Value(value=None if value is None or not np.isfinite(value) else float(value))


def ratio(hits: int, count: int) -> Value:
    """A ratio with its 95 % interval by Wilson's score; unknown of nothing."""
    if count == 0:
        return Value(value=None)
    low, high = proportion_interval(hits, count, 0.95)
    return Value(value=hits / count, low=low, high=high)


def percentile(samples: Sequence[float] | np.ndarray, percent: float) -> Value:
    """A percentile with its 95 % interval from order statistics (binomial ranks, normal approximation)."""
    ordered = np.sort(np.asarray(samples, dtype=float))
    if ordered.size == 0:
        return Value(value=None)
    share, count = percent / 100.0, ordered.size
    half = 1.96 * np.sqrt(count * share * (1.0 - share))
    low, high = (
        int(np.clip(round(rank), 0, count - 1))
        for rank in (count * share - half, count * share + half)
    )
    return Value(
        value=float(np.percentile(ordered, percent)),
        low=float(ordered[low]),
        high=float(ordered[high]),
    )


def current_commit() -> str:
    """Short hash of the working tree's commit, with ``+`` where it has changes; ``unknown`` without git."""
    command = ["git", "describe", "--always", "--dirty=+", "--abbrev=7", "--match="]
    try:
        run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return run.stdout.strip()


def _processor() -> str:
    """Model of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
