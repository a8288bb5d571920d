"""How far the gap shrinks: said first, then shown on throws that did not choose the size.

The throws are dealt into three parts. For each part the sizes of the effects are estimated on the other
two; the shrink is predicted there; then the twin profile with those effects is written to disk, read back,
and the part that was left out is simulated from its valve commands to its impact.
"""

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from diagnosis.healthy import HealthyModel, correction
from diagnosis.hypotheses import Hypothesis, Problem, fitted_effects
from diagnosis.residuals import ALL, PreparedThrow
from diagnosis.selection import screen, total, weigh
from diagnosis.verdict import Shrink
from machine.conventions import ACTIVE_COUNT, CONTROL_PERIOD_S, Array, IntArray
from sim_twin.effects import Effect
from sim_twin.profile import TwinProfile, load_profile, save_profile
from sim_twin.replay import ReplayElement, ReplayInput, replay

PART_COUNT = 3
BOOTSTRAP_COUNT = 400
MIN_REMOVABLE_RATIO = 0.1
"""Below this the impact says nothing about the effect; the trajectories are compared instead."""


class Held(NamedTuple):
    """Gaps of N throws, m: before, after with sizes of the other parts, and after as predicted."""

    before_m: Array
    """(N, 2) measured minus twin."""
    after_m: Array
    """(N, 2)"""
    predicted_ratio: float | None


def with_effects(profile: TwinProfile, effects: Sequence[Effect]) -> TwinProfile:
    """The next version of a profile, with these effects added to its own."""
    return profile.model_copy(
        update={
            "effects": (*profile.effects, *effects),
            "version_count": profile.version_count + 1,
        }
    )


def impacts(
    prepared: Sequence[PreparedThrow],
    problem: Problem,
    profile: TwinProfile,
) -> Array:
    """Impacts (N, 2) from the valve commands alone, what every healthy machine is off taken into account.

    The driven joints are simulated from their commands, corrected by the healthy filters, and then move the
    swing, the release and the flight.
    """
    inputs = [p.input for p in prepared]
    alone = replay(
        inputs, [ReplayElement(i) for i in range(len(inputs))], profile, problem.calibration
    )
    moved = [
        _corrected(p, problem.healthy, alone.joint_velocity_rad_m_per_s[i])
        for i, p in enumerate(prepared)
    ]
    elements = [ReplayElement(i, measured_joints=ALL) for i in range(len(inputs))]
    return replay(moved, elements, profile, problem.calibration).impact_m[:, :2]


def _corrected(p: PreparedThrow, healthy: HealthyModel, velocity: Array) -> ReplayInput:
    """The throw with simulated and corrected joint motion in place of the measured one."""
    rows = p.motion.t_s.size
    corrected = velocity[:rows].copy()
    for joint in range(ACTIVE_COUNT):
        corrected[:, joint] += correction(healthy, p.input, p.motion, joint, velocity[:rows, joint])
    travelled = np.cumsum(corrected[1:] * CONTROL_PERIOD_S, axis=0)
    start = p.input.position_rad_m[:1]
    position = np.vstack([start, start + travelled])
    return p.input._replace(position_rad_m=position, velocity_rad_m_per_s=corrected)


def held_out(problem: Problem, hypothesis: Hypothesis, folder: Path) -> Held:
    """Leave every third of the throws out once."""
    count = len(problem.prepared)
    measured = np.stack([p.throw.impact_m[:2] for p in problem.prepared])
    everyone = np.arange(count)
    before = measured - impacts(problem.prepared, problem, problem.profile)
    after = np.full((count, 2), np.nan)
    predicted: list[Array] = []
    for part in range(min(PART_COUNT, count)):
        # Neighbours go to different parts: modes and targets are mixed in each.
        left_out = everyone[everyone % PART_COUNT == part]
        used = np.setdiff1d(everyone, left_out)
        sizes = _sizes(problem, hypothesis, used)
        effects = fitted_effects(problem.layout, hypothesis.members, sizes)
        path = folder / f"part-{part}.profile.json"
        save_profile(with_effects(problem.profile, effects), path)
        profile = load_profile(path)
        gap = measured - impacts(problem.prepared, problem, profile)
        predicted.append(np.stack([before[used], gap[used]], axis=0))
        after[left_out] = gap[left_out]
    pooled = np.concatenate(predicted, axis=1)
    return Held(before, after, _closed(_rms(pooled[0]), _rms(pooled[1]), None))


def _sizes(problem: Problem, hypothesis: Hypothesis, used: IntArray) -> Array:
    data = total([hypothesis.information[int(i)] for i in used])
    base = screen(data, problem.layout.priors)
    return weigh(base, problem.layout.priors, hypothesis.members).mean


def _rms(gap: Array) -> float:
    good = np.isfinite(gap).all(axis=-1)
    return float(np.sqrt((gap[good] ** 2).sum(axis=-1).mean())) if good.any() else float("nan")


def _closed(before: float, after: float, floor: float | None) -> float:
    """Share of the gap above the floor that is gone."""
    base = 0.0 if floor is None else floor
    return (before - after) / max(before - base, 1e-9)


def shrink(problem: Problem, hypothesis: Hypothesis, floor_m: float = 0.0) -> Shrink | None:
    """The realised shrink with a paired bootstrap over throws; None without impacts.

    Args:
        problem: the set.
        hypothesis: what was found.
        floor_m: gap that noise and jitter leave, root mean square.
    """
    with TemporaryDirectory(prefix="downrange-shrink-") as name:
        held = held_out(problem, hypothesis, Path(name))
    good = np.isfinite(held.before_m).all(axis=1) & np.isfinite(held.after_m).all(axis=1)
    before, after = held.before_m[good], held.after_m[good]
    if before.shape[0] < PART_COUNT:
        return None
    floor = min(floor_m, _rms(after), 0.999 * _rms(before))
    removable = 1.0 - floor / _rms(before)
    rng = np.random.default_rng(0)
    rows = rng.integers(0, before.shape[0], (BOOTSTRAP_COUNT, before.shape[0]))
    drawn = [
        _closed(_rms(before[r]), _rms(after[r]), min(floor, 0.999 * _rms(before[r]))) for r in rows
    ]
    low, high = np.quantile(drawn, (0.05, 0.95))
    predicted = held.predicted_ratio
    return Shrink(
        predicted_ratio=None if predicted is None else predicted / max(removable, 1e-9),
        before_m=_rms(before),
        after_m=_rms(after),
        ratio=_closed(_rms(before), _rms(after), floor),
        ci90=(float(low), float(high)),
        held_out_throws=int(before.shape[0]),
        removable_ratio=removable,
    )
