"""Record sets of throws of an independent plant: healthy days, effects, pairs, unknown effects.

    python -m benchmarks.plants.make_sets OUT [--plant ring|mule] [--units 1 2 3 4] [--throws 12] [--jobs N]

`--limit N` makes the first N sets only. Writes for each unit ``OUT/unit-003/`` with its calibration, profile
and reference throws (two days), for each set ``OUT/sets/s007/``, and ``OUT/truth.json`` with what is wrong
in which set.
"""

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.plants.contents import PLANTS, Contents, Kind

ROOT = Path(__file__).parents[2]
COMMISSIONING_DAYS = (1, 2)
FIRST_SET_DAY = 10


@dataclass(frozen=True)
class ThrowSet:
    """One set of throws of one machine on one day."""

    name: str
    kind: Kind
    unit: int
    day: int
    effects: list[dict[str, Any]]


def plan(plant: Contents, units: Sequence[int], seed: int = 1) -> list[ThrowSet]:
    """All sets in a random order, which their names follow; units take turns, each set has another day."""
    contents: list[tuple[Kind, list[dict[str, Any]]]] = [
        *(("healthy", []) for _ in range(plant.healthy_count)),
        *(("single", [effect]) for effect in plant.singles),
        *(("pair", list(pair)) for pair in plant.pairs),
        *(("unknown", [effect]) for effect in plant.unknowns),
    ]
    order = np.random.default_rng(seed).permutation(len(contents))
    return [
        ThrowSet(
            f"s{place:03d}",
            contents[index][0],
            units[place % len(units)],
            FIRST_SET_DAY + place,
            contents[index][1],
        )
        for place, index in enumerate(order)
    ]


def record(
    plant: Contents,
    out: Path,
    unit: int,
    day: int,
    effects: Sequence[Mapping[str, Any]],
    throws: int,
    calibration: Path,
) -> None:
    """Record `throws` throws of a day, the modes in turns, into `out`."""
    options = json.dumps({"day_seed": day, "effects": list(effects)})
    arguments = ["record", "--plant", plant.factory, "--unit-seed", str(unit), "--mode", "both"]
    arguments += ["--machine-id", plant.name, "--throws", str(throws)]
    arguments += ["--seed", str(1000 * unit + day), "--out", str(out)]
    run([*arguments, "--calibration", str(calibration)], {plant.options_variable: options})


def run(
    arguments: Sequence[str], environment: Mapping[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Run ``downrange`` with these arguments on one core; any exit code.

    Raises:
        RuntimeError: it ended with exit code 1, an error.
    """
    extra = {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT), **(environment or {})}
    command = [sys.executable, "-m", "cli.main", *arguments]
    done = subprocess.run(
        command, cwd=ROOT, env={**os.environ, **extra}, capture_output=True, text=True, check=False
    )
    if done.returncode == 1 or done.returncode < 0:
        raise RuntimeError(f"{' '.join(arguments)}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}")
    return done


def commission(plant: Contents, out: Path, unit: int, throws: int) -> None:
    """Commission a machine, with half of the reference throws on each of two days."""
    for day in COMMISSIONING_DAYS:
        arguments = ["commission", "--plant", plant.factory, "--unit-seed", str(unit)]
        arguments += ["--machine-id", plant.name, "--day", f"2026-01-{day:02d}"]
        arguments += ["--reference-throws", str(throws // 2), "--out", str(unit_folder(out, unit))]
        run(arguments, {plant.options_variable: json.dumps({"day_seed": day})})


def unit_folder(out: Path, unit: int) -> Path:
    """Folder of a machine."""
    return out / f"unit-{unit:03d}"


def main() -> None:
    """Record everything, machines first, on all cores."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("out", type=Path)
    parser.add_argument("--plant", choices=sorted(PLANTS), default="ring")
    parser.add_argument("--units", type=int, nargs="+", default=[1, 2, 3, 4])
    parser.add_argument("--throws", type=int, default=12, help="throws a set (default: 12)")
    parser.add_argument("--reference-throws", type=int, default=24)
    parser.add_argument("--limit", type=int, help="only the first N sets, to try it")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args()
    plant = PLANTS[options.plant]
    out: Path = options.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    plant.load()
    sets = plan(plant, options.units)[: options.limit]
    units = sorted({one.unit for one in sets})

    def make(one: ThrowSet) -> None:
        calibration = unit_folder(out, one.unit) / f"{plant.name}.calibration.json"
        folder = out / "sets" / one.name
        record(plant, folder, one.unit, one.day, one.effects, options.throws, calibration)
        print(one.name, flush=True)

    with ThreadPoolExecutor(options.jobs) as pool:
        list(pool.map(lambda unit: commission(plant, out, unit, options.reference_throws), units))
        list(pool.map(make, sets))
    truth = json.dumps([asdict(one) for one in sets], indent=1)
    (out / "truth.json").write_text(truth + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
