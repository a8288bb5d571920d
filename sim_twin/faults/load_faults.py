"""Faults of the load of the virtual machine: how it is held, let go, and flies.

The flight has a separate integrator (classical Runge-Kutta with drag, gusts and Magnus lift), because the
twin's has no gusts and because the two can then check each other.
"""

from typing import NamedTuple

import numpy as np

from machine.conventions import GRAVITY_M_PER_S2, Array, IntArray
from machine.spec import MachineSpec
from sim_twin.faults.fault import EffectSizes
from sim_twin.virtual.units import MachineUnit, ThrowConditions

SHORTEST_DELAY_S = 0.02
GUST_START_S = (0.1, 0.6)
"""After the first moment of the flight."""
GUST_LENGTH_S = 0.5


class Air(NamedTuple):
    """Constants of the flights of N loads."""

    drag_per_m: Array
    lift_per_m: float
    """rho pi r^2 / (2 m), to be multiplied by the lift coefficient."""
    radius_m: float


class FaultyLoad:
    """Loads of N machines, held, let go and flying."""

    def __init__(self, sizes: EffectSizes, spec: MachineSpec, unit: MachineUnit) -> None:
        self._delay_s = sizes.machine("release_delay", "extra_delay_s")
        self._delay_sd_s = sizes.machine("release_jitter", "extra_sd_s")
        self._offset_m = np.zeros((sizes.count, 3))
        self._offset_m[:, 0] = sizes.machine("payload_offset", "offset_x_m")
        self._offset_m[:, 1] = sizes.machine("payload_offset", "offset_y_m")
        self._kept = 1.0 - sizes.machine("sticky_release", "slowdown_ratio")[:, None]
        self._kick = np.zeros((sizes.count, 3))
        self._kick[:, 0] = sizes.machine("uneven_claw", "kick_x_m_per_s")
        self._kick[:, 1] = sizes.machine("uneven_claw", "kick_y_m_per_s")
        self._spin = sizes.machine("release_spin", "spin_rad_per_s")
        per_area = spec.ball.air_density_kg_per_m3 * np.pi * unit.ball_radius_m**2
        lift = float(per_area / (2.0 * unit.ball_mass_kg))
        coefficient = unit.drag_coefficient_ratio
        coefficient = coefficient + sizes.machine("air_drag", "extra_drag_coefficient_ratio")
        self._air = Air(lift * np.maximum(coefficient, 0.0), lift, unit.ball_radius_m)
        self._wind = np.zeros((sizes.count, 3))
        self._wind[:, 0] = sizes.machine("wind", "x_m_per_s")
        self._wind[:, 1] = sizes.machine("wind", "y_m_per_s")
        self._gust_speed = sizes.machine("gust", "speed_m_per_s")
        self._gust = np.zeros((sizes.count, 3))
        self._gust_start_s = np.zeros(sizes.count)
        self._axis = np.zeros((sizes.count, 3))
        self._flown_s = np.zeros(sizes.count)

    def conditions(self, drawn: ThrowConditions, seed: int) -> ThrowConditions:
        """The conditions of N throws with what these effects change."""
        rng = np.random.default_rng([seed, 0x10AD])
        count = self._delay_s.size
        direction = rng.uniform(-np.pi, np.pi, count)
        self._gust[:, 0] = self._gust_speed * np.cos(direction)
        self._gust[:, 1] = self._gust_speed * np.sin(direction)
        self._gust_start_s = rng.uniform(*GUST_START_S, count)
        jitter = self._delay_sd_s * np.clip(rng.standard_normal(count), -3.0, 3.0)
        delay_s = drawn.release_delay_s + self._delay_s + jitter
        return ThrowConditions(
            flow_ratio=drawn.flow_ratio,
            lag_ratio=drawn.lag_ratio,
            friction_ratio=drawn.friction_ratio,
            dead_time_offset_s=drawn.dead_time_offset_s,
            grasp_offset_m=drawn.grasp_offset_m + self._offset_m,
            slip_m_per_s=drawn.slip_m_per_s,
            release_delay_s=np.maximum(delay_s, SHORTEST_DELAY_S),
            switch_delay_s=drawn.switch_delay_s,
        )

    def let_go(self, which: IntArray, velocity_m_per_s: Array, rotation: Array) -> Array:
        """Velocities (M, 3) of loads of machines (M,) that leave grippers turned by `rotation` (M, 3, 3)."""
        kick = np.einsum("nij,nj->ni", rotation, self._kick[which])
        leaving = self._kept[which] * velocity_m_per_s + kick
        # Backspin turns about the right-hand horizontal: its cross product with the velocity points up.
        level = np.maximum(np.hypot(leaving[:, 0], leaving[:, 1]), 1e-6)
        self._axis[which, 0] = leaving[:, 1] / level
        self._axis[which, 1] = -leaving[:, 0] / level
        self._flown_s[which] = 0.0
        return leaving

    def fly(
        self, which: IntArray, position: Array, velocity: Array, wind: Array, step_s: Array
    ) -> tuple[Array, Array]:
        """Positions and velocities (M, 3) of the loads of machines (M,) one step of flight (M,) later."""
        flown = self._flown_s[which]
        blowing = flown >= self._gust_start_s[which]
        blowing &= flown < self._gust_start_s[which] + GUST_LENGTH_S
        air = wind + self._wind[which] + self._gust[which] * blowing[:, None]
        drag = self._air.drag_per_m[which][:, None]
        axis, spin = self._axis[which], self._spin[which][:, None]

        def pull(v: Array) -> Array:
            relative = v - air
            speed = np.linalg.norm(relative, axis=-1, keepdims=True)
            # C_L = 1 / (2.32 + 0.4 / S), S = r w / v (Nathan, Am. J. Phys. 76, 119, 2008).
            surface = self._air.radius_m * np.abs(spin)
            lift = surface / (2.32 * surface + 0.4 * np.maximum(speed, 1e-6))
            lift = self._air.lift_per_m * np.sign(spin) * lift
            force = -drag * speed * relative + lift * speed * np.cross(axis, relative)
            force[:, 2] -= GRAVITY_M_PER_S2
            return force

        h = step_s[:, None]
        a1 = pull(velocity)
        v2 = velocity + 0.5 * h * a1
        a2 = pull(v2)
        v3 = velocity + 0.5 * h * a2
        a3 = pull(v3)
        v4 = velocity + h * a3
        a4 = pull(v4)
        self._flown_s[which] = flown + step_s
        return (
            position + h / 6.0 * (velocity + 2.0 * v2 + 2.0 * v3 + v4),
            velocity + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4),
        )
