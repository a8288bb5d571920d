"""What the planner knows of one mode and pace: reach, scatter of landings and footprints by range."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from bulk.footprint import Footprint, GripRelease, footprint, release_towards, turned
from bulk.material import Material
from machine.conventions import DEFAULT_PACE_RATIO, Array, BoolArray, Mode
from machine.errors import UsageError
from machine.policy_card import PolicyCard
from machine.reach import MIN_RANGE_M, load_reach_ratio, reach_m
from machine.spec import MachineSpec

MISSES_COUNT = 4
SPREADS_COUNT = 1
"""Measured loads that weigh as much as the prediction: two odd misses must not decide; the spread of one load
is that of hundreds of grains."""
LOAD_MISS_M: Final[Mapping[Mode, Mapping[float, tuple[tuple[float, float, float], ...]]]] = {
    Mode.PLANAR: {
        0.0: ((0.0, 0.07, 0.03), (190.0, 0.09, 0.04), (380.0, 0.11, 0.04), (570.0, 0.09, 0.04)),
        1.0: ((0.0, 0.12, 0.02), (190.0, 0.15, 0.04), (380.0, 0.14, 0.05), (570.0, 0.18, 0.05)),
    },
    Mode.SPATIAL: {
        0.0: ((0.0, 0.08, 0.08), (190.0, 0.11, 0.10), (380.0, 0.12, 0.10), (570.0, 0.10, 0.10)),
        1.0: ((0.0, 0.17, 0.13), (190.0, 0.18, 0.14), (380.0, 0.27, 0.14), (570.0, 0.27, 0.15)),
    },
}
"""By mode, pace and mass (kg): root mean square miss downrange and crossrange of loads of gravel. The twin
throws a ball, and does not see how a heavy grab holds a fast arm back. Measured on virtual machines:
`python -m benchmarks.load_scatter`."""
USUAL_RELEASE_S = 3.0
"""From the start of a throw until it lets go, where it is not simulated; about that of both modes."""


class PolicyFolder(NamedTuple):
    """A policy version that loads may be thrown with."""

    folder: Path
    card: PolicyCard


class LandingScatter(NamedTuple):
    """Scatter of landings at a range; downrange and crossrange are taken as independent."""

    range_m: float
    sd_downrange_m: float
    sd_crossrange_m: float


class MeasuredLoad(NamedTuple):
    """A load that was thrown and measured; pairs are downrange and crossrange."""

    range_m: float
    pace_ratio: float
    error_m: tuple[float, float]
    """Of its centre from the target."""
    variance_m2: tuple[float, float]
    """Of the places of its grains about its centre."""


@dataclass(frozen=True)
class ThrowModel:
    """Throws of one policy at one pace with one material."""

    card: PolicyCard
    pace_ratio: float
    release_s: float
    """From the start of a throw until it lets go, mean over the ranges."""
    material: Material
    range_m: Array
    """(N) increasing."""
    landing_variance_m2: Array
    """(N, 2) downrange and crossrange."""
    footprints: tuple[Footprint, ...]
    """One at each range."""

    def reachable(self, range_m: Array, height_m: Array, volume_m3: float) -> BoolArray:
        """Whether targets at ranges and heights (...) can be thrown at with a volume."""
        card = self.card
        farthest = np.full(np.shape(range_m), card.target_range_max_m)
        if card.reach_at_height_m:
            heights, ranges = zip(*card.reach_at_height_m, strict=True)
            farthest = np.minimum(farthest, np.interp(height_m, heights, ranges))
        farthest = farthest * load_reach_ratio(card.mode, self.material.mass_kg(volume_m3))
        is_level = (height_m >= card.target_height_min_m) & (height_m <= card.target_height_max_m)
        return (range_m >= self.nearest_m) & (range_m <= farthest) & is_level

    @property
    def nearest_m(self) -> float:
        """Smallest target range."""
        return max(self.card.target_range_min_m, MIN_RANGE_M[self.card.mode])

    def farthest_m(self, height_m: float, volume_m3: float) -> float:
        """Largest target range at a height with a volume."""
        return reach_m(self.card, height_m, self.material.mass_kg(volume_m3))

    def covariance_m2(self, x_m: Array, y_m: Array) -> Array:
        """(N, 2, 2) of grains about targets (N): landing scatter and footprint together, frame `machine`."""
        ranges, bearing = np.hypot(x_m, y_m), np.arctan2(y_m, x_m)
        total = np.stack([mark.covariance_m2 for mark in self.footprints])
        total = total + self.landing_variance_m2[:, :, None] * np.eye(2)
        local = np.empty((len(ranges), 2, 2))
        for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
            local[:, i, j] = np.interp(ranges, self.range_m, total[:, i, j])
        turns = np.stack([turned(angle) for angle in bearing.tolist()])
        return turns @ local @ turns.transpose(0, 2, 1)

    def spread(self, landing_ratio: Array, grain_ratio: Array) -> "ThrowModel":
        """With variances (2), downrange and crossrange, of landings and grains times ratios.

        Variances keep their course over the range.
        """
        return replace(
            self,
            landing_variance_m2=self.landing_variance_m2 * landing_ratio,
            footprints=tuple(mark.scaled(np.sqrt(grain_ratio)) for mark in self.footprints),
        )

    def grain_variance_m2(self) -> Array:
        """(N, 2) of places of grains about their centre, downrange and crossrange."""
        return np.stack([np.diagonal(mark.covariance_m2) for mark in self.footprints])

    def at_range(self, values: Array, range_m: float) -> Array:
        """(2) of values (N, 2) at the ranges, interpolated."""
        return np.array([np.interp(range_m, self.range_m, values[:, i]) for i in (0, 1)])

    def landing_sd_m(self, range_m: float) -> tuple[float, float]:
        """Standard deviations of landings downrange and crossrange."""
        down, cross = self.at_range(self.landing_variance_m2, range_m).tolist()
        return math.sqrt(down), math.sqrt(cross)

    def footprint_near(self, range_m: float) -> Footprint:
        """Footprint at the nearest range that was simulated."""
        return self.footprints[int(np.abs(self.range_m - range_m).argmin())]


def load_miss_m(mode: Mode, pace_ratio: float, mass_kg: float) -> tuple[float, float]:
    """Root mean square miss to expect of a load, downrange and crossrange; mass 0: the ball."""
    by_pace: list[tuple[float, float]] = []
    for table in LOAD_MISS_M[mode].values():
        masses_kg, along, across = zip(*table, strict=True)
        by_pace.append(
            (
                float(np.interp(mass_kg, masses_kg, along)),
                float(np.interp(mass_kg, masses_kg, across)),
            )
        )
    paces = list(LOAD_MISS_M[mode])
    down, cross = (
        float(np.interp(pace_ratio, paces, column)) for column in zip(*by_pace, strict=True)
    )
    return down, cross


def learned_models(
    models: Sequence[ThrowModel],
    scatter: Mapping[Mode, Sequence[LandingScatter]],
    loads: Mapping[Mode, Sequence[MeasuredLoad]],
) -> tuple[ThrowModel, ...]:
    """Predicted models with the spread that measured throws of their mode showed.

    Args:
        models: predicted.
        scatter: of balls, at whatever pace: compared with what is expected of a ball at the usual one.
        loads: of the same material, compared with the prediction nearest to their pace; others than those of
            a model's own pace count where it has none. The prediction weighs as much as a few of them. Mean
            misses count as scatter.
    """
    learned: list[ThrowModel] = []
    for model in models:
        mode = model.card.mode
        of = [item for item in models if item.card.mode is mode]
        landing, grain = np.ones(2), np.ones(2)
        if scatter.get(mode):
            seen = [(one.sd_downrange_m, one.sd_crossrange_m) for one in scatter[mode]]
            expected = np.square(load_miss_m(mode, DEFAULT_PACE_RATIO, 0.0))
            landing = np.mean(np.square(seen), axis=0) / expected
        if loads.get(mode):
            alike = [(_nearest(of, load.pace_ratio), load) for load in loads[mode]]
            near = [(like, load) for like, load in alike if like is model] or alike
            missed = [
                np.square(load.error_m)
                / (landing * like.at_range(like.landing_variance_m2, load.range_m))
                for like, load in near
            ]
            spread = [
                np.array(load.variance_m2) / like.at_range(like.grain_variance_m2(), load.range_m)
                for like, load in near
            ]
            landing = landing * _with_prediction(missed, MISSES_COUNT)
            grain = _with_prediction(spread, SPREADS_COUNT)
        learned.append(model.spread(landing, grain))
    return tuple(learned)


def _nearest(models: Sequence[ThrowModel], pace_ratio: float) -> ThrowModel:
    return min(models, key=lambda model: abs(model.pace_ratio - pace_ratio))


def _with_prediction(ratios: Sequence[Array], weight_count: int) -> Array:
    """(2) mean of measured over predicted variances; the prediction weighs as much as some of them."""
    return (weight_count + np.sum(ratios, axis=0)) / (weight_count + len(ratios))


def measured_model(
    card: PolicyCard, spec: MachineSpec, material: Material, scatter: Sequence[LandingScatter],
    height_m: float, grab_m3: float, pace_ratio: float = DEFAULT_PACE_RATIO,
    release_s: float = USUAL_RELEASE_S,
) -> ThrowModel:  # fmt: skip
    """Model from measured scatter, with typical releases.

    Raises:
        UsageError: no scatter, or ranges that do not increase.
    """
    ranges = np.array([item.range_m for item in scatter], dtype=np.float64)
    if not ranges.size or (np.diff(ranges) <= 0.0).any():
        raise UsageError("the landing scatter needs one range or more, increasing")
    releases = [release_towards(max(item.range_m, 5.0), height_m) for item in scatter]
    timing = pace_ratio, release_s
    return make_model(card, spec, material, scatter, releases, height_m, grab_m3, timing)


def make_model(
    card: PolicyCard, spec: MachineSpec, material: Material, scatter: Sequence[LandingScatter],
    releases: Sequence[GripRelease], height_m: float, grab_m3: float, timing: tuple[float, float],
) -> ThrowModel:  # fmt: skip
    """Model from scatter and releases at the same ranges, increasing; timing: pace, and release in s."""
    rng = np.random.default_rng(0)
    return ThrowModel(
        card=card,
        pace_ratio=timing[0],
        release_s=timing[1],
        material=material,
        range_m=np.array([item.range_m for item in scatter], dtype=np.float64),
        landing_variance_m2=np.array(
            [(item.sd_downrange_m**2, item.sd_crossrange_m**2) for item in scatter]
        ),
        footprints=tuple(
            footprint(item, height_m, material, grab_m3, spec, rng) for item in releases
        ),
    )
