"""Flight of released loads with quadratic drag, wind and spin, to a horizontal plane; batched.

Equation of motion (frame `machine`, z up): a = -g e_z - k |u| u + |u| (l x u), u = v - w, with
k = rho Cd pi r^2 / (2 m) and, for a spinning load, l = rho C_L pi r^2 / (2 m) along its spin, with
C_L = S / (0.4 + 2.32 S), S = r w / |u| (A. M. Nathan, Am. J. Phys. 76, 119, 2008: fit to baseballs).
Classical fourth-order Runge-Kutta with steps of 10 ms; the crossing of the plane is interpolated with the
cubic through both ends of the last step (error below 1 mm).
"""

from typing import NamedTuple

import numpy as np

from machine.conventions import GRAVITY_M_PER_S2, Array, IntArray
from machine.spec import Ball

STEP_S = 0.01
MAX_FLIGHT_S = 6.0
LIFT_OFFSET_RATIO = 0.4
LIFT_SLOPE_RATIO = 2.32


class Landing(NamedTuple):
    """Crossing of the plane: position (..., 3) m, velocity (..., 3) m/s, time (...) s.

    All NaN for a load that does not fall through the plane within 6 s.
    """

    position_m: Array
    velocity_m_per_s: Array
    time_s: Array


class Spin(NamedTuple):
    """Spin of loads in flight, constant over a flight."""

    surface_m_per_s: Array
    """(..., 3) r w along the axis."""
    air_per_m: Array
    """(...) rho pi r^2 / (2 m)."""

    def of(self, rows: IntArray) -> "Spin":
        """Spin of the given loads."""
        return Spin(self.surface_m_per_s[rows], self.air_per_m[rows])

    def lift_per_m(self, speed_m_per_s: Array) -> Array:
        """Vector l (..., 3) of the equation of motion at air speeds (..., 1)."""
        surface = np.sqrt(np.add.reduce(self.surface_m_per_s**2, axis=-1, keepdims=True))
        slowness = LIFT_OFFSET_RATIO * speed_m_per_s + LIFT_SLOPE_RATIO * surface
        return self.air_per_m[..., None] * self.surface_m_per_s / np.maximum(slowness, 1e-9)


def drag_per_m(ball: Ball) -> float:
    """Return k = rho Cd A / (2 m), 1/m."""
    area_m2 = np.pi * ball.radius_m**2
    return ball.air_density_kg_per_m3 * ball.drag_coefficient_ratio * area_m2 / (2.0 * ball.mass_kg)


def acceleration(
    velocity_m_per_s: Array,
    drag_per_m: Array | float,
    wind_m_per_s: Array,
    spin: Spin | None = None,
) -> Array:
    """Acceleration (..., 3) of the load at a velocity (..., 3), m/s^2."""
    relative = velocity_m_per_s - wind_m_per_s
    speed = np.sqrt(np.add.reduce(relative * relative, axis=-1, keepdims=True))
    result = -np.asarray(drag_per_m)[..., None] * speed * relative
    result[..., 2] -= GRAVITY_M_PER_S2
    if spin is not None:
        result += speed * np.cross(spin.lift_per_m(speed), relative)
    return result


def step_flight(
    position_m: Array,
    velocity_m_per_s: Array,
    drag_per_m: Array | float,
    wind_m_per_s: Array,
    step_s: Array | float = STEP_S,
    spin: Spin | None = None,
) -> tuple[Array, Array]:
    """One Runge-Kutta step of the flight; shapes (..., 3)."""
    h = np.asarray(step_s)[..., None]
    half = 0.5 * h
    v1 = velocity_m_per_s
    a1 = acceleration(v1, drag_per_m, wind_m_per_s, spin)
    v2 = v1 + half * a1
    a2 = acceleration(v2, drag_per_m, wind_m_per_s, spin)
    v3 = v1 + half * a2
    a3 = acceleration(v3, drag_per_m, wind_m_per_s, spin)
    v4 = v1 + h * a3
    a4 = acceleration(v4, drag_per_m, wind_m_per_s, spin)
    sixth = h / 6.0
    position = position_m + sixth * (v1 + 2.0 * v2 + 2.0 * v3 + v4)
    velocity = velocity_m_per_s + sixth * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
    return position, velocity


def landing(
    position_m: Array,
    velocity_m_per_s: Array,
    plane_height_m: Array | float,
    drag_per_m: Array | float,
    wind_m_per_s: Array | None = None,
    spin: Spin | None = None,
) -> Landing:
    """Simulate flights (..., 3) until the loads fall through the plane ``z = plane_height_m``.

    Args:
        position_m: release position, frame `machine`.
        velocity_m_per_s: release velocity.
        plane_height_m: height of the plane for the load's centre.
        drag_per_m: k of the equation of motion; 0 in vacuum.
        wind_m_per_s: wind, same frame; none if omitted.
        spin: spin of all loads (N, 3); none if omitted.
    """
    shape = np.broadcast_shapes(position_m.shape, velocity_m_per_s.shape)
    position = np.broadcast_to(position_m, shape).astype(np.float64).reshape(-1, 3)
    velocity = np.broadcast_to(velocity_m_per_s, shape).astype(np.float64).reshape(-1, 3)
    count = position.shape[0]
    plane = np.broadcast_to(np.asarray(plane_height_m, dtype=np.float64), shape[:-1]).reshape(-1)
    drag = np.broadcast_to(np.asarray(drag_per_m, dtype=np.float64), shape[:-1]).reshape(-1)
    wind = np.zeros(3) if wind_m_per_s is None else wind_m_per_s
    wind = np.broadcast_to(wind, shape).reshape(-1, 3)
    end_position = np.full((count, 3), np.nan)
    end_velocity = np.full((count, 3), np.nan)
    end_time = np.full(count, np.nan)
    # Only loads in flight are stepped.
    flying = np.flatnonzero(np.isfinite(position).all(-1) & np.isfinite(velocity).all(-1))
    for tick in range(int(MAX_FLIGHT_S / STEP_S)):
        if flying.size == 0:
            break
        p0, v0 = position[flying], velocity[flying]
        turn = None if spin is None else spin.of(flying)
        p1, v1 = step_flight(p0, v0, drag[flying], wind[flying], spin=turn)
        down = (p0[:, 2] >= plane[flying]) & (p1[:, 2] < plane[flying])
        if down.any():
            hit = flying[down]
            u = _crossing(p0[down, 2], p1[down, 2], v0[down, 2], v1[down, 2], plane[hit])
            turn = None if spin is None else spin.of(hit)
            end_position[hit], end_velocity[hit] = step_flight(
                p0[down], v0[down], drag[hit], wind[hit], u * STEP_S, turn
            )
            end_time[hit] = (tick + u) * STEP_S
        position[flying], velocity[flying] = p1, v1
        flying = flying[~down]
    return Landing(
        end_position.reshape(shape), end_velocity.reshape(shape), end_time.reshape(shape[:-1])
    )


def _crossing(z0: Array, z1: Array, v0: Array, v1: Array, plane: Array) -> Array:
    """Fraction of a step at which the Hermite cubic through both ends crosses the plane (Newton)."""
    drop = z0 - z1
    u = np.clip(np.where(drop > 0.0, (z0 - plane) / np.where(drop > 0.0, drop, 1.0), 0.0), 0.0, 1.0)
    for _ in range(3):
        h00, h10 = 2 * u**3 - 3 * u**2 + 1, u**3 - 2 * u**2 + u
        h01, h11 = -2 * u**3 + 3 * u**2, u**3 - u**2
        value = h00 * z0 + h10 * STEP_S * v0 + h01 * z1 + h11 * STEP_S * v1 - plane
        slope = (
            (6 * u**2 - 6 * u) * (z0 - z1)
            + (3 * u**2 - 4 * u + 1) * STEP_S * v0
            + (3 * u**2 - 2 * u) * STEP_S * v1
        )
        u = np.clip(u - value / np.where(np.abs(slope) > 1e-12, slope, -1e-12), 0.0, 1.0)
    return u
