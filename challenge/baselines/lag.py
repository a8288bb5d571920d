"""Baseline: cross-correlation lag and root mean square error of every channel, the largest one named.

It does what SAGE and vendors' alignment tools do: the twin throws from the valve commands alone, and each
channel is compared. There a person reads the table; here fixed rules do.
"""

from collections.abc import Sequence

import numpy as np

from challenge.baselines.baseline_case import (
    Candidate,
    Case,
    Errors,
    conclude,
    open_case,
    run_twin,
    throw_errors,
)
from diagnosis.loading.throw_data import LoadedSet
from diagnosis.verdict import Diagnosis
from machine.conventions import ACTIVE_JOINTS, CONTROL_PERIOD_S, Array
from sim_twin.effects.effect import Effect
from sim_twin.effects.table import EFFECTS
from sim_twin.twin.profile import TwinProfile

MAX_LAG_TICKS = 30
LEAST_MOTION_RAD_M_PER_S = 0.05
HEALTHY_LAG_S = (0.028, 0.009, 0.009, 0.006)
HEALTHY_GAIN_RATIO = (0.065, 0.155, 0.144, 0.064)
HEALTHY_GYRO_RAD_PER_S = 0.36
HEALTHY_RELEASE_S = 0.013
HEALTHY_ALONG_M = 0.53
HEALTHY_ACROSS_M = 0.37
"""Largest values of healthy machines, per driven joint where there are four; larger ones are named."""


def lag_rmse(loaded: LoadedSet, profile: TwinProfile) -> Diagnosis:
    """Rank channels by lag, gain error and RMSE relative to healthy machines."""
    refused = loaded.too_few()
    if refused is not None:
        return refused
    case = open_case(loaded, profile)
    rows = np.arange(len(case.prepared))
    output = run_twin(case, rows, [()])
    errors = [throw_errors(case, int(row), output, int(row)) for row in rows]
    ranked = [
        *_joints([errors[int(i)] for i in case.train]),
        *_others(case, [errors[int(i)] for i in case.train]),
    ]
    best = max(ranked, key=lambda c: c.score)
    sizes = {name: value for name, (value, _) in best.sizes.items()}
    effects = (_clipped(best.effect, best.joint, sizes),)
    return conclude(case, ranked, effects)


def _clipped(effect: str, joint: str | None, sizes: dict[str, float]) -> Effect:
    bounds = {p.name: (p.low, p.high) for p in EFFECTS[effect].parameters}
    return Effect(
        effect=effect,
        joint=joint,
        parameters={n: float(np.clip(v, *bounds[n])) for n, v in sizes.items()},
    )


def _joints(errors: Sequence[Errors]) -> list[Candidate]:
    """Lag and gain of every joint that moved."""
    found: list[Candidate] = []
    for joint, name in enumerate(ACTIVE_JOINTS):
        lags, gains = [], []
        for each in errors:
            twin = each.twin_velocity[:, joint]
            real = twin + each.velocity[:, joint]
            if np.abs(twin).max(initial=0.0) < LEAST_MOTION_RAD_M_PER_S:
                continue
            lag = lag_ticks(twin, real)
            lags.append(lag * CONTROL_PERIOD_S)
            moved = np.roll(twin, lag)
            gains.append(float(moved @ real / max(moved @ moved, 1e-9)) - 1.0)
        if len(lags) < 2:
            continue
        late, error = _mean(lags)
        sizes = {"extra_dead_time_s": (late, error)}
        found.append(Candidate("valve_dead_time", name, sizes, abs(late) / HEALTHY_LAG_S[joint]))
        gain, error = _mean(gains)
        both = {"positive_ratio": (gain, error), "negative_ratio": (gain, error)}
        found.append(Candidate("valve_gain", name, both, abs(gain) / HEALTHY_GAIN_RATIO[joint]))
    return found


def _others(case: Case, errors: Sequence[Errors]) -> list[Candidate]:
    """Gyro, release and impact, each attributed to its most common cause."""
    gyro = float(np.sqrt(np.mean([np.mean(e.gyro**2) for e in errors])))
    late, late_sd = _mean([e.release_s for e in errors])
    target = np.stack([case.prepared[int(i)].throw.target_m[:2] for i in case.train])
    unit = target / np.linalg.norm(target, axis=1, keepdims=True)
    miss = np.stack([e.impact_m for e in errors])
    along, along_sd = _mean((miss * unit).sum(axis=1))
    across, across_sd = _mean(miss[:, 1] * unit[:, 0] - miss[:, 0] * unit[:, 1])
    reach = float(np.linalg.norm(target, axis=1).mean())
    return [
        Candidate(
            "passive_viscous_friction",
            None,
            {"extra_viscous_per_s": (0.1, 0.1)},
            gyro / HEALTHY_GYRO_RAD_PER_S,
        ),
        Candidate(
            "release_delay", None, {"extra_delay_s": (late, late_sd)}, abs(late) / HEALTHY_RELEASE_S
        ),
        Candidate(
            "air_drag",
            None,
            {"extra_drag_coefficient_ratio": (-4.0 * along, 4.0 * along_sd)},
            abs(along) / HEALTHY_ALONG_M,
        ),
        Candidate(
            "base_yaw_drift",
            None,
            {"yaw_rad": (across / reach, across_sd / reach)},
            abs(across) / HEALTHY_ACROSS_M,
        ),
    ]


def lag_ticks(twin: Array, real: Array) -> int:
    """Shift of `twin` (T,) at which it correlates best with `real` (T,); positive = real is later."""
    a, b = twin - twin.mean(), real - real.mean()
    whole = np.correlate(b, a, mode="full")
    middle = a.size - 1
    reach = min(MAX_LAG_TICKS, middle)
    return int(np.argmax(whole[middle - reach : middle + reach + 1])) - reach


def _mean(values: Sequence[float] | Array) -> tuple[float, float]:
    """Mean and its standard error, NaN left out."""
    good = np.asarray(values, dtype=np.float64)
    good = good[np.isfinite(good)]
    if good.size < 2:
        return 0.0, 0.0
    return float(good.mean()), float(good.std(ddof=1) / np.sqrt(good.size))
