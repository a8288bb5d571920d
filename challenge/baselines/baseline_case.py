"""What the baselines share: a split of the throws, open-loop runs of the twin, and the form of an answer.

A baseline takes no stage as measured, has no calibrated noise, and never answers "unknown".
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from diagnosis.loading.prepared import PreparedThrow, prepare
from diagnosis.loading.throw_data import LoadedSet
from diagnosis.verdict import (
    Cause,
    Diagnosis,
    FittedEffect,
    FittedParameter,
    Gap,
    Shrink,
    VerdictKind,
)
from machine.calibration import ValveCalibration
from machine.conventions import CONTROL_PERIOD_S, Array, IntArray
from sim_twin.effects.effect import Effect
from sim_twin.effects.table import EFFECTS
from sim_twin.replay.replay import ReplayElement, ReplayOutput, replay
from sim_twin.twin.profile import TwinProfile

HELD_OUT_EVERY = 3
BOOTSTRAP_COUNT = 200
GYRO_SD_RAD_PER_S = 0.02
POSITION_SD_RAD_M = 0.005
IMPACT_SD_M = 0.03
"""Scale of a relevant error of each kind of channel; a baseline has no other noise model."""


class Case(NamedTuple):
    """A set of throws as the baselines see it."""

    prepared: list[PreparedThrow]
    profile: TwinProfile
    calibration: ValveCalibration
    train: IntArray
    test: IntArray
    impact_m: Array
    """(N, 2)"""


def open_case(loaded: LoadedSet, profile: TwinProfile) -> Case:
    """Prepare the throws; every third one is held out to measure how much of the gap is removed."""
    prepared = prepare(loaded.throws, profile)
    rows = np.arange(len(prepared))
    return Case(
        prepared,
        profile,
        loaded.throws[0].calibration,
        rows[rows % HELD_OUT_EVERY != 0],
        rows[rows % HELD_OUT_EVERY == 0],
        np.stack([p.throw.impact_m[:2] for p in prepared]),
    )


def run_twin(case: Case, rows: IntArray, effects: Sequence[tuple[Effect, ...]]) -> ReplayOutput:
    """Simulate throws `rows` open loop from their valve commands, once for each set of effects."""
    inputs = [case.prepared[int(i)].input for i in rows]
    elements = [ReplayElement(i, each) for each in effects for i in range(len(inputs))]
    return replay(inputs, elements, case.profile, case.calibration)


class Errors(NamedTuple):
    """Measured minus twin of one throw."""

    position: Array
    """(T, 4)"""
    velocity: Array
    """(T, 4)"""
    twin_velocity: Array
    """(T, 4)"""
    gyro: Array
    """(T, 3)"""
    release_s: float
    impact_m: Array
    """(2,)"""


def throw_errors(case: Case, row: int, output: ReplayOutput, element: int) -> Errors:
    """Errors of an element against its throw, up to the opening."""
    prepared = case.prepared[row]
    data, throw = prepared.input, prepared.throw
    ticks = data.valve_ratio.shape[0]
    opening = data.opening_t_s
    until = ticks if not np.isfinite(opening) else min(round(opening / CONTROL_PERIOD_S), ticks)
    at_s = np.arange(until) * CONTROL_PERIOD_S
    gyro = np.stack(
        [np.interp(at_s, throw.imu_t_s, throw.gyro_rad_per_s[:, axis]) for axis in range(3)], 1
    )
    twin_velocity = output.joint_velocity_rad_m_per_s[element, :until]
    return Errors(
        data.position_rad_m[:until] - output.joint_position_rad_m[element, :until],
        data.velocity_rad_m_per_s[:until] - twin_velocity,
        twin_velocity,
        gyro - output.gyro_rad_per_s[element, :until],
        opening - float(output.release_t_s[element]),
        case.impact_m[row] - output.impact_m[element, :2],
    )


def shrink_of(case: Case, effects: tuple[Effect, ...]) -> Shrink | None:
    """Impact gap of the held-out throws before and after; the prediction is that of the training throws."""
    before = case.impact_m - run_twin(case, np.arange(len(case.prepared)), [()]).impact_m[:, :2]
    after = case.impact_m - run_twin(case, np.arange(len(case.prepared)), [effects]).impact_m[:, :2]

    def closed(rows: IntArray) -> float:
        good = rows[np.isfinite(before[rows] + after[rows]).all(axis=1)]
        return 1.0 - _rms(after[good]) / max(_rms(before[good]), 1e-9)

    good = case.test[np.isfinite(before[case.test] + after[case.test]).all(axis=1)]
    if good.size < 2:
        return None
    rng = np.random.default_rng(0)
    drawn = [closed(good[rng.integers(0, good.size, good.size)]) for _ in range(BOOTSTRAP_COUNT)]
    low, high = np.quantile(drawn, (0.05, 0.95))
    return Shrink(
        predicted_ratio=closed(case.train),
        before_m=_rms(before[good]),
        after_m=_rms(after[good]),
        ratio=closed(good),
        ci90=(float(low), float(high)),
        held_out_throws=int(good.size),
        removable_ratio=1.0,
    )


def _rms(gap: Array) -> float:
    return float(np.sqrt((gap**2).sum(axis=-1).mean())) if gap.size else float("nan")


class Candidate(NamedTuple):
    """A cause that a baseline ranks."""

    effect: str
    joint: str | None
    sizes: Mapping[str, tuple[float, float]]
    """Value and standard error of each parameter."""
    score: float
    """Against its threshold: above 1 it is claimed."""


def conclude(case: Case, ranked: Sequence[Candidate], all_effects: tuple[Effect, ...]) -> Diagnosis:
    """Name the best candidate above its threshold, or none; probabilities follow the squared scores."""
    ordered = sorted(ranked, key=lambda c: -c.score)
    weights = np.array([1.0, *(c.score**2 for c in ordered)])
    shares = np.minimum(weights / weights.sum(), 1.0)
    causes = [Cause(effects=(), probability=float(shares[0]), name="none")]
    for candidate, share in zip(ordered[:8], shares[1:9], strict=False):
        fitted = FittedEffect(
            effect=candidate.effect,
            joint=candidate.joint,
            parameters={
                name: FittedParameter(value=v, ci90=(v - 1.645 * sd, v + 1.645 * sd), unit="")
                for name, (v, sd) in candidate.sizes.items()
            },
        )
        text = " ".join(part for part in (candidate.effect, candidate.joint) if part)
        causes.append(Cause(effects=(fitted,), probability=float(share), name=text))
    causes.sort(key=lambda cause: -cause.probability)
    claimed = bool(ordered) and ordered[0].score > 1.0
    stage = EFFECTS[ordered[0].effect].stage if claimed else None
    return Diagnosis(
        verdict=VerdictKind.EXPLAINED if claimed else VerdictKind.NONE,
        gap=Gap(),
        causes=tuple(causes),
        shrink=shrink_of(case, all_effects) if claimed and all_effects else None,
        evidence={"where": {"stage": stage, "joint": ordered[0].joint}} if claimed else {},
    )
