"""How far a policy throws a load of a given mass: the virtual machine throws at every range.

    python -m benchmarks.load_reach [--throws 4] [--json FILE]

A policy learns with a ball, and the arm gives way under a grab of gravel. For each mode and mass the
farthest target is sought, as a share of the card's reach at its height, up to which the loads fall at most
`SHORT_M` short in the mean and at least `LANDED_RATIO` of them leave the grippers, counted with those at the
next nearer share. Heights and machines count together.
`REACH_WITH_LOAD` of `machine/reach.py` holds the shares.
"""

from pathlib import Path

import numpy as np
import tyro

from benchmarks.result_file import RESULTS, Row, describe, row, write_result
from bulk.material import MATERIALS
from evaluation.campaigns import CampaignOptions, open_with
from machine.conventions import Array, Mode
from machine.reach import MIN_RANGE_M, reach_m
from machine.site.thrown_material import ThrownMaterial
from machine.starts import sample_starts
from runtime.control.control_loop import ControlParams
from sim_twin.throws.campaign import ThrowOutcome, run_throws
from sim_twin.virtual_machine import VirtualMachine

MASSES_KG = (0.0, 190.0, 380.0, 570.0, 760.0, 1140.0, 1520.0)
"""0: the ball."""
HEIGHTS_M = (0.0, 1.6, 3.0)
SHARES = np.linspace(0.6, 1.0, 17)
LANDED_RATIO = 0.9
SHORT_M = 0.3
UNITS = (0, 1)
SEED = 42


def gravel(mass_kg: float) -> ThrownMaterial:
    """A grab of gravel of a mass."""
    kind = MATERIALS["gravel"]
    return ThrownMaterial(
        name=kind.name,
        volume_m3=mass_kg / kind.loose_density_kg_per_m3,
        mass_kg=mass_kg,
        grain_diameter_m=kind.grain_diameter_m,
        grain_spread_ratio=kind.grain_spread_ratio,
        grain_density_kg_per_m3=kind.grain_density_kg_per_m3,
        drag_coefficient_ratio=kind.drag_coefficient_ratio,
    )


def thrown(
    params: ControlParams, unit: int, mass_kg: float, height_m: float, throws: int
) -> tuple[Array, Array]:
    """Share of the card's reach (N) and error downrange (N) of loads at one height, NaN: not landed."""
    assert params.policy is not None
    card = params.policy.card
    nearest_m = max(card.target_range_min_m, MIN_RANGE_M[card.mode])
    card_m = reach_m(card, height_m)
    shares = np.repeat(SHARES[card_m * SHARES >= nearest_m], throws)
    target = np.zeros((len(shares), 3))
    target[:, 0], target[:, 2] = shares * card_m, height_m
    plant = VirtualMachine(count=len(target), unit_seed=unit)
    if mass_kg > 0.0:
        plant.set_material(gravel(mass_kg))
    rng = np.random.default_rng([SEED, unit])
    starts = sample_starts(params.spec, card.mode, target, rng)
    results = run_throws(plant, params, target, starts, SEED)
    error = [
        one.downrange_error_m if one.outcome is ThrowOutcome.LANDED else np.nan for one in results
    ]
    return shares, np.array(error)


def measured(mode: Mode, mass_kg: float, params: list[ControlParams], throws: int) -> Row:
    """One mode and mass on all machines at all heights."""
    parts = [
        thrown(one, unit, mass_kg, height_m, throws)
        for unit, one in zip(UNITS, params, strict=True)
        for height_m in HEIGHTS_M
    ]
    share, error = (np.concatenate(part) for part in zip(*parts, strict=True))
    is_good: list[bool] = []
    step = SHARES[1] - SHARES[0]
    for one in SHARES:
        at = error[np.isclose(share, one)]
        near = np.isfinite(error[(share > one - 1.5 * step) & (share < one + 0.5 * step)])
        mean = float(np.nanmean(at)) if np.isfinite(at).any() else -np.inf
        is_good.append(bool(near.mean() >= LANDED_RATIO and mean >= -SHORT_M))
        landed = np.isfinite(at).mean()
        print(
            f"  {mode} {mass_kg:.0f} kg {one:.3f}: {landed:.3f} landed, {mean:+.2f} m", flush=True
        )
    bad = [n for n, good in enumerate(is_good) if not good]
    farthest = SHARES[bad[0] - 1] if bad and bad[0] else (np.nan if bad else 1.0)
    near = np.isfinite(error[share <= farthest + 1e-9]).mean() if np.isfinite(farthest) else np.nan
    values = {"reach_ratio": farthest, "landed_percent": 100.0 * near}
    return row(
        len(error),
        {"mode": mode.value.upper(), "mass": "ball" if mass_kg == 0.0 else f"{mass_kg:.0f} kg"},
        {name: float(value) for name, value in values.items()},
    )


def main(throws: int = 4, json: Path = RESULTS / "load_reach.json") -> None:
    """Measure every mode and mass and write the result file."""
    rows: list[Row] = []
    for mode in (Mode.PLANAR, Mode.SPATIAL):
        params = [
            open_with(
                CampaignOptions("virtual", "8", 1, SEED, unit, Path("policies"), None, None, None),
                mode.value,
                "8",
            ).params
            for unit in UNITS
        ]
        for mass_kg in MASSES_KG:
            rows.append(measured(mode, mass_kg, params, throws))
            print(rows[-1].labels, rows[-1].values, flush=True)
    title = "Farthest target of a load by its mass, share of the card's reach, virtual machine"
    print(write_result(describe("load_reach", title, rows, seed=SEED), json))


if __name__ == "__main__":
    tyro.cli(main)
