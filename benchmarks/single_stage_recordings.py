"""Diagnose public recordings of single stages: balls dropped from 35 m, the slew of a material handler.

    python -m benchmarks.single_stage_recordings --drops ball_drops.csv --slew slew.csv

The drops are those of github.com/briandesilva/discovery-of-physics-from-data (MIT), as one CSV with the
columns ball, drop, time_s, height_m, velocity_m_per_s. `tests/diagnosis/slew_networks.py` makes slew.csv.
Writes ``single_stage_drops.json`` and ``single_stage_slew.json``: the likeliest known cause, and the verdict.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.result_file import Row, Value, describe, row, write_result


def diagnose(arguments: Sequence[str]) -> dict[str, Any]:
    """Answer of ``downrange diagnose``."""
    with tempfile.TemporaryDirectory() as folder:
        answer = Path(folder) / "answer.json"
        command = [sys.executable, "-m", "cli.main", "diagnose", *arguments, "--json", str(answer)]
        subprocess.run(command, capture_output=True, check=False)
        return json.loads(answer.read_text(encoding="utf-8"))


def best_effects(answer: dict[str, Any]) -> list[dict[str, Any]]:
    """Effects of the likeliest known cause; none where none is needed."""
    known = [cause for cause in answer["causes"] if cause["name"] != "unknown"]
    return [] if answer["verdict"] == "none" else known[0]["effects"]


def drop_rows(file: Path) -> list[Row]:
    """One row a ball."""
    parts = diagnose(["flight", str(file), "--group", "ball,drop"])["evidence"]["parts"]
    rows: list[Row] = []
    for ball, answer in parts.items():
        effects = best_effects(answer)
        drag = [one["parameters"]["drag_per_m"] for one in effects if one["effect"] == "air_drag"]
        labels = {
            "ball": ball,
            "verdict": answer["verdict"],
            "best_explanation": " + ".join(one["effect"] for one in effects) or "none",
        }
        value = Value(value=None)
        if drag:
            value = Value(value=drag[0]["value"], low=drag[0]["ci90"][0], high=drag[0]["ci90"][1])
        rows.append(row(2, labels, {"drag_per_m": value}))
    return rows


def slew_rows(file: Path) -> tuple[list[Row], str]:
    """One row a parameter, and the verdict in words."""
    answer = diagnose(["actuation", str(file)])
    rows = [
        row(
            1,
            {"effect": effect["effect"], "parameter": name, "unit": found["unit"]},
            {"found": Value(value=found["value"], low=found["ci90"][0], high=found["ci90"][1])},
        )
        for effect in best_effects(answer)
        for name, found in effect["parameters"].items()
    ]
    return rows, answer["verdict"]


def main() -> None:
    """Write a result file for each recording that is given."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--drops", type=Path)
    parser.add_argument("--slew", type=Path)
    options = parser.parse_args()
    made = []
    if options.drops is not None:
        title = "Ball drops from 35 m, two a ball, filmed at 15 Hz"
        made.append(describe("single_stage_drops", title, drop_rows(options.drops), seed=None))
    if options.slew is not None:
        rows, verdict = slew_rows(options.slew)
        title = "Slew of a 40 t material handler, from two published networks of its response"
        notes = f"Verdict: {verdict}."
        made.append(describe("single_stage_slew", title, rows, seed=None, notes=notes))
    for result in made:
        write_result(result.model_copy(update={"interval": "90 %"}))


if __name__ == "__main__":
    main()
