"""Shapes of the 3D view: rings, marks and ellipses on the ground, objects of the site, ground with pits.

Line sets have shape (N, 2, 3); meshes are (vertices (V, 3), faces (F, 3)); metres, frame `machine`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from machine.conventions import Array, IntArray
from machine.messages import LandingEllipse
from machine.site.objects import SiteKind, SiteObject

Mesh = tuple[NDArray[np.float32], NDArray[np.uint32]]
RING_POINTS = 180
ROUND_COUNT = 48
GROUND_SECTORS = 96
NEAR_GROUND_M = 20.0


@dataclass(frozen=True)
class LoadFootprint:
    """Where a load would lie, frame `machine`."""

    vertices_m: Array
    """(N, 3)."""
    faces: IntArray
    """(M, 3)."""
    at_m: tuple[float, float, float]
    """Its target."""
    text: str
    """Its number and volume."""


@dataclass(frozen=True)
class SurveyedGround:
    """Ground that is not level, frame `machine`."""

    vertices_m: Array
    """(N, 3)."""
    faces: IntArray
    """(M, 3)."""
    hole_m: Array | None
    """(4, 2) counterclockwise outline of the level ground that it replaces; None: it lies above."""


@dataclass(frozen=True)
class LaidMaterial:
    """Bulk material on the ground, frame `machine`."""

    vertices_m: Array
    """(N, 3)."""
    faces: IntArray
    """(M, 3)."""
    contours_m: Array
    """(L, 2, 3) lines of equal height."""
    next_loads: tuple[LoadFootprint, ...] = ()
    """Those that are proposed."""
    ground: SurveyedGround | None = None
    """None: level."""


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


def beside(
    point_m: tuple[float, float, float], away_m: float, up_m: float
) -> tuple[float, float, float]:
    """Offset from a point by a distance away from the slew axis, and up."""
    range_m = max(math.hypot(point_m[0], point_m[1]), 1e-6)
    return away_m * point_m[0] / range_m, away_m * point_m[1] / range_m, up_m


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


def site_outline(item: SiteObject, ratio: float = 1.0) -> Array:
    """Corners (N, 2) of an object's footprint, anticlockwise; scaled about its centre."""
    if item.kind is SiteKind.PILE:
        local = circle(1.0, ROUND_COUNT)[:-1, :2]
    else:
        local = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    local = 0.5 * ratio * local * (item.length_m, item.width_m)
    cos, sin = math.cos(item.turn_rad), math.sin(item.turn_rad)
    return local @ np.array([[cos, sin], [-sin, cos]]) + (item.x_m, item.y_m)


def site_rims(item: SiteObject) -> tuple[Array, Array]:
    """Lower and upper rim (N, 3) of an object; of a pit its floor and the ground's edge."""
    low = -item.height_m if item.kind is SiteKind.PIT else item.base_height_m
    top_ratio = item.top_ratio if item.kind is SiteKind.PILE else 1.0
    return _at_height(site_outline(item), low), _at_height(
        site_outline(item, top_ratio), low + item.height_m
    )


def site_mesh(item: SiteObject) -> Mesh:
    """An object's surfaces: sides and top, of a pit sides and floor."""
    low, high = site_rims(item)
    count = len(low)
    flat = low if item.kind is SiteKind.PIT else high
    vertices = np.concatenate([low, high, flat, flat.mean(axis=0, keepdims=True)])
    i = np.arange(count)
    j = (i + 1) % count
    sides = [np.stack([i, j, j + count], -1), np.stack([i, j + count, i + count], -1)]
    cap = np.stack([np.full(count, 3 * count), i + 2 * count, j + 2 * count], -1)
    return vertices.astype(np.float32), np.concatenate([*sides, cap]).astype(np.uint32)


def site_edges(item: SiteObject) -> Array:
    """An object's edges as segments (M, 2, 3)."""
    low, high = site_rims(item)
    parts = [polyline(np.concatenate([rim, rim[:1]])) for rim in (low, high)]
    if item.kind is not SiteKind.PILE:
        parts.append(np.stack([low, high], axis=1))
    return np.concatenate(parts)


def ground_mesh(radius_m: float, holes_m: Sequence[Array]) -> Mesh:
    """A disc of ground with holes, each a convex outline (M, 2), counterclockwise."""
    corners = np.concatenate(holes_m) if holes_m else np.zeros((1, 2))
    # Only the ground near the pits is cut: triangles that are long and narrow flicker at the horizon.
    inner_m = max(NEAR_GROUND_M, 5.0 + float(np.linalg.norm(corners, axis=1).max()))
    pieces = [circle(inner_m, GROUND_SECTORS)[:-1, :2]]
    for hole in holes_m:
        pieces = [rest for piece in pieces for rest in _without(piece, hole)]
    far_vertices, far_faces = annulus(inner_m, radius_m, GROUND_SECTORS)
    vertices: list[Array] = [far_vertices.astype(np.float64)]
    faces: list[IntArray] = [far_faces.astype(np.int64)]
    first = len(far_vertices)
    for piece in pieces:
        i = np.arange(1, len(piece) - 1)
        faces.append(first + np.stack([np.zeros_like(i), i, i + 1], -1))
        vertices.append(_at_height(piece, 0.0))
        first += len(piece)
    return np.concatenate(vertices).astype(np.float32), np.concatenate(faces).astype(np.uint32)


def _without(piece: Array, hole: Array) -> list[Array]:
    """Convex parts of a convex polygon (N, 2) that lie outside of a convex hole (M, 2)."""
    parts: list[Array] = []
    inside = piece
    for start, end in zip(hole, np.roll(hole, -1, axis=0), strict=True):
        along = end - start
        inward = np.array([-along[1], along[0]])
        parts.append(_half(inside, start, -inward))
        inside = _half(inside, start, inward)
        if len(inside) < 3:
            return [piece]  # the hole lies elsewhere
    return [part for part in parts if len(part) >= 3]


def _half(polygon: Array, point: Array, normal: Array) -> Array:
    """The part of a convex polygon on the side of a line to which `normal` points."""
    side = (polygon - point) @ normal
    kept: list[Array] = []
    for index, here in enumerate(polygon):
        following = (index + 1) % len(polygon)
        if side[index] >= 0.0:
            kept.append(here)
        if side[index] * side[following] < 0.0:
            share = side[index] / (side[index] - side[following])
            kept.append(here + share * (polygon[following] - here))
    return np.array(kept).reshape(-1, 2)


def _at_height(points: Array, height_m: float) -> Array:
    return np.concatenate([points, np.full((len(points), 1), height_m)], axis=1)
