"""A challenge of the diagnosis as a result file, from the answers of `downrange challenge run`.

    python -m scripts.challenge_result --sealed truth.json --seed N --files answers.json lag_rmse.json ...

The first file is the diagnosis; the others are baselines on the same sets.
"""

from dataclasses import dataclass
from math import isfinite
from pathlib import Path

import tyro

from benchmarks.result_file import Row, Value, describe, row, write_result
from challenge.run import answered
from challenge.score import match, read_sealed
from challenge.score_table import Measure, measures

WORDS = {
    "false alarms on null": ("false alarms on healthy sets", "%"),
    "stage named, all with an effect": ("stage named, all sets with an effect", "%"),
    "cause, single >= 2x": ("cause named, one effect from 2 limits on", "%"),
    "cause among the first 3, single >= 2x": ("cause among the first three, same sets", "%"),
    "cause, single < 2x": ("cause named, one effect below 2 limits", "%"),
    "exact set, pairs": ("pairs, both effects named", "%"),
    "F1 of effects, pairs": ("pairs, F1 of their effects", ""),
    "cause, cross-solver single": ("cause named, one effect, other integrator", "%"),
    "exact set, cross-solver pairs": ("pairs, other integrator", "%"),
    "unknown flagged": ("unmodelled effects flagged as unknown", "%"),
    "known called unknown": ("modelled effects called unknown", "%"),
    "AUROC of an effect": ("AUROC, an effect against none", ""),
    "AUROC of unknown": ("AUROC, unknown against known", ""),
    "probability on the truth": ("probability on the truth", ""),
    "log score": ("log score", "nat"),
    "calibration error (ECE)": ("calibration error", ""),
    "size error, median": ("size error, median", "ratio"),
    "size error of the first, same effects": (
        "size error of the diagnosis on the effects that the method names",
        "ratio",
    ),
    "90 % intervals that hold": ("90 % intervals that hold the truth", "%"),
    "removable gap closed, median": ("removable gap closed, median", "ratio"),
    "predicted against realised shrink, median": ("predicted against achieved shrink", "ratio"),
    "seconds a set, median": ("time for a set, median", "s"),
    "seconds a set, worst": ("time for a set, worst", "s"),
    "memory, MiB, worst": ("memory, worst", "MiB"),
}
"""Measures that the documents show: name in the score table, words and unit."""


@dataclass(frozen=True)
class Options:
    """What to convert."""

    sealed: Path
    """Sealed file of the challenge."""
    seed: int
    """Seed of `downrange challenge make`."""
    files: tuple[Path, ...]
    """Answers: the diagnosis first."""
    labels: tuple[str, ...] = ()
    """Names of the files' columns; their methods if left out."""
    out: Path | None = None
    """Result file; benchmarks/results/challenge_sets.json if left out."""


def rows_of(method: str, lines: list[Measure]) -> list[Row]:
    """Rows of one method, in the order of `WORDS`."""
    found = {line.name: line for line in lines}
    rows: list[Row] = []
    for name, (words, unit) in WORDS.items():
        line = found.get(name)
        if line is None or not isfinite(line.value):
            continue
        scale = 100.0 if unit == "%" else 1.0
        ends = [round(scale * end, 1) if line.is_share else None for end in (line.low, line.high)]
        value = Value(value=round(scale * line.value, 3), low=ends[0], high=ends[1])
        asked = line.bar.strip("<>= %").replace("-", " to ")
        rows.append(
            row(
                line.number,
                {"measure": words, "unit": unit, "asked": asked, "method": method},
                {"result": value},
            )
        )
    return rows


def main() -> None:
    """Score the answers and write the file."""
    options = tyro.cli(Options, description=__doc__)
    rows: list[Row] = []
    first = None
    for place, document in enumerate(answered(options.files)):
        sealed = read_sealed(options.sealed, str(document["sealed_sha256"]))
        scored = match(document, sealed)
        method = "diagnosis" if first is None else str(document["method"])
        method = options.labels[place] if options.labels else method
        rows += rows_of(method, measures(scored) if first is None else measures(scored, first))
        first = scored if first is None else first
    count = len(first) if first else 0
    title = f"Challenge of the diagnosis: {count} sets with hidden effects"
    print(write_result(describe("challenge_sets", title, rows, seed=options.seed), options.out))


if __name__ == "__main__":
    main()
