"""The material of a job as a mesh with contour lines, for the 3D view."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bulk.height_field import OPEN, WALL, HeightField, Rectangle
from bulk.job_report import contour_lines
from machine.conventions import Array, BoolArray, IntArray
from machine.site.objects import SiteObject
from server.viewer.shapes import LaidMaterial, LoadFootprint, SurveyedGround

LEAST_M = 0.01
"""Thinner layers are not drawn."""
LIFT_M = 0.01
"""Above the ground on which it lies, that neither shines through the other."""
CONTOUR_M = 0.1
MAX_CONTOUR_COUNT = 40


def laid_material(
    field: HeightField,
    next_loads: tuple[LoadFootprint, ...] = (),
    objects: Sequence[SiteObject] = (),
) -> LaidMaterial:
    """Mesh over the cells on which material lies; walls of containers are left out.

    Args:
        field: what lies there.
        next_loads: that are proposed.
        objects: of the site, which are drawn elsewhere.
    """
    lies = (field.height_m - field.base_m > LEAST_M) & (field.container_index != WALL)
    mesh = _mesh(field, lies, LIFT_M)
    return LaidMaterial(*mesh, _contours(field, lies), next_loads, _surveyed_ground(field, objects))


def _surveyed_ground(field: HeightField, objects: Sequence[SiteObject]) -> SurveyedGround | None:
    """The ground under the material where it is not level; None where it is."""
    grid, base_m = field.grid, field.base_m
    free = field.container_index == OPEN
    for item in objects:
        foot = (item.length_m + 2.0 * grid.cell_m, item.width_m + 2.0 * grid.cell_m)
        free &= ~Rectangle(item.x_m, item.y_m, *foot, item.turn_rad).mask(grid)
    drawn = free & (np.abs(base_m) > LEAST_M)
    if not drawn.any():
        return None
    low, hole = drawn & (base_m < 0.0), None
    if low.any():
        (top, bottom), (left, right) = (
            (max(int(at.min()) - 1, 0), min(int(at.max()) + 1, size - 1))
            for at, size in zip(np.nonzero(low), base_m.shape, strict=True)
        )
        x, y = grid.x_m[[left, right]], grid.y_m[[top, bottom]]
        hole = np.array([(x[0], y[0]), (x[1], y[0]), (x[1], y[1]), (x[0], y[1])])
        inside = np.s_[top + 1 : bottom, left + 1 : right]
        drawn[inside] = free[inside]
    vertices, faces = _mesh(replace(field, height_m=base_m), drawn, 0.0)
    return SurveyedGround(vertices, faces, hole)


def load_footprint(
    before: HeightField, after: HeightField, at_m: tuple[float, float, float], text: str
) -> LoadFootprint:
    """Mesh over what a load adds.

    Args:
        before: surface without it.
        after: surface with it.
        at_m: its target.
        text: its number and volume.
    """
    adds = (after.height_m - before.height_m > LEAST_M) & (before.container_index != WALL)
    return LoadFootprint(*_mesh(after, adds, 2.0 * LIFT_M), at_m, text)


def _mesh(field: HeightField, lies: BoolArray, lift_m: float) -> tuple[Array, IntArray]:
    """Vertices (N, 3) and faces (M, 3) of the squares with a corner among some cells (rows, columns)."""
    grid = field.grid
    is_wall = field.container_index == WALL
    x_m, y_m = np.meshgrid(grid.x_m, grid.y_m)
    vertices = np.stack([x_m, y_m, field.height_m + lift_m], axis=-1).reshape(-1, 3)
    number = np.arange(is_wall.size).reshape(is_wall.shape)
    low, high = slice(None, -1), slice(1, None)
    corners = [(low, low), (low, high), (high, high), (high, low)]
    drawn = np.logical_or.reduce([lies[at] for at in corners])
    drawn &= ~np.logical_or.reduce([is_wall[at] for at in corners])
    a, b, c, d = (number[at][drawn] for at in corners)
    faces = np.concatenate([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)])
    used, faces = np.unique(faces, return_inverse=True)
    return vertices[used], faces.reshape(-1, 3)


def _contours(field: HeightField, lies: BoolArray) -> Array:
    """(L, 2, 3) lines of equal height on the material."""
    if not lies.any():
        return np.zeros((0, 2, 3))
    height = np.where(lies, field.height_m, np.nan)
    low_m, high_m = float(np.nanmin(height)), float(np.nanmax(height))
    step_m = CONTOUR_M * max(1.0, np.ceil((high_m - low_m) / CONTOUR_M / MAX_CONTOUR_COUNT))
    lines: list[Array] = []
    for level_m in np.arange(np.ceil(low_m / step_m), np.floor(high_m / step_m) + 1.0) * step_m:
        flat = contour_lines(field.grid.x_m, field.grid.y_m, height, float(level_m) + 1e-6)
        flat = flat[np.isfinite(flat).all(axis=(1, 2))]
        up = np.full((*flat.shape[:2], 1), level_m + 1.5 * LIFT_M)
        lines.append(np.concatenate([flat, up], axis=-1))
    return np.concatenate(lines) if lines else np.zeros((0, 2, 3))
