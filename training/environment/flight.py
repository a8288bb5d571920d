"""Landing point of a released load, computed in every control step of every environment.

Equation of machine.ballistics (quadratic drag, no wind): eight Runge-Kutta steps over the flight time in
vacuum, then a parabola to the plane. Within 2 mm of machine.ballistics
(tests/training/environment/test_flight.py).
"""

from typing import Any

from machine.conventions import GRAVITY_M_PER_S2
from machine.kinematics import namespace

FLIGHT_STEPS = 8


def landing(
    position_m: Any, velocity_m_per_s: Any, plane_height_m: Any, drag_per_m: Any
) -> tuple[Any, Any, Any]:
    """Landing points and flight times of loads that fall through a plane.

    Args:
        position_m: (N, 3).
        velocity_m_per_s: (N, 3).
        plane_height_m: (N,) target height plus the load's radius.
        drag_per_m: (N,) k of machine.ballistics.

    Returns:
        x (N,), y (N,) in metres and the flight time (N,) in seconds. For a load that never rises to the
        plane, those of its apex.
    """
    xp = namespace(position_m)
    x, y, z = position_m[..., 0], position_m[..., 1], position_m[..., 2]
    vx, vy, vz = velocity_m_per_s[..., 0], velocity_m_per_s[..., 1], velocity_m_per_s[..., 2]
    square = vz * vz + 2.0 * GRAVITY_M_PER_S2 * (z - plane_height_m)
    # A load already below the plane and falling lands at once.
    flight = xp.maximum(vz + xp.sqrt(xp.maximum(square, 0.0)), 0.0) / GRAVITY_M_PER_S2
    h = flight / FLIGHT_STEPS
    for _ in range(FLIGHT_STEPS):
        x, y, z, vx, vy, vz = flight_step(x, y, z, vx, vy, vz, drag_per_m, h)
    _, _, az = _acceleration(vx, vy, vz, drag_per_m)
    root = xp.sqrt(xp.maximum(vz * vz - 2.0 * az * (z - plane_height_m), 0.0))
    rest = xp.where(square < 0.0, 0.0, (-vz - root) / az)
    # Drag lengthens the descent by a few hundredths of a second; the bound guards against invalid input.
    rest = xp.clip(rest, -0.2, 0.2)
    return x + rest * vx, y + rest * vy, flight + rest


def shortfall(position_m: Any, velocity_m_per_s: Any, plane_height_m: Any) -> Any:
    """By how much the apex of loads (N, 3) stays below a plane (N,), m (N,); without drag."""
    xp = namespace(position_m)
    climb = xp.maximum(velocity_m_per_s[..., 2], 0.0)
    highest = position_m[..., 2] + climb * climb / (2.0 * GRAVITY_M_PER_S2)
    return xp.maximum(plane_height_m - highest, 0.0)


def _acceleration(vx: Any, vy: Any, vz: Any, drag_per_m: Any) -> tuple[Any, Any, Any]:
    xp = namespace(vx)
    k = -drag_per_m * xp.sqrt(vx * vx + vy * vy + vz * vz + 1e-12)
    return k * vx, k * vy, k * vz - GRAVITY_M_PER_S2


def flight_step(
    x: Any, y: Any, z: Any, vx: Any, vy: Any, vz: Any, drag_per_m: Any, step_s: Any
) -> tuple[Any, Any, Any, Any, Any, Any]:
    """One classical Runge-Kutta step of the flight; all arguments and results (N,)."""
    h, half = step_s, 0.5 * step_s
    ax1, ay1, az1 = _acceleration(vx, vy, vz, drag_per_m)
    ux2, uy2, uz2 = vx + half * ax1, vy + half * ay1, vz + half * az1
    ax2, ay2, az2 = _acceleration(ux2, uy2, uz2, drag_per_m)
    ux3, uy3, uz3 = vx + half * ax2, vy + half * ay2, vz + half * az2
    ax3, ay3, az3 = _acceleration(ux3, uy3, uz3, drag_per_m)
    ux4, uy4, uz4 = vx + h * ax3, vy + h * ay3, vz + h * az3
    ax4, ay4, az4 = _acceleration(ux4, uy4, uz4, drag_per_m)
    sixth = h / 6.0
    return (
        x + sixth * (vx + 2.0 * (ux2 + ux3) + ux4),
        y + sixth * (vy + 2.0 * (uy2 + uy3) + uy4),
        z + sixth * (vz + 2.0 * (uz2 + uz3) + uz4),
        vx + sixth * (ax1 + 2.0 * (ax2 + ax3) + ax4),
        vy + sixth * (ay1 + 2.0 * (ay2 + ay3) + ay4),
        vz + sixth * (az1 + 2.0 * (az2 + az3) + az4),
    )
