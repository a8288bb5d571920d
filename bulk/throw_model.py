"""What the planner knows of the throws: reach, scatter of landings and footprints by range."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from bulk.footprint import Footprint, GripRelease, footprint, release_towards, turned
from bulk.material import Material
from machine.conventions import Array, BoolArray
from machine.errors import UsageError
from machine.policy_card import PolicyCard
from machine.reach import MIN_RANGE_M, load_reach_ratio, reach_m
from machine.spec import MachineSpec

PREDICTED_COUNT = 4
"""Measured loads that weigh as much as the prediction: enough that two odd ones do not decide."""


class LandingScatter(NamedTuple):
    """Scatter of landings at a range; downrange and crossrange are taken as independent."""

    range_m: float
    sd_downrange_m: float
    sd_crossrange_m: float


class MeasuredLoad(NamedTuple):
    """A load that was thrown and measured; pairs are downrange and crossrange."""

    range_m: float
    error_m: tuple[float, float]
    """Of its centre from the target."""
    variance_m2: tuple[float, float]
    """Of the places of its grains about its centre."""


@dataclass(frozen=True)
class ThrowModel:
    """Throws of one policy with one material."""

    card: PolicyCard
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

    def learned(self, loads: Sequence[MeasuredLoad]) -> "ThrowModel":
        """With the spread that loads of the same material showed; the prediction weighs as much as a few.

        Variances keep their course over the range. Mean misses count as scatter.
        """
        if not loads:
            return self
        ranges = [load.range_m for load in loads]
        grains = np.stack([np.diagonal(mark.covariance_m2) for mark in self.footprints])
        landing = self._growth(
            ranges, self.landing_variance_m2, [load.error_m for load in loads], 2
        )
        grain = self._growth(ranges, grains, [load.variance_m2 for load in loads], 1)
        return replace(
            self,
            landing_variance_m2=self.landing_variance_m2 * landing,
            footprints=tuple(mark.scaled(np.sqrt(grain)) for mark in self.footprints),
        )

    def _growth(
        self, ranges: list[float], predicted: Array, measured: list[tuple[float, float]], power: int
    ) -> Array:
        """(2) ratios of measured over predicted (N, 2) variances, with the weight of the prediction."""
        expected = np.stack([np.interp(ranges, self.range_m, predicted[:, i]) for i in (0, 1)], -1)
        ratios = np.array(measured) ** power / expected
        return (PREDICTED_COUNT + ratios.sum(axis=0)) / (PREDICTED_COUNT + len(ratios))

    def landing_sd_m(self, range_m: float) -> tuple[float, float]:
        """Standard deviations of landings downrange and crossrange."""
        down, cross = (
            np.interp(range_m, self.range_m, self.landing_variance_m2[:, i]) for i in (0, 1)
        )
        return math.sqrt(float(down)), math.sqrt(float(cross))

    def footprint_near(self, range_m: float) -> Footprint:
        """Footprint at the nearest range that was simulated."""
        return self.footprints[int(np.abs(self.range_m - range_m).argmin())]


def measured_model(
    card: PolicyCard, spec: MachineSpec, material: Material, scatter: Sequence[LandingScatter],
    height_m: float, grab_m3: float,
) -> ThrowModel:  # fmt: skip
    """Model from measured scatter, with typical releases.

    Raises:
        UsageError: no scatter, or ranges that do not increase.
    """
    ranges = np.array([item.range_m for item in scatter], dtype=np.float64)
    if not ranges.size or (np.diff(ranges) <= 0.0).any():
        raise UsageError("the landing scatter needs one range or more, increasing")
    releases = [release_towards(max(item.range_m, 5.0), height_m) for item in scatter]
    return make_model(card, spec, material, scatter, releases, height_m, grab_m3)


def make_model(
    card: PolicyCard, spec: MachineSpec, material: Material, scatter: Sequence[LandingScatter],
    releases: Sequence[GripRelease], height_m: float, grab_m3: float,
) -> ThrowModel:  # fmt: skip
    """Model from scatter and releases at the same ranges, increasing."""
    rng = np.random.default_rng(0)
    return ThrowModel(
        card=card,
        material=material,
        range_m=np.array([item.range_m for item in scatter], dtype=np.float64),
        landing_variance_m2=np.array(
            [(item.sd_downrange_m**2, item.sd_crossrange_m**2) for item in scatter]
        ),
        footprints=tuple(
            footprint(item, height_m, material, grab_m3, spec, rng) for item in releases
        ),
    )
