"""`downrange units`: the same throws on many machines of the type that were not used in training."""

import json as json_text
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter
from typing import Literal

from evaluation.campaigns import CampaignOptions
from evaluation.conditions import ERROR_NAMES, ConditionRow, root_mean_square
from evaluation.unit_accuracy import FIRST_UNIT, UNIT_TARGETS, compare_units, throw_units
from machine.conventions import DEFAULT_PACE_RATIO
from machine.errors import UsageError


def run(
    *,
    mode: Literal["2d", "3d"],
    count: int = 20,
    first: int = FIRST_UNIT,
    plant: str = "virtual",
    targets: str = UNIT_TARGETS,
    throws: int = 40,
    seed: int = 0,
    pace: float = DEFAULT_PACE_RATIO,
    json: Path | None = None,
    policies: Path = Path("policies"),
    policy: Path | None = None,
) -> int:
    """Throw alike with unit 0 and many other units, each calibrated and registered as at commissioning.

    A unit's spread is the root mean square over the targets of its standard deviations. Units below 2000 were
    used in training and development.

    Example: downrange units --mode 2d --count 20 --throws 40 --seed 7 --json units.json

    Args:
        mode: 2d or 3d.
        count: units besides unit 0.
        first: number of the first of them.
        plant: virtual, or package.module:Class of your own simulated machine.
        targets: ranges in metres, as of evaluate.
        throws: at each target of each unit.
        seed: of start poses and of everything random in the plants.
        pace: 0 careful .. 1 fast.
        json: write every row to this file.
        policies: folder of policy versions; its active.json names the one of each mode.
        policy: folder of one policy version, instead of the active one.
    """
    if count < 1 or first < 1:
        raise UsageError(f"--count {count} --first {first}: both are 1 or more")
    if json is not None and not json.parent.is_dir():
        raise UsageError(f"cannot write {json}: the folder {json.parent} does not exist")
    started = perf_counter()
    options = CampaignOptions(plant, targets, throws, seed, 0, policies, policy, None, None, pace)
    units: dict[int, list[ConditionRow]] = {}
    print("unit  landed  down mean/sd, m  cross mean/sd, m")
    for unit, rows in throw_units(mode, options, count, first):
        units[unit] = rows
        print(_line(unit, rows), flush=True)
    summary = compare_units(units)
    for name, value in summary.items():
        print(f"{name}: {value:.3f}")
    print(f"{perf_counter() - started:.0f} s")
    if json is not None:
        found = {unit: [row.model_dump() for row in rows] for unit, rows in units.items()}
        text = json_text.dumps({"summary": summary, "seed": seed, "units": found}, indent=2)
        json.write_text(text + "\n", encoding="utf-8")
    return 0


def _line(unit: int, rows: Sequence[ConditionRow]) -> str:
    landed, thrown = sum(r.landed_count for r in rows), sum(r.throw_count for r in rows)
    cells = [
        "-" if (value := root_mean_square(rows, name)) is None else f"{value:.3f}"
        for name in ERROR_NAMES
    ]
    return f"{unit:4d}  {landed}/{thrown}  {cells[0]}/{cells[1]}      {cells[2]}/{cells[3]}"
