"""Paths of balls in the air under gravity, drag, wind and lift, many at a time.

Axes are x, y, z (z up), or fewer of them; a leaning vertical and a wrong length scale belong to the path.
"""

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from machine.conventions import GRAVITY_M_PER_S2, Array

CRISIS_WIDTH_M_PER_S: Final = 1.5
"""A smooth sphere's drag falls within about a sixth of its critical speed (Achenbach 1972)."""
MOST_DRAG_PER_STEP: Final = 0.5
"""Of the speed: more than that no step takes away, whatever the fit tries, or the path would blow up."""


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
    axes = start.shape[1]
    step_s = float(grid_s[1])
    push = _push_of(speed, values, drag_per_m, MOST_DRAG_PER_STEP / step_s)
    path = np.empty((len(grid_s), axes, len(start)))
    p, v = start.T.copy(), speed.T.copy()
    for index in range(len(grid_s)):
        path[index] = p
        a = push(v)
        ahead = v + step_s * a
        p = p + 0.5 * step_s * (v + ahead)
        v = v + 0.5 * step_s * (a + push(ahead))
    return path.transpose(0, 2, 1)


def _push_of(
    speed: Array, values: Mapping[str, Array], drag_per_m: float, most_per_s: float
) -> Callable[[Array], Array]:
    """Acceleration over velocity, both (axes, particles).

    `speed` at the start gives the axis of the spin; drag and lift change the velocity by at most
    `most_per_s` of it.
    """
    count, axes = speed.shape

    def value(name: str) -> Array | None:
        return values[name][:, 0] if name in values else None

    # A wrong length scale s shows as gravity s g; the true motion is 1 / s of the one seen.
    fall = values["gravity"][:, 0]
    scale = fall / GRAVITY_M_PER_S2
    gravity = np.stack(
        [*(fall * values[f"lean{axis}"][:, 0] for axis in range(axes - 1)), -np.ones(count) * fall]
    )
    k = value("air_drag.extra_drag_coefficient_ratio")
    k = value("air_drag.drag_per_m") if k is None else k
    k = None if k is None else k * drag_per_m / scale
    wind = None
    if (along := value("wind.x_m_per_s")) is not None:
        wind = np.zeros((axes, count))
        wind[0] = scale * along
        if axes == 3:
            wind[1] = scale * values["wind.y_m_per_s"][:, 0]
    critical = value("drag_crisis.critical_speed_m_per_s")
    above = values["drag_crisis.above_ratio"][:, 0] if critical is not None else None
    spin, fastest = None, np.zeros(count)
    if (back := value("release_spin.backspin_lift_per_m")) is not None:
        side = values["release_spin.sidespin_lift_per_m"][:, 0] if axes == 3 else np.zeros(count)
        spin = _spin_axes(speed, (back / scale)[:, None], (side / scale)[:, None]).T
        fastest = most_per_s / np.maximum(np.hypot(back, side) / scale, 1e-9)

    def push(v: Array) -> Array:
        a = gravity
        if k is not None:
            relative = v if wind is None else v - wind
            fast = np.sqrt(np.einsum("ij,ij->j", relative, relative))
            drag = k * fast
            if critical is not None and above is not None:
                falling = 0.5 - 0.5 * np.tanh(0.5 * (fast - critical) / CRISIS_WIDTH_M_PER_S)
                drag = drag * (above + (1.0 - above) * falling)
            a = a - np.minimum(drag, most_per_s) * relative
        if spin is None:
            return a
        # Lift along the ground speed: otherwise wind without drag could bend a flight through its spin.
        fast = np.sqrt(np.einsum("ij,ij->j", v, v))
        return a + np.minimum(fast, fastest) * _lift(spin, v)

    return push


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


def _lift(axis: Array, v: Array) -> Array:
    """Magnus direction axis x velocity, per unit of speed, in the axes at hand; (axes, particles) each."""
    if len(v) == 2:
        return np.stack([axis[1] * v[1], -axis[1] * v[0]])
    x, y, z = v
    return np.stack(
        [axis[1] * z - axis[2] * y, axis[2] * x - axis[0] * z, axis[0] * y - axis[1] * x]
    )
