"""Bulk material in the virtual machine's grippers: parcels of grains that leave, fly and land on their own.

A load is cut into parcels of equal volume, at random places of the grab. Each leaves with the grip's true
motion at its own moment: discharge through a gap that widens steadily grows with the gap to the power 3/2
(slot orifice). In the air the grains of a parcel shield each other: together they meet the air with at most
the frontal area of the whole cloud, so that a dense load flies nearly as in vacuum and thin clouds as single
grains. Parcels rest where they land. Gap, push of the jaws and differences between grabs are assumed.
"""

from typing import NamedTuple

import numpy as np

from machine.ballistics import step_flight
from machine.conventions import GRAVITY_M_PER_S2, Array, BoolArray, IntArray
from machine.site.solids import Solids, touch_share
from machine.site.thrown_material import ThrownMaterial
from sim_twin.virtual.truth import GripMotion

PARCEL_COUNT = 96
DISCHARGE_S = 0.18
"""From the first to the last parcel; half of the load has left at the release of a ball."""
ORIFICE_POWER = 1.5
JAW_PUSH_M_PER_S = 0.4
"""Largest speed that an opening jaw gives to what lies beside it, along the opening."""
COLLISION_SD_M_PER_S = 0.12
"""Of the velocity from collisions between grains, per axis."""
GRAB_SPREAD_RATIO = 0.08
"""Standard deviation of a grab's true volume over the planned one."""
MEASURED_VOLUME_RATIO = 0.02
"""Standard deviation of the measured volume over the true one."""
AIR_DENSITY_KG_PER_M3 = 1.204
RADIUS_M = 0.01
"""At which a parcel touches: that of a stone."""
HALF_SHARE = 0.5 ** (1.0 / (ORIFICE_POWER + 1.0))
"""Share of the discharge time after which half of a load has left."""


class LandedGrains(NamedTuple):
    """Loads of which the last parcel landed: machines (M,), mean times (M,), centres (M, 3), and spread."""

    which: IntArray
    time_ns: IntArray
    centre_m: Array
    covariance_m2: Array
    """(M, 3) xx, xy, yy."""


class GrainFlight:
    """Parcels (N, P) of the loads of N machines."""

    def __init__(self, material: ThrownMaterial, count: int, rng: np.random.Generator) -> None:
        self._material, self._rng = material, rng
        shape = (count, PARCEL_COUNT)
        self.volume_m3 = np.zeros(count)
        """(N,) true ones."""
        self._after_s = np.zeros(shape)
        self._seat_m = np.zeros((*shape, 3))
        self._push_m_per_s = np.zeros((*shape, 3))
        self._grain_drag_per_m = np.zeros(shape)
        self._grain_area_m2 = np.zeros(count)
        self.left = np.zeros(shape, dtype=np.bool_)
        self.landed = np.zeros(shape, dtype=np.bool_)
        self.position_m = np.full((*shape, 3), np.nan)
        self.velocity_m_per_s = np.full((*shape, 3), np.nan)
        self._time_ns = np.zeros(shape, dtype=np.int64)
        self._land_ns = np.zeros(shape, dtype=np.int64)
        self._reported = np.zeros(count, dtype=np.bool_)
        self.take(np.ones(count, dtype=np.bool_))

    def take(self, which: BoolArray) -> None:
        """Fill the grabs of machines (N,)."""
        material, rng, count = self._material, self._rng, int(which.sum())
        if not count:
            return
        size = (count, PARCEL_COUNT)
        ratio = 1.0 + GRAB_SPREAD_RATIO * np.clip(rng.standard_normal(count), -3.0, 3.0)
        self.volume_m3[which] = material.volume_m3 * ratio
        # As wide as high: places in a cube.
        edge = np.cbrt(self.volume_m3[which])[:, None, None]
        seat = edge * rng.uniform(-0.5, 0.5, (*size, 3))
        self._seat_m[which] = seat
        push = COLLISION_SD_M_PER_S * rng.standard_normal((*size, 3))
        push[..., 1] += JAW_PUSH_M_PER_S * seat[..., 1] / (0.5 * edge[..., 0])
        self._push_m_per_s[which] = push
        share = rng.uniform(0.0, 1.0, size) ** (1.0 / (ORIFICE_POWER + 1.0))
        self._after_s[which] = DISCHARGE_S * (share - HALF_SHARE)
        grain_m = material.grain_diameter_m * np.exp(
            rng.normal(0.0, material.grain_spread_ratio, size)
        )
        face = 0.75 * AIR_DENSITY_KG_PER_M3 * material.drag_coefficient_ratio
        self._grain_drag_per_m[which] = face / (material.grain_density_kg_per_m3 * grain_m)
        # Frontal area of spheres: 3 V / (2 d).
        solid_ratio = material.mass_kg / material.volume_m3 / material.grain_density_kg_per_m3
        solid_m3 = self.volume_m3[which] * solid_ratio
        self._grain_area_m2[which] = 1.5 * solid_m3 * (1.0 / grain_m).mean(axis=1)
        self.left[which] = self.landed[which] = self._reported[which] = False

    def leave(self, release_ns: IntArray, now_ns: int, grip: GripMotion) -> None:
        """Let go of parcels whose moment has come.

        Args:
            release_ns: (N,) release of a ball; far ahead where none is commanded.
            now_ns: until when, at most 2 ms after `grip`.
            grip: its motion.
        """
        after_ns = (self._after_s * 1e9).astype(np.int64)
        # The release may lie so far ahead that a sum with it overflows.
        due = ~self.left & (release_ns[:, None] <= now_ns - after_ns)
        if not due.any():
            return
        row, number = np.nonzero(due)
        turn = grip.rotation[row]
        arm = np.einsum("nij,nj->ni", turn, self._seat_m[row, number])
        velocity = grip.velocity_m_per_s[row] + np.cross(grip.rate_rad_per_s[row], arm)
        due_ns = release_ns[row] + after_ns[due]
        later_s = (due_ns - grip.time_ns)[:, None] * 1e-9
        self.position_m[due] = grip.position_m[row] + arm + velocity * later_s
        push = np.einsum("nij,nj->ni", turn, self._push_m_per_s[row, number])
        self.velocity_m_per_s[due] = velocity + push
        self._time_ns[due] = due_ns
        self.left |= due

    def fly(
        self, now_ns: int, plane_m: Array, wind_m_per_s: Array, solids: Solids | None
    ) -> LandedGrains:
        """Advance parcels in the air to this time, up to solids or planes at heights (N,)."""
        flying = self.left & ~self.landed
        row, _ = np.nonzero(flying)
        step_s: Array = (now_ns - self._time_ns[flying]).astype(np.float64) * 1e-9
        p0, v0, drag = self.position_m[flying], self.velocity_m_per_s[flying], self._drag(flying)
        wind = wind_m_per_s[row]
        p1, v1 = step_flight(p0, v0, drag, wind, step_s)
        if solids is None:
            plane = plane_m[row]
            down = (p1[:, 2] <= plane) & (v1[:, 2] < 0.0)
            above, fall = np.maximum(p0[down, 2] - plane[down], 0.0), v0[down, 2]
            touch_s = (fall + np.sqrt(fall**2 + 2.0 * GRAVITY_M_PER_S2 * above)) / GRAVITY_M_PER_S2
            share = np.minimum(touch_s / step_s[down], 1.0)
        else:
            down = solids.closes(p0, p1, RADIUS_M)

            def gap(share: Array) -> Array:
                at, _ = step_flight(
                    p0[down], v0[down], drag[down], wind[down], share * step_s[down]
                )
                return solids.distance(at) - RADIUS_M

            share = touch_share(gap, int(down.sum()))
        p1[down] = step_flight(p0[down], v0[down], drag[down], wind[down], share * step_s[down])[0]
        self.position_m[flying], self.velocity_m_per_s[flying] = p1, v1
        place = tuple(index[down] for index in np.nonzero(flying))
        self._land_ns[place] = self._time_ns[place] + (share * step_s[down] * 1e9).astype(np.int64)
        self.landed[place] = True
        self._time_ns[flying] = now_ns
        return self._news()

    def held_kg(self) -> Array:
        """(N,) mass that is still in the grippers."""
        material = self._material
        density = material.mass_kg / material.volume_m3
        return density * self.volume_m3 * (1.0 - self.left.mean(axis=1))

    def centre_m(self) -> Array:
        """(N, 3) mean places of the parcels that have left; NaN where none has."""
        count = self.left.sum(axis=1)[:, None]
        total = np.where(self.left[..., None], self.position_m, 0.0).sum(axis=1)
        return np.where(count > 0, total / np.maximum(count, 1), np.nan)

    def measured_volume_m3(self, which: IntArray) -> Array:
        """Volumes (M,) of landed loads as a survey of the ground finds them."""
        error = MEASURED_VOLUME_RATIO * self._rng.standard_normal(which.size)
        return self.volume_m3[which] * (1.0 + error)

    def _drag(self, flying: BoolArray) -> Array:
        """Drags (M,) of flying parcels."""
        weight = flying.sum(axis=1)
        x_m = np.where(flying[..., None], self.position_m, 0.0)
        mean = x_m.sum(axis=1) / np.maximum(weight, 1)[:, None]
        square = np.where(flying[..., None], (x_m - mean[:, None]) ** 2, 0.0).sum(axis=(1, 2))
        # A sphere of radius r has the variance r2 / 5 along each axis.
        cloud_m2 = np.pi * 5.0 * square / (3.0 * np.maximum(weight, 1))
        part = np.maximum(weight, 1) / PARCEL_COUNT
        exposed = np.minimum(1.0, cloud_m2 / (self._grain_area_m2 * part))
        return (self._grain_drag_per_m * exposed[:, None])[flying]

    def _news(self) -> LandedGrains:
        which = np.flatnonzero(self.landed.all(axis=1) & ~self._reported)
        self._reported[which] = True
        places = self.position_m[which]
        centre = places.mean(axis=1)
        away = places - centre[:, None]
        pairs = ((0, 0), (0, 1), (1, 1))
        spread = [(away[..., i] * away[..., j]).mean(axis=1) for i, j in pairs]
        first = self._land_ns[which].min(axis=1, keepdims=True, initial=np.iinfo(np.int64).max)
        later_ns = (self._land_ns[which] - first).mean(axis=1).astype(np.int64)
        return LandedGrains(which, first[:, 0] + later_ns, centre, np.stack(spread, axis=-1))
