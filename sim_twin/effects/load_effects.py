"""Effects on the load from the opening command to the ground, for N machines at once."""

import numpy as np

from machine.conventions import Array, IntArray
from machine.spec import MachineSpec
from sim_twin.effects.arrays import EffectArrays
from sim_twin.effects.body_effects import loaded_mass_kg


class LoadEffects:
    """Effects of the stages `release` and `flight`, and the load's mass in the air."""

    def __init__(self, spec: MachineSpec, arrays: EffectArrays) -> None:
        """Look up what any of the machines has."""
        ball = spec.ball
        self._delay_s = arrays.get("release_delay", "extra_delay_s")
        self._jitter_s = arrays.get("release_jitter", "extra_sd_s")
        self._slowdown = arrays.get("sticky_release", "slowdown_ratio")
        self._drag = arrays.get("air_drag", "extra_drag_coefficient_ratio")
        self._spin = arrays.filled("release_spin", "spin_rad_per_s")
        self.spins = arrays.has("release_spin")
        """Whether any load spins."""
        x, y = (arrays.filled("wind", f"{axis}_m_per_s") for axis in "xy")
        self.wind_m_per_s = np.stack([x, y, np.zeros(arrays.count)], axis=-1)
        """(N, 3) added to the profile's."""
        extra_kg = arrays.filled("payload_mass", "extra_mass_kg")
        self.mass_share = ball.mass_kg / loaded_mass_kg(ball.mass_kg, extra_kg)
        """(N,) nominal mass over true mass: what is left of the air's accelerations."""
        self._radius_m = ball.radius_m
        area_m2 = np.pi * ball.radius_m**2
        air_per_m = ball.air_density_kg_per_m3 * area_m2 / (2.0 * ball.mass_kg)
        self.air_per_m = air_per_m * self.mass_share
        """(N,) rho pi r^2 / (2 m)."""

    def delay(self, mean_s: float, sd_s: float) -> tuple[Array | float, Array | float]:
        """Mean and standard deviation (N,) of the opening's delay."""
        return (
            mean_s if self._delay_s is None else mean_s + self._delay_s,
            sd_s if self._jitter_s is None else np.hypot(sd_s, self._jitter_s),
        )

    def drag_coefficient(self, profile_ratio: float) -> Array | float:
        """Drag coefficients (N,)."""
        return profile_ratio if self._drag is None else np.maximum(profile_ratio + self._drag, 0.0)

    def slowed(self, rows: IntArray, velocity_m_per_s: Array) -> Array:
        """Velocities (K, 3) with which the loads of `rows` leave a grip point of these velocities."""
        if self._slowdown is None:
            return velocity_m_per_s
        return velocity_m_per_s * (1.0 - self._slowdown[rows, None])

    def spin_surface(self, rows: IntArray, velocity_m_per_s: Array) -> Array:
        """Spin of machine.ballistics (K, 3) of loads of `rows` that leave with these velocities, m/s."""
        level = np.maximum(np.hypot(velocity_m_per_s[:, 0], velocity_m_per_s[:, 1]), 1e-6)
        surface = self._radius_m * self._spin[rows] / level
        # Backspin turns about the horizontal axis on the right-hand side of the flight.
        along = [velocity_m_per_s[:, 1], -velocity_m_per_s[:, 0], np.zeros(surface.size)]
        return np.stack([surface * part for part in along], axis=-1)
