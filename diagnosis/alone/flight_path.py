"""Paths of balls in the air under gravity, drag, wind and lift, many at a time.

Axes are x, y, z (z up), or fewer of them; a leaning vertical and a wrong length scale belong to the path.
"""

from collections.abc import Mapping
from typing import Final

import numpy as np

from machine.conventions import GRAVITY_M_PER_S2, Array

CRISIS_WIDTH_M_PER_S: Final = 1.5
"""A smooth sphere's drag falls within about a sixth of its critical speed (Achenbach 1972)."""


def sampled(path: Array, step_s: float, time_s: Array) -> Array:
    """Linear interpolation of paths (steps, sets, axes) at times (sets, rows); (sets, rows, axes)."""
    index = np.minimum((time_s / step_s).astype(np.int64), len(path) - 2)
    share = (time_s / step_s - index)[..., None]
    sets = np.arange(path.shape[1])[:, None]
    return path[index, sets] * (1.0 - share) + path[index + 1, sets] * share


def integrate(
    start: Array, speed: Array, grid_s: Array, values: Mapping[str, Array], drag_per_m: float
) -> Array:
    """Paths of particles, (steps, particles, axes), by Heun's method; `values` are (particles, 1)."""
    count, axes = start.shape
    nothing = np.zeros((count, 1))
    k = values.get(
        "air_drag.extra_drag_coefficient_ratio", values.get("air_drag.drag_per_m", nothing)
    )
    # A wrong length scale s shows as gravity s g; the true motion is 1 / s of the one seen.
    scale = values["gravity"] / GRAVITY_M_PER_S2
    k = k * drag_per_m / scale
    wind = np.zeros((count, axes))
    if axes >= 2:
        wind[:, :1] = scale * values.get("wind.x_m_per_s", nothing)
    if axes == 3:
        wind[:, 1:2] = scale * values.get("wind.y_m_per_s", nothing)
    critical = values.get("drag_crisis.critical_speed_m_per_s")
    above = values.get("drag_crisis.above_ratio", nothing)
    back = values.get("release_spin.backspin_lift_per_m")
    gravity = np.zeros((count, axes))
    gravity[:, -1:] = -values["gravity"]
    for axis in range(axes - 1):
        gravity[:, axis : axis + 1] = values["gravity"] * values[f"lean{axis}"]
    spin = None
    if back is not None:
        spin = _spin_axes(
            speed, back / scale, values.get("release_spin.sidespin_lift_per_m", nothing) / scale
        )

    def acceleration(v: Array) -> Array:
        relative = v - wind
        fast = np.sqrt(np.sum(relative * relative, axis=1, keepdims=True))
        drag = k
        if critical is not None:
            falling = 0.5 - 0.5 * np.tanh(0.5 * (fast - critical) / CRISIS_WIDTH_M_PER_S)
            drag = k * (above + (1.0 - above) * falling)
        a = gravity - drag * fast * relative
        if spin is None:
            return a
        # Lift along the ground speed: otherwise wind without drag could bend a flight through its spin.
        return a + np.sqrt(np.sum(v * v, axis=1, keepdims=True)) * _lift(spin, v)

    path = np.empty((len(grid_s), count, axes))
    p, v, step_s = start, speed, float(grid_s[1])
    for index in range(len(grid_s)):
        path[index] = p
        a = acceleration(v)
        ahead = v + step_s * a
        p = p + 0.5 * step_s * (v + ahead)
        v = v + 0.5 * step_s * (a + acceleration(ahead))
    return path


def _spin_axes(speed: Array, back: Array, side: Array) -> Array:
    """Spin axis times lift per metre, (flights, 3): backspin lifts, sidespin turns to the left."""
    count, axes = speed.shape
    full = np.zeros((count, 3))
    full[:, 0] = speed[:, 0]
    if axes == 3:
        full[:, 1] = speed[:, 1]
    ahead = full / np.maximum(np.linalg.norm(full, axis=1, keepdims=True), 1e-9)
    # axis x forward = up, with x forward and z up, for an axis along -y: (y, -x, 0) of the heading.
    right = np.stack([ahead[:, 1], -ahead[:, 0], np.zeros(count)], axis=1)
    return back * right + side * np.array([0.0, 0.0, 1.0])


def _lift(axis: Array, speed: Array) -> Array:
    """Magnus direction axis x velocity, per unit of speed, in the axes at hand."""
    axes = speed.shape[1]
    full = np.zeros((len(speed), 3))
    full[:, 0], full[:, 2] = speed[:, 0], speed[:, -1]
    if axes == 3:
        full[:, 1] = speed[:, 1]
    lifted = np.cross(axis, full)
    return lifted if axes == 3 else lifted[:, [0, 2]]
