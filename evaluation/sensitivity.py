"""Sensitivity of the landing error: the same throws with one factor changed at a time.

Runs share seed, starts and noise and are compared throw by throw, so that a change of the mean is resolved
far below the scatter (common random numbers).
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict

from machine.conventions import ACTIVE_JOINTS, Array, IntArray
from runtime.control.control_loop import ControlParams
from runtime.driver import SimulatedDriver
from sim_twin.confidence_intervals import Interval, mean_interval
from sim_twin.effects.effect import Effect
from sim_twin.throws.campaign import ThrowOutcome, ThrowResult, run_throws

CONFIDENCE_RATIO = 0.95
EffectPlantMaker = Callable[[int, tuple[Effect, ...]], SimulatedDriver]
"""Makes a number of machines with these effects."""


class Factor(NamedTuple):
    """One factor that is changed, by at least as much as machines of the type differ."""

    name: str
    change: str
    effects: Callable[[float], tuple[Effect, ...]]
    """Effects at the low (-1) or high (+1) level."""


class FactorShift(BaseModel):
    """Change of the mean landing error and of its standard deviation with a factor low and high."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)
    name: str
    change: str
    low_m: float | None = None
    """Mean downrange shift against the unchanged machine, factor low."""
    low_ci95_m: Interval | None = None
    high_m: float | None = None
    high_ci95_m: Interval | None = None
    crossrange_high_m: float | None = None
    crossrange_high_ci95_m: Interval | None = None
    sd_ratio: float | None = None
    """Downrange standard deviation with the factor high over that of the unchanged machine."""
    plain_sd_m: float | None = None
    """Downrange standard deviation of the unchanged machine, the same throws."""
    low_sd_m: float | None = None
    high_sd_m: float | None = None
    pair_count: int
    """Throws that landed in all three runs."""
    failed_count: int
    """Throws that landed on the unchanged machine and not with the factor changed."""


def _one(name: str, parameter: str, value: float) -> Effect:
    return Effect(effect=name, parameters={parameter: value})


def _dead_times(sign: float) -> tuple[Effect, ...]:
    return tuple(
        Effect(effect="valve_dead_time", joint=j, parameters={"extra_dead_time_s": 0.02 * sign})
        for j in ACTIVE_JOINTS
    )


FACTORS: Sequence[Factor] = (
    Factor("release delay", "15 ms (the paper's scatter of one opening)",
           lambda s: (_one("release_delay", "extra_delay_s", 0.015 * s),)),
    Factor("dead time, all joints", "20 ms", _dead_times),
    Factor("friction of the free joints", "half of it (0.015 1/s, 0.05 rad/s2)",
           lambda s: (_one("passive_viscous_friction", "extra_viscous_per_s", 0.015 * s),
                      _one("passive_coulomb_friction", "extra_coulomb_rad_per_s2", 0.05 * s))),
    Factor("payload mass", "0.3 kg",
           lambda s: (_one("payload_mass", "extra_mass_kg", 0.3 * s),)),
)  # fmt: skip


class PairedErrors(NamedTuple):
    """Errors of throws that landed in all runs, shape (runs, pairs), m, frame `throw`."""

    downrange_m: Array
    crossrange_m: Array
    failed_count: IntArray
    """(runs,) throws that landed in the first run and not in this one."""
    any_failed_count: int
    """Throws that landed in the first run and not in all others."""


def paired_errors(runs: Sequence[Sequence[ThrowResult]]) -> PairedErrors:
    """Pair runs of the same throws."""
    landed = np.array([[r.outcome is ThrowOutcome.LANDED for r in run] for run in runs])
    both = landed.all(axis=0)
    lost = landed[0] & ~landed
    return PairedErrors(
        np.array([[r.downrange_error_m for r in run] for run in runs])[:, both],
        np.array([[r.crossrange_error_m for r in run] for run in runs])[:, both],
        lost.sum(axis=1),
        int(lost.any(axis=0).sum()),
    )


def measure_sensitivity(
    make: EffectPlantMaker,
    params: ControlParams,
    target_m: Array,
    starts_rad_m: Array,
    seed: int,
    progress: Callable[[int, int], None] | None = None,
) -> list[FactorShift]:
    """Throw at targets (N, 3) from starts (N, 6): unchanged, then with each factor low and high."""
    runs = 1 + 2 * len(FACTORS)

    def throw(effects: tuple[Effect, ...], number: int) -> list[ThrowResult]:
        plant = make(target_m.shape[0], effects)
        try:
            results = run_throws(plant, params, target_m, starts_rad_m, seed)
        finally:
            plant.close()
        if progress is not None:
            progress(number + 1, runs)
        return results

    plain = throw((), 0)
    found: list[FactorShift] = []
    for k, factor in enumerate(FACTORS):
        low = throw(factor.effects(-1.0), 1 + 2 * k)
        high = throw(factor.effects(1.0), 2 + 2 * k)
        found.append(_shift(factor, plain, low, high))
    return found


def _shift(
    factor: Factor,
    plain: Sequence[ThrowResult],
    low: Sequence[ThrowResult],
    high: Sequence[ThrowResult],
) -> FactorShift:
    runs = paired_errors((plain, low, high))
    down, cross = runs.downrange_m, runs.crossrange_m
    values: dict[str, Any] = {}
    if down.shape[1] >= 2:
        shifts = {
            "low": down[1] - down[0],
            "high": down[2] - down[0],
            "crossrange_high": cross[2] - cross[0],
        }
        for name, shift in shifts.items():
            values[f"{name}_m"] = float(shift.mean())
            values[f"{name}_ci95_m"] = mean_interval(shift, CONFIDENCE_RATIO)
        sd = down.std(axis=1, ddof=1)
        values["sd_ratio"] = float(sd[2] / sd[0]) if sd[0] > 0.0 else None
        values |= dict(zip(("plain_sd_m", "low_sd_m", "high_sd_m"), sd.tolist(), strict=True))
    return FactorShift(
        name=factor.name,
        change=f"-/+ {factor.change}",
        pair_count=down.shape[1],
        failed_count=runs.any_failed_count,
        **values,
    )
