"""Accuracy of the policies as result files, from the report of `downrange evaluate --report DIR`.

    downrange evaluate --mode both --plant virtual --report report --throws 200
    python -m scripts.policy_results report/report.json

Writes policy_accuracy.json, policy_pace.json and policy_heights.json.
"""

import json
from dataclasses import dataclass
from math import sqrt
from pathlib import Path
from typing import Any

import tyro
from scipy.stats import chi2

from benchmarks.result_file import RESULTS, Row, Value, describe, row, write_result

ACCURACY = ("mean_downrange", "sd_downrange", "mean_crossrange", "sd_crossrange")


@dataclass(frozen=True)
class Options:
    """What to convert."""

    report: tyro.conf.Positional[Path]
    """report.json of an evaluation on the virtual machine."""
    out: Path = RESULTS
    """Folder of the result files."""


def estimate(found: dict[str, Any]) -> Value:
    """A number of the report with its 95 % interval."""
    low, high = found["ci95"] or (None, None)
    return Value(value=found["value"], low=low, high=high)


def deviation(value: float | None, count: int) -> Value:
    """A standard deviation with its 95 % interval (chi-square)."""
    if value is None or count < 2:
        return Value(value=value)
    low, high = (value * sqrt((count - 1) / chi2.ppf(share, count - 1)) for share in (0.975, 0.025))
    return Value(value=value, low=float(low), high=float(high))


def accuracy_rows(mode: dict[str, Any]) -> list[Row]:
    """One row a target."""
    rows: list[Row] = []
    for found in mode["targets"]:
        keys = [f"{n}_error_m" if n.startswith("mean") else f"{n}_m" for n in ACCURACY]
        values = {f"{n}_m": estimate(found[key]) for n, key in zip(ACCURACY, keys, strict=True)}
        labels = {"policy": mode["policy"], "target_m": f"{found['range_m']:g}"}
        rows.append(row(found["throws"], labels, values))
    return rows


def condition_rows(mode: dict[str, Any], kind: str, label: str, key: str) -> list[Row]:
    """One row a condition: paces or heights."""
    rows: list[Row] = []
    for found in mode[kind]:
        landed = found["landed_count"]
        values: dict[str, Value | float | None] = {
            "sd_downrange_m": deviation(found["sd_downrange_m"], landed),
            "sd_crossrange_m": deviation(found["sd_crossrange_m"], landed),
            "release_after_s": found["start_to_release_s"],
            "release_speed_m_per_s": found["release_speed_m_per_s"],
        }
        labels = {
            "policy": mode["policy"],
            "target_m": f"{found['range_m']:g}",
            label: f"{found[key]:g}",
        }
        rows.append(row(found["throw_count"], labels, values))
    return rows


def main() -> None:
    """Read the report and write the files."""
    options = tyro.cli(Options, description=__doc__)
    modes: list[dict[str, Any]] = json.loads(options.report.read_text(encoding="utf-8"))["modes"]
    seed = int(modes[0]["seed"])
    where = "virtual machine, unit 0, registered"
    tables = {
        "policy_accuracy": (
            f"Accuracy of the policies, {where}, pace 0",
            [r for mode in modes for r in accuracy_rows(mode)],
        ),
        "policy_pace": (
            f"Spread and cycle time over the pace, {where}",
            [r for mode in modes for r in condition_rows(mode, "paces", "pace", "pace_ratio")],
        ),
        "policy_heights": (
            f"Spread over the height of the target, {where}, pace 0",
            [r for mode in modes for r in condition_rows(mode, "heights", "height_m", "height_m")],
        ),
    }
    command = "downrange evaluate --mode both --plant virtual --report DIR --throws 200"
    for name, (title, rows) in tables.items():
        result = describe(name, title, rows, seed=seed).model_copy(
            update={"command": f"{command} --seed {seed}"}
        )
        print(write_result(result, options.out / f"{name}.json"))


if __name__ == "__main__":
    main()
