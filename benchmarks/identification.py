"""Error and coverage of the identification, against the hidden parameters of virtual machines.

    python -m benchmarks.identification [0 3 7] [--seeds 4] [--tests release ...] [--json FILE]

Release delay, its standard deviation, friction and length are parameters of a virtual machine. Dead time
and lag are parameters up to the contributions of oil and sensors. Limits and gains are compared between
seeds.
"""

import argparse
import tempfile
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from benchmarks.result_file import RESULTS, Row, describe, ratio, row, write_result
from diagnosis.identification.free_swing import identify_swing
from diagnosis.identification.quantity import Quantity
from diagnosis.identification.release_delay import identify_release
from diagnosis.identification.response import DIRECTIONS, identify_response
from diagnosis.loading.logs import load_throws
from diagnosis.loading.throw_data import ThrowData
from machine.conventions import ACTIVE_JOINTS, Mode
from machine.spec import load_spec
from machine.starts import safe_pose
from runtime.control.control_loop import ControlParams
from sim_twin.commissioning.motions import TestKind, motion_program
from sim_twin.commissioning.plant_data import plant_calibration
from sim_twin.commissioning.recording import record_test
from sim_twin.throws.plants import VIRTUAL, plant_maker
from sim_twin.throws.throw_logs import CampaignRecorder, LogContext
from sim_twin.virtual.body import build_body
from sim_twin.virtual.units import make_unit

SPEC = load_spec()


def record(kind: TestKind, unit: int, seed: int, out: Path) -> tuple[ThrowData, ...]:
    make = plant_maker(VIRTUAL, unit_seed=unit, profile=None, calibration=None, spec=SPEC)
    valves = plant_calibration(VIRTUAL, make, unit_seed=unit, spec=SPEC, path=None)
    params = ControlParams(SPEC, valves, Mode.PLANAR, policy=None)
    context = LogContext(f"virtual-{unit}", f"{kind}-{unit}-{seed}", 0, out, test=kind)
    # The poses of a program affect a limit by 2 %: common poses would give all units the same error.
    draw = int(np.random.SeedSequence((unit, seed)).generate_state(1)[0])
    program = motion_program(kind, draw)
    plant = make(program.start_rad_m.shape[0])
    record_test(plant, params, program, draw, CampaignRecorder(params, context))
    plant.close()
    return load_throws([out], SPEC).throws


def hidden(unit_seed: int) -> dict[str, float]:
    """Parameters of the unit in terms of the identified quantities."""
    unit = make_unit(SPEC, unit_seed)
    body = build_body(SPEC, unit, 0.002)
    model, data = body.model, mujoco.MjData(body.model)
    found = {"release.mean": unit.release_delay_s, "release.sd": unit.release_delay_sd_s}
    for axis, name in ((4, "pitch"), (5, "roll")):

        def torque(offset: float, axis: int = axis) -> float:
            data.qpos[:] = safe_pose()
            data.qpos[axis] += offset
            mujoco.mj_forward(model, data)
            return float(data.qfrc_bias[axis])

        stiffness = (torque(1e-3) - torque(-1e-3)) / 2e-3
        data.qpos[:] = safe_pose()
        mujoco.mj_forward(model, data)
        matrix = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, matrix)
        inertia = float(matrix[axis, axis])
        found[f"{name}.viscous"] = float(body.swing_viscous[axis - 4]) / inertia
        found[f"{name}.coulomb"] = float(body.swing_coulomb[axis - 4]) / inertia
        found[f"{name}.length"] = 9.81 * inertia / stiffness
    for joint, name in enumerate(ACTIVE_JOINTS):
        found[f"{name}.dead_time"] = unit.dead_time_s[joint]
        found[f"{name}.lag"] = unit.spool_lag_s[joint]
    return found


def identified(unit: int, seed: int, tests: list[str]) -> dict[str, Any]:
    found: dict[str, Quantity] = {}
    with tempfile.TemporaryDirectory() as folder:
        if "release" in tests:
            release = identify_release(record("release", unit, seed, Path(folder) / "r"), SPEC)
            found |= {"release.mean": release.mean, "release.sd": release.sd}
        if "swing" in tests:
            for axis in identify_swing(record("swing", unit, seed, Path(folder) / "s"), SPEC):
                found[f"{axis.joint}.viscous"] = axis.viscous_friction_per_s
                found[f"{axis.joint}.coulomb"] = axis.coulomb_friction_rad_per_s2
                found[f"{axis.joint}.length"] = axis.length_m
        if "response" in tests:
            found |= responses(record("response", unit, seed, Path(folder) / "v"))
    return {k: (q.value, *(q.ci90 or (None, None))) for k, q in found.items()}


def responses(throws: tuple[ThrowData, ...]) -> dict[str, Quantity]:
    found: dict[str, Quantity] = {}
    for joint in identify_response(throws, SPEC):
        found[f"{joint.joint}.dead_time"] = joint.shared["dead_time_s"]
        found[f"{joint.joint}.lag"] = joint.shared["lag_s"]
        for direction in DIRECTIONS:
            for name, known in joint.directions[direction].items():
                found[f"{joint.joint} {direction} {name}"] = known
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("units", nargs="*", type=int, default=[0, 3, 7])
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--tests", nargs="+", default=["release", "swing", "response"])
    parser.add_argument("--json", type=Path, default=RESULTS / "identification.json")
    options = parser.parse_args()
    runs = []
    for unit in options.units:
        truth = hidden(unit)
        for seed in range(options.first_seed, options.first_seed + options.seeds):
            runs.append(
                {
                    "unit": unit,
                    "seed": seed,
                    "truth": truth,
                    "found": identified(unit, seed, options.tests),
                }
            )
            print(f"unit {unit} seed {seed}", flush=True)
    title = "Identification against the parameters of virtual machines"
    rows = [*against_truth(runs), *against_other_seeds(runs)]
    notes = "Coverage: share of the 90 % intervals that contain the reference."
    write_result(
        describe("identification", title, rows, seed=options.first_seed, notes=notes), options.json
    )


def against_truth(runs: list[dict[str, Any]]) -> list[Row]:
    """Print and return errors against the unit's parameters."""
    print("quantity            n  mean error  rms error  rms half width  inside 90 %")
    lines: list[Row] = []
    for name in runs[0]["truth"]:
        if name not in runs[0]["found"]:
            continue
        rows = [
            (r["truth"][name], *r["found"][name]) for r in runs if r["found"][name][0] is not None
        ]
        if not rows:
            print(f"{name:<18} {len(rows):3d}  never known")
            continue
        true, value, low, high = np.array(rows).T
        error = value - true
        inside = np.mean((low <= true) & (true <= high))
        print(
            f"{name:<18} {len(rows):3d}  {error.mean():+10.4f} {np.sqrt((error**2).mean()):10.4f}"
            f"  {np.sqrt(((high - low) ** 2 / 4).mean()):14.4f}  {inside:10.0%}"
        )
        values = {
            "mean_error": error.mean(),
            "rms_error": np.sqrt((error**2).mean()),
            "coverage_ratio": ratio(round(inside * len(rows)), len(rows)),
        }
        lines.append(row(len(rows), {"quantity": name, "reference": "parameter"}, values))
    return lines


def against_other_seeds(runs: list[dict[str, Any]]) -> list[Row]:
    """Print and return the share of intervals that contain the mean of the unit's other seeds."""
    lines: list[Row] = []
    counts = {}
    for name in runs[0]["found"]:
        if " " not in name:
            continue
        kind = name.split()[-1]
        for unit in {r["unit"] for r in runs}:
            found = [r["found"][name] for r in runs if r["unit"] == unit]
            counts.setdefault(kind, [0, 0, 0])[2] += len(found)
            known = [f for f in found if f[0] is not None]
            if len(known) < 2:
                continue
            for k, (_, low, high) in enumerate(known):
                others = np.mean([f[0] for i, f in enumerate(known) if i != k])
                counts[kind][0] += low <= others <= high
                counts[kind][1] += 1
    for kind, (inside, total, asked) in counts.items():
        share = f"{inside / total:.0%}" if total else "-"
        print(
            f"{kind:<28} {total:3d} of {asked} known, {share} contain the mean of the other seeds"
        )
        values = {"mean_error": None, "rms_error": None, "coverage_ratio": ratio(inside, total)}
        lines.append(row(total, {"quantity": kind, "reference": "other seeds"}, values))
    return lines


if __name__ == "__main__":
    main()
