"""How well loads of material land by mode, pace and mass: the virtual machine throws gravel.

    python -m benchmarks.load_scatter [--throws 6] [--json FILE]

A policy learns with a ball: a grab of gravel holds the arm back, the more the faster it is to be. For every
mode, pace and mass: root mean square miss of the load's centre, machines, ranges and heights together, and
the spread of its grains over the one that the planner predicts from previews (`bulk.previewed_throws`).
`LOAD_MISS_M` of `bulk/throw_model.py` holds the misses.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import tyro

from benchmarks.load_reach import gravel
from benchmarks.result_file import RESULTS, Row, describe, row, write_result
from bulk.material import MATERIALS
from bulk.previewed_throws import open_policies, previewed_models
from bulk.throw_model import ThrowModel
from evaluation.campaigns import CampaignOptions, open_with
from machine.conventions import Array, Mode
from machine.reach import MIN_RANGE_M, reach_m
from machine.spec import load_spec
from machine.starts import sample_starts
from runtime.control.control_loop import ControlParams
from sim_twin.throws.campaign import ThrowOutcome, run_throws
from sim_twin.virtual_machine import VirtualMachine

MASSES_KG = (0.0, 190.0, 380.0, 570.0)
"""0: the ball."""
PACES = (0.0, 1.0)
HEIGHTS_M = (0.0, 1.4)
SHARES = (0.75, 0.85, 0.95)
"""Of the reach with the load."""
UNITS = (0, 1, 3)
POLICIES = Path("policies")
SEED = 43


class Landed(NamedTuple):
    """Loads that came down."""

    error_m: Array
    """(N, 2) of their centres, downrange and crossrange."""
    grain_ratio: Array
    """(N, 2) variance of the grains over the predicted one, downrange and crossrange."""


def thrown(
    params: ControlParams, unit: int, mass_kg: float, height_m: float, pace: float, throws: int,
    model: ThrowModel,
) -> Landed:  # fmt: skip
    """One machine, height, mass and pace, at every range."""
    assert params.policy is not None
    card = params.policy.card
    reach = reach_m(card, height_m, mass_kg)
    ranges = np.repeat([max(s * reach, MIN_RANGE_M[card.mode]) for s in SHARES], throws)
    target = np.zeros((len(ranges), 3))
    target[:, 0], target[:, 2] = ranges, height_m
    plant = VirtualMachine(count=len(target), unit_seed=unit)
    plant.target_height_m[:] = height_m
    if mass_kg > 0.0:
        plant.set_material(gravel(mass_kg))
    starts = sample_starts(params.spec, card.mode, target, np.random.default_rng([SEED, unit]))
    results = run_throws(plant, params, target, starts, SEED, pace_ratio=pace)
    landed = np.array([one.outcome is ThrowOutcome.LANDED for one in results])
    error = np.array([(one.downrange_error_m, one.crossrange_error_m) for one in results])
    ratio = np.full_like(error, np.nan)
    if mass_kg > 0.0:
        plant.advance(plant.now_ns() + 2_000_000_000)
        measured = plant.read().impact_covariance_m2
        if measured is not None:
            expected = np.stack([model.at_range(model.grain_variance_m2(), r) for r in ranges])
            # Targets lie ahead: variances along x and y are those downrange and crossrange.
            ratio = measured[:, [0, 2]] / expected
    return Landed(error[landed], ratio[landed])


def main(throws: int = 6, json: Path = RESULTS / "load_scatter.json") -> None:
    """Measure every mode, pace and mass and write the result file."""
    spec, rows = load_spec(), list[Row]()
    for mode in Mode:
        params = [
            open_with(
                CampaignOptions("virtual", "8", 1, SEED, unit, POLICIES, None, None, None),
                mode.value,
                "8",
            ).params
            for unit in UNITS
        ]
        among = open_policies(POLICIES, None, mode)
        for pace in PACES:
            models = {
                height: previewed_models(among, spec, MATERIALS["gravel"], height, 0.25, pace)[0]
                for height in HEIGHTS_M
            }
            for mass_kg in MASSES_KG:
                parts = [
                    thrown(one, unit, mass_kg, height, pace, throws, models[height])
                    for unit, one in zip(UNITS, params, strict=True)
                    for height in HEIGHTS_M
                ]
                error = np.concatenate([part.error_m for part in parts])
                grain = np.concatenate([part.grain_ratio for part in parts])
                rms = np.sqrt(np.nanmean(np.square(error), axis=0))
                mass = "ball" if mass_kg == 0.0 else f"{mass_kg:.0f} kg"
                values = {
                    "rms_downrange_m": float(rms[0]),
                    "rms_crossrange_m": float(rms[1]),
                    "mean_downrange_m": float(error[:, 0].mean()),
                }
                if np.isfinite(grain).any():
                    spread = np.sqrt(np.nanmean(grain, axis=0))
                    values["grain_spread_downrange_ratio"] = float(spread[0])
                    values["grain_spread_crossrange_ratio"] = float(spread[1])
                labels = {"mode": mode.value.upper(), "pace": pace, "mass": mass}
                rows.append(row(len(error), labels, values))
                print(labels, len(error), {k: round(v, 3) for k, v in values.items()}, flush=True)
    title = "Misses and spread of loads of gravel by mode, pace and mass, virtual machine"
    print(write_result(describe("load_scatter", title, rows, seed=SEED), json))


if __name__ == "__main__":
    tyro.cli(main)
