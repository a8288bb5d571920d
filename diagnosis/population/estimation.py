"""Estimation of filters.json and noise.json from throws of healthy machines: noise, scatter and known misfit.

    python -m diagnosis.population.estimation FOLDER...

Each folder is one set: throw logs (*.mcap) and the machine's identified profile (profile.json). Use sets of
several machines of the type that are not diagnosed later. The healthy filters are learned on all sets.
Noise is measured on residuals of filters that were learned on other machines. Scatter and nuisances are
then estimated by expectation maximisation: the variances under which the healthy sets are most probable.
"""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from diagnosis.healthy.filters import HEALTHY_PATH, HealthyModel, inputs, learn, nothing
from diagnosis.healthy.noise import NOISE_PATH, ChannelNoise, NoiseModel, Scatter
from diagnosis.linearisation.model_error import factors
from diagnosis.linearisation.nuisances import THROW_NUISANCES, throw_nuisances
from diagnosis.linearisation.open_loop import impacts
from diagnosis.linearisation.parameters import library, scatter_names
from diagnosis.linearisation.sensitivities import linearise
from diagnosis.loading.logs import load_throws
from diagnosis.loading.prepared import prepare
from diagnosis.population.expectation_maximisation import HealthySet, first_scatter_sd, fit, improve
from machine.conventions import ACTIVE_JOINTS, Array
from sim_twin.twin.profile import load_profile

FOLD_COUNT = 5
ROUND_COUNT = 4
JOINT_NOISE = 0.0055
GYRO_NOISE_RAD_PER_S = 6e-4
ACCEL_NOISE_M_PER_S2 = 4e-3
SURVEY_NOISE_M = 0.02
SWITCH_NOISE_S = 0.003
FIRST_THROW_SD = {
    "oil_flow_ratio": 0.01,
    "start_pitch_rad": 0.006,
    "start_roll_rad": 0.006,
    "start_pitch_rate_rad_per_s": 0.01,
    "start_roll_rate_rad_per_s": 0.01,
    "release_delay_s": 0.015,
    "switch_lag_s": 0.0078,
    **{f"grasp_{axis}_m": 0.01 for axis in "xyz"},
    **{f"slip_{axis}_m_per_s": 0.03 for axis in "xyz"},
}
FIRST_MACHINE_SHARE = 0.7
"""Initial share of the machines' scatter in the variance between sets."""
MIN_LEVEL_SD = 0.08
LEVEL_WIDENING_RATIO = 1.3
"""Factor on the spread between sets, which few sets underestimate."""


def load_set(folder: Path) -> HealthySet:
    """Load and linearise a set without correction."""
    loaded = load_throws([folder])
    profile = load_profile(folder / "profile.json")
    prepared = prepare(loaded.throws, profile)
    calibration = loaded.throws[0].calibration
    linear = linearise(prepared, profile, calibration, nothing())
    return HealthySet(prepared, linear, profile, calibration)


def learn_healthy(sets: Sequence[HealthySet], note: str) -> HealthyModel:
    """Filters of all joints from these sets."""
    joints = []
    for joint, name in enumerate(ACTIVE_JOINTS):
        values: list[Array] = []
        residuals: list[Array] = []
        for one in sets:
            for p, linear in zip(one.prepared, one.linear, strict=True):
                block = p.block(f"actuation.{name}")
                if block is None:
                    continue
                ticks = inputs(p.motion, joint, linear.predicted_velocity[:, joint])
                at = [np.interp(block.t_s, p.motion.t_s, column) for column in ticks.T]
                values.append(np.stack(at, axis=1))
                residuals.append(linear.residual[block.rows])
        joints.append(learn(values, residuals))
    return HealthyModel(note=note, joints=tuple(joints))


def corrected(one: HealthySet, healthy: HealthyModel) -> HealthySet:
    """The set linearised with these filters."""
    linear = linearise(one.prepared, one.profile, one.calibration, healthy)
    return replace(one, linear=linear)


def cross_corrected(sets: Sequence[HealthySet]) -> list[HealthySet]:
    """Every set corrected by filters that were learned on other machines."""
    names = [one.prepared[0].throw.machine_id for one in sets]
    machines = sorted(set(names))
    fold_of = {name: place % FOLD_COUNT for place, name in enumerate(machines)}
    out: list[HealthySet | None] = [None] * len(sets)
    for fold in range(FOLD_COUNT):
        inside = [i for i, name in enumerate(names) if fold_of[name] == fold]
        others = [one for i, one in enumerate(sets) if i not in inside]
        if not inside or not others:
            continue
        healthy = learn_healthy(others, "fold")
        for i in inside:
            out[i] = corrected(sets[i], healthy)
    return [one for one in out if one is not None]


def first_model(note: str, block_names: Sequence[str]) -> NoiseModel:
    """Initial model of the iteration."""
    tolerance = [p.tolerance for p in library()]
    of_set = first_scatter_sd()
    of_throw = np.array([*(FIRST_THROW_SD[name] for name in THROW_NUISANCES), *tolerance])
    return NoiseModel(
        note=note,
        channels={name: _first_channel(name) for name in block_names},
        throw_scatter=Scatter.of(throw_nuisances(), np.diag(of_throw**2)),
        machine_scatter=Scatter.of(scatter_names(), np.diag(FIRST_MACHINE_SHARE * of_set**2)),
        set_scatter=Scatter.of(scatter_names(), np.diag((1.0 - FIRST_MACHINE_SHARE) * of_set**2)),
        drift_sd={p.key: p.tolerance for p in library()},
        healthy_mean={},
        healthy_gap_m={},
        unknown_level=dict.fromkeys(block_names, (0.0, 0.3)),
    )


def _first_channel(name: str) -> ChannelNoise:
    white = {
        "noise_sd": 0.0,
        "floor_sd": 0.0,
        "rate_ratio": 0.0,
        "push_ratio": 0.0,
        "memory_s": 0.2,
    }
    if name.startswith("actuation"):
        return ChannelNoise(
            **{**white, "noise_sd": JOINT_NOISE, "floor_sd": 0.005, "rate_ratio": 0.05}
        )
    if "gyro" in name:
        return ChannelNoise(**{**white, "noise_sd": GYRO_NOISE_RAD_PER_S, "floor_sd": 0.01})
    if "accel" in name:
        return ChannelNoise(**{**white, "noise_sd": ACCEL_NOISE_M_PER_S2, "floor_sd": 0.2})
    sd = SWITCH_NOISE_S if name == "release.switch" else SURVEY_NOISE_M
    return ChannelNoise(**{**white, "noise_sd": sd})


def with_levels(sets: Sequence[HealthySet], model: NoiseModel) -> NoiseModel:
    """The model with the residual power of healthy sets in each block, mean and spread over sets."""
    levels: dict[str, list[float]] = {name: [] for name in model.channels}
    for one in sets:
        found = fit(one, model)
        power = dict.fromkeys(levels, 0.0)
        rows = dict.fromkeys(levels, 0)
        for p, left in zip(one.prepared, found.left, strict=True):
            for block, factor in zip(p.blocks, factors(p, model), strict=True):
                unit = np.linalg.solve(factor, left[block.rows])
                power[block.name] += float(unit @ unit)
                rows[block.name] += unit.size
        for name, values in levels.items():
            if rows[name]:
                values.append(float(np.log(max(power[name], 1e-9) / rows[name])))
    return model.model_copy(
        update={
            "unknown_level": {
                name: (
                    float(np.mean(values)),
                    float(max(LEVEL_WIDENING_RATIO * np.std(values), MIN_LEVEL_SD)),
                )
                for name, values in levels.items()
                # A block of one row per throw is all nuisance.
                if values and name != "release.switch"
            }
        }
    )


def calibrate_noise(
    sets: Sequence[HealthySet], note: str, say: Any = lambda text: sys.stdout.write(f"{text}\n")
) -> tuple[HealthyModel, NoiseModel]:
    """Estimate the contents of both files."""
    healthy = learn_healthy(sets, note)
    clean = cross_corrected(sets)
    names = sorted({block.name for one in clean for p in one.prepared for block in p.blocks})
    model = first_model(note, names)
    for number in range(ROUND_COUNT):
        model = improve(clean, model)
        say(f"round {number + 1} of {ROUND_COUNT}")
    gap_m = healthy_gaps(sets, healthy)
    return healthy, with_levels(clean, model).model_copy(update={"healthy_gap_m": gap_m})


def healthy_gaps(sets: Sequence[HealthySet], healthy: HealthyModel) -> dict[str, float]:
    """Root mean square gap of the impact by mode, m, open loop with the filters."""
    squares: dict[str, list[float]] = {}
    for one in sets:
        found = impacts(one.prepared, healthy, one.profile, one.calibration)
        for p, impact in zip(one.prepared, found, strict=True):
            gap = p.throw.impact_m[:2] - impact
            if np.isfinite(gap).all():
                squares.setdefault(p.throw.mode, []).append(float(gap @ gap))
    return {mode: float(np.sqrt(np.mean(values))) for mode, values in squares.items()}


def main(arguments: Sequence[str]) -> int:
    """Command line."""
    folders = [Path(a) for a in arguments]
    if len(folders) < FOLD_COUNT:
        sys.stderr.write(f"at least {FOLD_COUNT} sets are needed, not {len(folders)}\n")
        return 1
    sets: list[HealthySet] = []
    for folder in folders:
        sets.append(load_set(folder))
        sys.stdout.write(f"{folder}\n")
    note = f"{len(folders)} healthy sets, {sum(len(s.prepared) for s in sets)} throws"
    healthy, model = calibrate_noise(sets, note)
    HEALTHY_PATH.write_text(healthy.model_dump_json() + "\n", encoding="utf-8")
    NOISE_PATH.write_text(model.model_dump_json() + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
