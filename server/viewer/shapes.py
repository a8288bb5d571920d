"""Points of what lies on the ground in the view: rings, marks, ellipses. Pure arithmetic.

Line sets have shape (N, 2, 3); meshes are (vertices (V, 3), faces (F, 3)); metres, frame `machine`.
"""

import math

import numpy as np
from numpy.typing import NDArray

from machine.conventions import Array
from machine.messages import LandingEllipse

Mesh = tuple[NDArray[np.float32], NDArray[np.uint32]]
RING_POINTS = 180


def circle(radius_m: float, count: int = RING_POINTS) -> Array:
    """Closed circle in the xy plane, shape (count + 1, 3), z = 0."""
    angle = np.linspace(0.0, 2.0 * np.pi, count + 1)
    return np.stack([radius_m * np.cos(angle), radius_m * np.sin(angle), 0.0 * angle], axis=-1)


def polyline(points_m: Array) -> Array:
    """Join points (N, 3) to segments (N - 1, 2, 3)."""
    return np.stack([points_m[:-1], points_m[1:]], axis=1)


def dashed_circle(radius_m: float, dash_m: float = 0.45) -> Array:
    """Circle of dashes and gaps of about equal length, segments (N, 2, 3)."""
    dashes = max(8, round(2.0 * math.pi * radius_m / (2.0 * dash_m)))
    starts = np.arange(dashes) * (2.0 * np.pi / dashes)
    steps = np.linspace(0.0, np.pi / dashes, 4)
    angle = starts[:, None] + steps[None, :]
    points = np.stack([radius_m * np.cos(angle), radius_m * np.sin(angle), 0.0 * angle], axis=-1)
    return np.stack([points[:, :-1], points[:, 1:]], axis=2).reshape(-1, 2, 3)


def annulus(inner_m: float, outer_m: float, count: int = RING_POINTS) -> Mesh:
    """Flat ring that faces up."""
    ring = circle(1.0, count)[:-1]
    vertices = np.concatenate([ring * inner_m, ring * outer_m]).astype(np.float32)
    i = np.arange(count)
    j = (i + 1) % count
    first = np.stack([i, i + count, j + count], axis=-1)
    second = np.stack([i, j + count, j], axis=-1)
    return vertices, np.concatenate([first, second]).astype(np.uint32)


def rising_annulus(inner_m: float, outer_m: float, slope_ratio: float) -> Mesh:
    """Ring that faces up and rises outwards from height 0, metres upwards per metre outwards."""
    vertices, faces = annulus(inner_m, outer_m)
    outwards_m = np.hypot(vertices[:, 0], vertices[:, 1]) - inner_m
    vertices[:, 2] = slope_ratio * outwards_m
    return vertices, faces


def disc(radius_m: float, count: int = RING_POINTS) -> Mesh:
    """Flat disc that faces up."""
    rim = circle(radius_m, count)[:-1]
    vertices = np.concatenate([np.zeros((1, 3)), rim]).astype(np.float32)
    i = np.arange(count)
    faces = np.stack([np.zeros_like(i), 1 + i, 1 + (i + 1) % count], axis=-1)
    return vertices, faces.astype(np.uint32)


def target_cross(inner_m: float, outer_m: float) -> Array:
    """Four ticks of a target mark, segments (4, 2, 3)."""
    unit = np.array([[1.0, 0, 0], [0, 1.0, 0], [-1.0, 0, 0], [0, -1.0, 0]])
    return np.stack([unit * inner_m, unit * outer_m], axis=1)


def crosses(points_m: Array, half_m: float) -> Array:
    """Diagonal crosses at points (N, 3), segments (2 N, 2, 3)."""
    arms = half_m * np.array([[[-1, -1, 0], [1, 1, 0]], [[-1, 1, 0], [1, -1, 0]]], dtype=np.float64)
    return (points_m[:, None, None, :] + arms[None]).reshape(-1, 2, 3)


def landing_ellipse(
    ellipse: LandingEllipse,
    target_m: tuple[float, float, float],
    sigma_ratio: float,
    count: int = 72,
) -> Array:
    """Outline of a predicted landing ellipse, shape (count + 1, 3), frame `machine`.

    The ellipse is given in frame `throw` about the target; x of that frame points from the slew axis
    to the target.
    """
    sx, sy = ellipse.sd_downrange_m, ellipse.sd_crossrange_m
    covariance = np.array(
        [
            [sx * sx, ellipse.correlation_ratio * sx * sy],
            [ellipse.correlation_ratio * sx * sy, sy * sy],
        ]
    )
    values, axes = np.linalg.eigh(covariance)
    angle = np.linspace(0.0, 2.0 * np.pi, count + 1)
    unit = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    local = sigma_ratio * (unit * np.sqrt(np.maximum(values, 0.0))) @ axes.T
    local += (ellipse.mean_downrange_error_m, ellipse.mean_crossrange_error_m)
    bearing = math.atan2(target_m[1], target_m[0])
    c, s = math.cos(bearing), math.sin(bearing)
    x = target_m[0] + c * local[:, 0] - s * local[:, 1]
    y = target_m[1] + s * local[:, 0] + c * local[:, 1]
    return np.stack([x, y, np.full_like(x, target_m[2])], axis=-1)


def fan(outline_m: Array) -> Mesh:
    """Fill a closed convex outline (N + 1, 3), facing up when it runs anticlockwise."""
    centre = outline_m[:-1].mean(axis=0, keepdims=True)
    vertices = np.concatenate([centre, outline_m[:-1]]).astype(np.float32)
    count = len(outline_m) - 1
    i = np.arange(count)
    faces = np.stack([np.zeros_like(i), 1 + i, 1 + (i + 1) % count], axis=-1)
    return vertices, faces.astype(np.uint32)


def range_label(target_m: tuple[float, float, float]) -> str:
    """Range and bearing of a target as the operator reads them: ``9.00 m, 12.3° left``."""
    range_m = math.hypot(target_m[0], target_m[1])
    bearing = math.degrees(math.atan2(target_m[1], target_m[0]))
    side = (
        "ahead"
        if abs(bearing) < 0.05
        else f"{abs(bearing):.1f}° {'left' if bearing > 0 else 'right'}"
    )
    z_m = target_m[2]
    height = f", {z_m:+.2f} m high" if z_m > 0.0 else f", {-z_m:.2f} m deep"
    return f"{range_m:.2f} m, {side}{'' if abs(z_m) < 0.005 else height}"
