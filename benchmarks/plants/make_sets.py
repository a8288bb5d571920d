"""Record sets of throws of the plant `ring`: commissioning, healthy days, effects, pairs, unknown effects.

    python -m benchmarks.plants.make_sets OUT [--units 1 2 3 4] [--throws 12] [--limit N] [--jobs N]

Writes for each unit ``OUT/unit-003/`` with its calibration, profile and reference throws (two days), for each
set ``OUT/sets/s007/``, and ``OUT/truth.json`` with what is wrong in which set.
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
from typing import Any, Literal

import numpy as np

from benchmarks.plants.ring.library import load_library
from benchmarks.plants.ring.plant import OPTIONS_VARIABLE

ROOT = Path(__file__).parents[2]
PLANT = "benchmarks.plants.ring.plant:Ring"
MACHINE_ID = "ring"
COMMISSIONING_DAYS = (1, 2)
FIRST_SET_DAY = 10

Kind = Literal["healthy", "single", "pair", "unknown"]


@dataclass(frozen=True)
class ThrowSet:
    """One set of throws of one machine on one day."""

    name: str
    kind: Kind
    unit: int
    day: int
    effects: list[dict[str, Any]]


def known(name: str, joint: str | None = None, **parameters: float) -> dict[str, Any]:
    """An effect of docs/effects.md."""
    return {"effect": name, "joint": joint, "parameters": parameters}


def unknown(name: str, size: float, joint: str | None = None) -> dict[str, Any]:
    """An effect outside docs/effects.md."""
    return {"effect": name, "joint": joint, "parameters": {"size": size}}


HEALTHY_COUNT = 16
SINGLES = (
    known("valve_dead_time", "dipper", extra_dead_time_s=0.07),
    known("valve_dead_time", "slew", extra_dead_time_s=0.12),
    known("valve_lag", "dipper", extra_lag_s=0.15),
    known("valve_lag", "telescope", extra_lag_s=0.18),
    known("valve_dead_band", "dipper", positive_ratio=0.15, negative_ratio=0.15),
    known("valve_dead_band", "telescope", positive_ratio=0.16, negative_ratio=0.16),
    known("valve_gain", "dipper", positive_ratio=-0.22, negative_ratio=-0.22),
    known("valve_gain", "slew", positive_ratio=-0.25, negative_ratio=-0.25),
    known("valve_gain", "telescope", positive_ratio=0.25, negative_ratio=0.25),
    known("speed_limit", "dipper", reduction_ratio=0.35),
    known("speed_limit", "telescope", reduction_ratio=0.35),
    known("passive_viscous_friction", extra_viscous_per_s=0.5),
    known("passive_coulomb_friction", extra_coulomb_rad_per_s2=0.5),
    known("gripper_length", extra_length_m=0.18),
    known("gripper_length", extra_length_m=-0.18),
    known("release_delay", extra_delay_s=0.08),
    known("release_delay", extra_delay_s=-0.07),
    known("sticky_release", slowdown_ratio=0.15),
    known("air_drag", extra_drag_coefficient_ratio=2.0),
    known("wind", x_m_per_s=-6.0, y_m_per_s=3.0),
    known("joint_sensor_bias", "boom", bias_rad_m=0.045),
    known("joint_sensor_bias", "dipper", bias_rad_m=-0.05),
    known("joint_sensor_bias", "slew", bias_rad_m=0.04),
    known("base_tilt", roll_rad=0.0, pitch_rad=0.06),
    known("base_tilt", roll_rad=0.08, pitch_rad=-0.06),
)
PAIRS = (
    (SINGLES[0], SINGLES[15]),
    (SINGLES[6], SINGLES[11]),
    (SINGLES[7], SINGLES[18]),
    (SINGLES[10], SINGLES[16]),
    (SINGLES[1], SINGLES[13]),
    (SINGLES[20], SINGLES[12]),
    (SINGLES[23], SINGLES[4]),
    (SINGLES[9], SINGLES[17]),
)
UNKNOWNS = (
    unknown("sticking_spool", 0.25, "dipper"),
    unknown("sticking_spool", 0.30, "slew"),
    unknown("leaking_piston", 20.0, "dipper"),
    unknown("engine_sag", 1.2),
    unknown("half_opening_gripper", 0.30),
    unknown("dragging_slew_ring", 26.0e3),
    unknown("position_dependent_gain", 0.45, "dipper"),
    unknown("position_dependent_gain", 0.45, "telescope"),
    unknown("air_in_oil", 0.75, "dipper"),
    unknown("pump_hunting", 0.7),
    unknown("slow_opening_spool", 0.5, "telescope"),
)


def plan(units: Sequence[int], seed: int = 1) -> list[ThrowSet]:
    """All sets in a random order, which their names follow; units take turns, each set has another day."""
    contents: list[tuple[Kind, list[dict[str, Any]]]] = [
        *(("healthy", []) for _ in range(HEALTHY_COUNT)),
        *(("single", [effect]) for effect in SINGLES),
        *(("pair", list(pair)) for pair in PAIRS),
        *(("unknown", [effect]) for effect in UNKNOWNS),
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
    out: Path,
    unit: int,
    day: int,
    effects: Sequence[Mapping[str, Any]],
    throws: int,
    calibration: Path,
) -> None:
    """Record `throws` throws of a day, the modes in turns, into `out`."""
    options = json.dumps({"day_seed": day, "effects": list(effects)})
    arguments = ["record", "--plant", PLANT, "--unit-seed", str(unit), "--mode", "both"]
    arguments += ["--machine-id", MACHINE_ID, "--throws", str(throws)]
    arguments += ["--seed", str(1000 * unit + day), "--out", str(out)]
    run([*arguments, "--calibration", str(calibration)], {OPTIONS_VARIABLE: options})


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


def commission(out: Path, unit: int, throws: int) -> None:
    """Commission a machine, with half of the reference throws on each of two days."""
    for day in COMMISSIONING_DAYS:
        arguments = ["commission", "--plant", PLANT, "--unit-seed", str(unit)]
        arguments += ["--machine-id", MACHINE_ID, "--day", f"2026-01-{day:02d}"]
        arguments += ["--reference-throws", str(throws // 2), "--out", str(unit_folder(out, unit))]
        run(arguments, {OPTIONS_VARIABLE: json.dumps({"day_seed": day})})


def unit_folder(out: Path, unit: int) -> Path:
    """Folder of a machine."""
    return out / f"unit-{unit:03d}"


def main() -> None:
    """Record everything, machines first, on all cores."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("out", type=Path)
    parser.add_argument("--units", type=int, nargs="+", default=[1, 2, 3, 4])
    parser.add_argument("--throws", type=int, default=12, help="throws a set (default: 12)")
    parser.add_argument("--reference-throws", type=int, default=24)
    parser.add_argument("--limit", type=int, help="only the first N sets, to try it")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args()
    out: Path = options.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    load_library()
    sets = plan(options.units)[: options.limit]
    units = sorted({one.unit for one in sets})

    def make(one: ThrowSet) -> None:
        calibration = unit_folder(out, one.unit) / "ring.calibration.json"
        record(out / "sets" / one.name, one.unit, one.day, one.effects, options.throws, calibration)
        print(one.name, flush=True)

    with ThreadPoolExecutor(options.jobs) as pool:
        list(pool.map(lambda unit: commission(out, unit, options.reference_throws), units))
        list(pool.map(make, sets))
    truth = json.dumps([asdict(one) for one in sets], indent=1)
    (out / "truth.json").write_text(truth + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
