"""`downrange units`: the same throws on many machines of a kind that no training has seen."""

import json as json_text
from pathlib import Path
from time import perf_counter
from typing import Any, Literal

import numpy as np

from cli.campaigns import open_campaign
from cli.conditions import rows_of
from cli.registration import registered
from diagnosis.evaluation.conditions import ConditionRow, pooled
from machine.conventions import DEFAULT_PACE_RATIO, Mode
from machine.errors import UsageError

NOMINAL_UNIT = 0


def run(
    *,
    mode: Literal["2d", "3d"],
    count: int = 20,
    first: int = 2000,
    plant: str = "virtual",
    targets: str = "7.5,8.5,9.5",
    throws: int = 40,
    seed: int = 0,
    pace: float = DEFAULT_PACE_RATIO,
    json: Path | None = None,
    policies: Path = Path("policies"),
    policy: Path | None = None,
) -> int:
    """Throw alike on many units, each calibrated and registered as at its first start, and on unit 0.

    A unit's spread is the root mean square over the targets of its standard deviations. Training's ranges
    stand around units 0, 100, 104, 108, 203, 302, 1003 and 1015; development units besides: 5, 301 to 304,
    and 1000 to 1019, which judged earlier policies.

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
    units: dict[int, list[ConditionRow]] = {}
    print("unit  landed  down mean/sd, m  cross mean/sd, m")
    for unit in (NOMINAL_UNIT, *range(first, first + count)):
        campaign = open_campaign(
            mode=Mode(mode), plant=plant, targets=targets, throws=throws, seed=seed,
            unit_seed=unit, policies=policies, policy=policy, calibration=None,
            profile=None, pace_ratio=pace,
        )  # fmt: skip
        units[unit] = rows_of(registered(campaign, seed), throws, seed)
        print(_line(unit, units[unit]), flush=True)
    summary = _summary(units)
    for name, value in summary.items():
        print(f"{name}: {value:.3f}")
    print(f"{perf_counter() - started:.0f} s")
    if json is not None:
        rows = {unit: [row.model_dump() for row in found] for unit, found in units.items()}
        text = json_text.dumps({"summary": summary, "seed": seed, "units": rows}, indent=2)
        json.write_text(text + "\n", encoding="utf-8")
    return 0


def _line(unit: int, rows: list[ConditionRow]) -> str:
    landed, thrown = sum(r.landed_count for r in rows), sum(r.throw_count for r in rows)
    cells = [
        "-" if (value := pooled(rows, name)) is None else f"{value:.3f}"
        for name in (
            "mean_downrange_error_m",
            "sd_downrange_m",
            "mean_crossrange_error_m",
            "sd_crossrange_m",
        )
    ]
    return f"{unit:4d}  {landed}/{thrown}  {cells[0]}/{cells[1]}      {cells[2]}/{cells[3]}"


def _summary(units: dict[int, list[ConditionRow]]) -> dict[str, float]:
    """Spread of the units against unit 0's."""
    others = [rows for unit, rows in units.items() if unit != NOMINAL_UNIT]
    found: dict[str, float] = {}
    for way in ("downrange", "crossrange"):
        nominal = pooled(units[NOMINAL_UNIT], f"sd_{way}_m")
        spreads: list[Any] = [pooled(rows, f"sd_{way}_m") for rows in others]
        known = [s for s in spreads if s is not None]
        if nominal is None or not known:
            continue
        found |= {
            f"sd {way} of unit 0, m": nominal,
            f"sd {way}, median unit, m": float(np.median(known)),
            f"sd {way}, worst unit, m": max(known),
            f"median over unit 0, {way}": float(np.median(known)) / nominal,
            f"worst over unit 0, {way}": max(known) / nominal,
        }
        misses = [pooled(rows, f"mean_{way}_error_m") for rows in others]
        found[f"mean {way} error, rms over units, m"] = float(
            np.sqrt(np.mean([m * m for m in misses if m is not None]))
        )
    landed = sum(row.landed_count for rows in others for row in rows)
    found["landed share of the units"] = landed / sum(
        row.throw_count for rows in others for row in rows
    )
    return found
