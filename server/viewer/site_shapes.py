"""Meshes of what stands around a machine, and of ground with pits in it. Pure arithmetic, frame `machine`."""

import math
from collections.abc import Sequence

import numpy as np

from machine.conventions import Array, IntArray
from machine.site.objects import SiteKind, SiteObject
from server.viewer.shapes import Mesh, annulus, circle, polyline

ROUND_COUNT = 48
GROUND_SECTORS = 96
NEAR_GROUND_M = 20.0


def outline(item: SiteObject, ratio: float = 1.0) -> Array:
    """Corners (N, 2) of an object's footprint, anticlockwise; scaled about its centre."""
    if item.kind is SiteKind.PILE:
        local = circle(1.0, ROUND_COUNT)[:-1, :2]
    else:
        local = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    local = 0.5 * ratio * local * (item.length_m, item.width_m)
    cos, sin = math.cos(item.turn_rad), math.sin(item.turn_rad)
    return local @ np.array([[cos, sin], [-sin, cos]]) + (item.x_m, item.y_m)


def rims(item: SiteObject) -> tuple[Array, Array]:
    """Lower and upper rim (N, 3) of an object; of a pit its floor and the ground's edge."""
    low = -item.height_m if item.kind is SiteKind.PIT else item.base_height_m
    top_ratio = item.top_ratio if item.kind is SiteKind.PILE else 1.0
    return _at(outline(item), low), _at(outline(item, top_ratio), low + item.height_m)


def mesh(item: SiteObject) -> Mesh:
    """An object's surfaces: sides and top, of a pit sides and floor."""
    low, high = rims(item)
    count = len(low)
    flat = low if item.kind is SiteKind.PIT else high
    vertices = np.concatenate([low, high, flat, flat.mean(axis=0, keepdims=True)])
    i = np.arange(count)
    j = (i + 1) % count
    sides = [np.stack([i, j, j + count], -1), np.stack([i, j + count, i + count], -1)]
    cap = np.stack([np.full(count, 3 * count), i + 2 * count, j + 2 * count], -1)
    return vertices.astype(np.float32), np.concatenate([*sides, cap]).astype(np.uint32)


def edges(item: SiteObject) -> Array:
    """An object's edges as segments (M, 2, 3)."""
    low, high = rims(item)
    parts = [polyline(np.concatenate([rim, rim[:1]])) for rim in (low, high)]
    if item.kind is not SiteKind.PILE:
        parts.append(np.stack([low, high], axis=1))
    return np.concatenate(parts)


def ground(radius_m: float, pits: Sequence[SiteObject]) -> Mesh:
    """A disc of ground with a hole for every pit."""
    corners = np.concatenate([outline(pit) for pit in pits]) if pits else np.zeros((1, 2))
    # Only the ground near the pits is cut: triangles that are long and narrow flicker at the horizon.
    inner_m = max(NEAR_GROUND_M, 5.0 + float(np.linalg.norm(corners, axis=1).max()))
    pieces = [circle(inner_m, GROUND_SECTORS)[:-1, :2]]
    for pit in pits:
        pieces = [rest for piece in pieces for rest in _without(piece, outline(pit))]
    far_vertices, far_faces = annulus(inner_m, radius_m, GROUND_SECTORS)
    vertices: list[Array] = [far_vertices.astype(np.float64)]
    faces: list[IntArray] = [far_faces.astype(np.int64)]
    first = len(far_vertices)
    for piece in pieces:
        i = np.arange(1, len(piece) - 1)
        faces.append(first + np.stack([np.zeros_like(i), i, i + 1], -1))
        vertices.append(_at(piece, 0.0))
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


def _at(points: Array, height_m: float) -> Array:
    return np.concatenate([points, np.full((len(points), 1), height_m)], axis=1)
