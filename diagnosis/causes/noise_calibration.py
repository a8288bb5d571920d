"""Makes healthy.json and noise.json from throws of healthy machines: what is noise, scatter and known misfit.

    python -m diagnosis.causes.noise_calibration FOLDER...

Each folder is one set: throw logs (*.mcap) and the machine's own identified profile (profile.json). Use sets
of several machines of the type, none of which is diagnosed later. The healthy filters are learned on all
sets; noise is measured on residuals of filters that have not seen the machine. Scatter (the spikes) and
nuisances are then found by expectation maximisation: the variances under which the healthy sets are most
probable.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import nnls

from diagnosis.causes.healthy import HEALTHY_PATH, HealthyModel, correction, inputs, learn, nothing
from diagnosis.causes.noise import NOISE_PATH, ChannelNoise, NoiseModel
from diagnosis.causes.parameters import layout, library
from diagnosis.causes.residuals import Linear, linearise
from diagnosis.causes.selection import inform_gram, screen, total
from diagnosis.causes.whitening import (
    SET_NUISANCES,
    explained,
    factors,
    set_nuisance_sd,
    slope_count,
    throw_nuisances,
    whiten_throw,
)
from diagnosis.loading.logs import load_throws
from diagnosis.loading.prepared import PreparedThrow, prepare
from diagnosis.shrink import impacts
from machine.calibration import ValveCalibration
from machine.conventions import ACTIVE_JOINTS, Array
from sim_twin.twin.profile import TwinProfile, load_profile

FOLD_COUNT = 5
ROUND_COUNT = 4
JOINT_NOISE = 0.0055
GYRO_NOISE_RAD_PER_S = 6e-4
ACCEL_NOISE_M_PER_S2 = 4e-3
SURVEY_NOISE_M = 0.02
SWITCH_NOISE_S = 0.003
FIRST_NUISANCE_SD = {
    "oil_flow_ratio": 0.01,
    "start_swing_rad": 0.006,
    "start_swing_rate_rad_per_s": 0.01,
    "release_delay_s": 0.015,
    "switch_lag_s": 0.0078,
    "grasp_m": 0.01,
    "slip_m_per_s": 0.03,
}
KEPT_NUISANCE = ("release_delay_s", "switch_lag_s")
"""Not separable in healthy data; jitter of the opening is in the machine's profile."""
WITHOUT_MEAN = (
    *(f"valve_{name}" for name in ("lag", "dead_band", "gain", "hysteresis")),
    *("speed_limit", "load_dependent_speed", "backlash", "stiction", "pump_flow_sharing"),
)
"""What is off there on every machine is taken away by the filters; a mean of their own would drift against
that of the dead time, which the identification sees with the joint sensor in it."""
MIN_LEVEL_SD = 0.08
LEVEL_WIDENING_RATIO = 1.3
"""Few sets show less than their true spread."""


@dataclass(frozen=True, slots=True)
class HealthySet:
    """One set of throws without an effect."""

    prepared: Sequence[PreparedThrow]
    linear: Sequence[Linear]
    profile: TwinProfile
    calibration: ValveCalibration


def load_set(folder: Path) -> HealthySet:
    """Load and linearise a set, not corrected."""
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
    """The set with the filters' output taken off."""
    linear: list[Linear] = []
    for p, old in zip(one.prepared, one.linear, strict=True):
        residual = old.residual.copy()
        for joint, name in enumerate(ACTIVE_JOINTS):
            block = p.block(f"actuation.{name}")
            if block is not None:
                track = correction(healthy, p.motion, joint, old.predicted_velocity[:, joint])
                residual[block.rows] -= p.joint_pair @ np.interp(p.joint_at_s, p.motion.t_s, track)
        linear.append(replace(old, residual=residual))
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


# --- expectation maximisation ----------------------------------------------------------------------


def first_model(note: str, block_names: Sequence[str]) -> NoiseModel:
    """Where the rounds begin."""
    return NoiseModel(
        note=note,
        channels={name: _first_channel(name) for name in block_names},
        nuisance_sd={**FIRST_NUISANCE_SD, **{p.key: p.tolerance for p in library()}},
        set_nuisance_sd={
            name: 0.03
            if "accel" in name
            else 0.003
            if "gyro" in name or name.endswith("_s")
            else 0.01
            for name in SET_NUISANCES
        },
        tolerance={p.key: 4.0 * p.tolerance for p in library()},
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


@dataclass(frozen=True, slots=True)
class _Fit:
    mean: Array
    variance: Array
    """Of the whole vector."""
    nuisance_square: Array
    """(q,) posterior second moment of the throws' unit nuisances, mean over throws."""
    left: Sequence[Array]
    """By throw, in the channels' own units, nuisances and parameters taken off."""


def _fit(one: HealthySet, model: NoiseModel) -> _Fit:
    plan = layout(model.tolerance, set_nuisance_sd(model))
    factor = [factors(p, model) for p in one.prepared]
    white = [
        whiten_throw(p, linear, model, f)
        for p, linear, f in zip(one.prepared, one.linear, factor, strict=True)
    ]
    kept = np.r_[: plan.parameter_count, plan.parameter_count + plan.drift_count : plan.size_count]
    data = total([inform_gram(w.gram, slope_count()) for w in white])
    priors = plan.priors
    base = screen(data, priors._replace(spike_sd=priors.spike_sd[kept]))
    mean, variance = np.zeros(plan.size_count), np.zeros(plan.size_count)
    mean[kept], variance[kept] = base.mean, np.diag(base.covariance)
    squares: list[Array] = []
    left: list[Array] = []
    for w, p, lower in zip(white, one.prepared, factor, strict=True):
        rest = w.residual - explained(w, mean)
        covariance = np.linalg.inv(np.eye(w.nuisance.shape[1]) + w.nuisance.T @ w.nuisance)
        eta = covariance @ (w.nuisance.T @ rest)
        squares.append(eta**2 + np.diag(covariance))
        rest = rest - w.nuisance @ eta
        raw = np.zeros_like(rest)
        for block, one_factor in zip(p.blocks, lower, strict=True):
            raw[block.rows] = one_factor @ rest[block.rows]
        left.append(raw)
    return _Fit(mean, variance, np.mean(squares, axis=0), left)


def improve(sets: Sequence[HealthySet], model: NoiseModel) -> NoiseModel:
    """One round: fit every set under the model, then the variances that would have made the fits probable."""
    fits = [_fit(one, model) for one in sets]
    middle = np.mean([fit.mean for fit in fits], axis=0)
    constants = library()
    names = [*[p.key for p in constants], *SET_NUISANCES]
    # The mean moves in steps; what is left of it this round does not count as scatter.
    moves = np.ones(middle.size)
    moves[[i for i, p in enumerate(constants) if p.key.startswith(WITHOUT_MEAN)]] = 0.0
    square = np.mean([(fit.mean - moves * middle) ** 2 + fit.variance for fit in fits], axis=0)
    places = [*range(len(constants)), *range(2 * len(constants), square.size)]
    mean = {
        name: model.healthy_mean.get(name, 0.0) + float(middle[place])
        for name, place in zip(names, places, strict=True)
        if not name.startswith(WITHOUT_MEAN)
    }
    tolerance = {p.key: float(np.sqrt(square[i])) for i, p in enumerate(constants)}
    offset = 2 * len(constants)
    set_sd = {name: float(np.sqrt(square[offset + i])) for i, name in enumerate(SET_NUISANCES)}
    moment = np.mean([fit.nuisance_square for fit in fits], axis=0)
    nuisance: dict[str, float] = {}
    for name, old in model.nuisance_sd.items():
        columns = [i for i, n in enumerate(throw_nuisances()) if n == name]
        nuisance[name] = (
            old if name in KEPT_NUISANCE else old * float(np.sqrt(moment[columns].mean()))
        )
    return model.model_copy(
        update={
            "tolerance": tolerance,
            "healthy_mean": mean,
            "set_nuisance_sd": set_sd,
            "nuisance_sd": nuisance,
            "channels": {
                name: _channel(name, old, sets, fits) for name, old in model.channels.items()
            },
        }
    )


def _channel(
    name: str, old: ChannelNoise, sets: Sequence[HealthySet], fits: Sequence[_Fit]
) -> ChannelNoise:
    """Discrepancy from the size and the memory of what is left."""
    if not name.startswith(("actuation", "swing")):
        return old
    size: list[Array] = []
    level: list[Array] = []
    for one, fit in zip(sets, fits, strict=True):
        for p, left in zip(one.prepared, fit.left, strict=True):
            block = p.block(name)
            if block is not None:
                size.append(left[block.rows])
                level.append(np.column_stack([np.ones(block.t_s.size), block.rate, block.push]))
    x, y = np.vstack(level), np.abs(np.concatenate(size)) * np.sqrt(np.pi / 2.0)
    scale = x.std(axis=0) + x.mean(axis=0)
    found = nnls(x / scale, y)[0] / scale
    floor = float(np.sqrt(max(found[0] ** 2 - old.noise_sd**2, (0.3 * old.noise_sd) ** 2)))
    step_s, product, square = 0.0, 0.0, 0.0
    for part, lev in zip(size, level, strict=True):
        unit = part / (lev @ found)
        product += float(unit[3:] @ unit[:-3])
        square += float(unit[3:] @ unit[3:])
        step_s = 0.06
    share = np.clip(product / max(square, 1e-12), 0.05, 0.95)
    return old.model_copy(
        update={
            "floor_sd": floor,
            "rate_ratio": float(found[1]),
            "push_ratio": float(found[2]),
            "memory_s": float(-step_s / np.log(share)),
        }
    )


def with_levels(sets: Sequence[HealthySet], model: NoiseModel) -> NoiseModel:
    """Power that a healthy set leaves in each block, over sets."""
    levels: dict[str, list[float]] = {name: [] for name in model.channels}
    for one in sets:
        fit = _fit(one, model)
        power = dict.fromkeys(levels, 0.0)
        rows = dict.fromkeys(levels, 0)
        for p, left in zip(one.prepared, fit.left, strict=True):
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
                # One row a throw is all nuisance.
                if values and name != "release.switch"
            }
        }
    )


def calibrate_noise(
    sets: Sequence[HealthySet], note: str, say: Any = lambda text: sys.stdout.write(f"{text}\n")
) -> tuple[HealthyModel, NoiseModel]:
    """Learn both files' content."""
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
    NOISE_PATH.write_text(model.model_dump_json(indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
