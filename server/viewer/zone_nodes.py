"""Exclusion zones of the 3D view: approved ones solid, drafts and the one being drawn as lines."""

from collections.abc import Sequence

import numpy as np
import shapely
import viser

from machine.conventions import Array, IntArray
from machine.site.zones import Corner, Zone
from server.viewer.shapes import Mesh, polyline
from server.viewer.theme import Rgb, Theme

LIFT_M = 0.02
WALL_RATIO = 0.22
LINE_WIDTH = 2.2
LABEL_UP_M = 0.25


class ZoneNodes:
    """The zones in one browser's scene."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._zones: list[viser.SceneNodeHandle] = []
        self._sketch: list[viser.SceneNodeHandle] = []

    def draw(self, theme: Theme, active: Sequence[Zone], draft: Sequence[Zone]) -> None:
        """Draw both sets in place of what was drawn of them before."""
        _remove(self._zones)
        for index, zone in enumerate(active):
            name = f"/zones/active/{index}"
            node = self._scene.add_mesh_simple(
                f"{name}/walls",
                *prism_mesh(zone),
                color=theme.zone,
                opacity=WALL_RATIO,
                side="double",
                cast_shadow=False,
                receive_shadow=False,
            )
            self._zones.append(node)
            self._zones += self._outline(
                name, zone.corners_m, zone.bottom_m, zone.top_m, theme.zone
            )
            self._zones.append(self._label(name, zone, zone.name))
        for index, zone in enumerate(draft):
            name = f"/zones/draft/{index}"
            self._zones += self._outline(
                name, zone.corners_m, zone.bottom_m, zone.top_m, theme.ring
            )
            self._zones.append(self._label(name, zone, f"{zone.name} (not approved)"))

    def draw_sketch(
        self, theme: Theme, corners_m: Sequence[Corner], bottom_m: float, top_m: float
    ) -> None:
        """Draw the zone that is being drawn: its corners, and from three on its edges."""
        _remove(self._sketch)
        if len(corners_m) >= 3:
            self._sketch += self._outline("/zones/sketch", corners_m, bottom_m, top_m, theme.accent)
        elif len(corners_m) == 2:
            line = polyline(_rim(corners_m, LIFT_M))
            self._sketch.append(self._lines("/zones/sketch/line", line, theme.accent))
        for index, (x_m, y_m) in enumerate(corners_m):
            dot = self._scene.add_icosphere(
                f"/zones/sketch/{index}",
                radius=0.09,
                color=theme.accent,
                position=(x_m, y_m, LIFT_M),
            )
            self._sketch.append(dot)

    def _outline(
        self, name: str, corners_m: Sequence[Corner], bottom_m: float, top_m: float, colour: Rgb
    ) -> list[viser.SceneNodeHandle]:
        low, high = _rim(corners_m, bottom_m + LIFT_M), _rim(corners_m, top_m)
        rims = [polyline(np.concatenate([rim, rim[:1]])) for rim in (low, high)]
        edges = np.concatenate([*rims, np.stack([low, high], axis=1)])
        return [self._lines(f"{name}/edges", edges, colour)]

    def _lines(self, name: str, segments: Array, colour: Rgb) -> viser.SceneNodeHandle:
        return self._scene.add_line_segments(
            name, segments, colour, thickness=LINE_WIDTH, thickness_units="screen"
        )

    def _label(self, name: str, zone: Zone, text: str) -> viser.SceneNodeHandle:
        x_m, y_m = np.mean(zone.corners_m, axis=0).tolist()
        at = (x_m, y_m, zone.top_m + LABEL_UP_M)
        return self._scene.add_label(
            f"{name}/label", text, position=at, font_screen_scale=1.0, anchor="bottom-center"
        )


def _remove(nodes: list[viser.SceneNodeHandle]) -> None:
    for node in reversed(nodes):
        node.remove()
    nodes.clear()


def _rim(corners_m: Sequence[Corner], height_m: float) -> Array:
    return np.array([(x_m, y_m, height_m) for x_m, y_m in corners_m])


def prism_mesh(zone: Zone) -> Mesh:
    """Walls, floor and top of a zone."""
    count = len(zone.corners_m)
    vertices = np.concatenate(
        [_rim(zone.corners_m, zone.bottom_m + LIFT_M), _rim(zone.corners_m, zone.top_m)]
    )
    i = np.arange(count)
    j = (i + 1) % count
    walls = [np.stack([i, j, j + count], -1), np.stack([i, j + count, i + count], -1)]
    cap = _triangles(zone.corners_m)
    faces = np.concatenate([*walls, cap, cap + count])
    return vertices.astype(np.float32), faces.astype(np.uint32)


def _triangles(corners_m: Sequence[Corner]) -> IntArray:
    """Triangles (T, 3) of corner numbers that fill a polygon."""
    parts = shapely.get_parts(shapely.constrained_delaunay_triangles(shapely.Polygon(corners_m)))
    rings = shapely.get_coordinates(parts).reshape(-1, 4, 2)[:, :3]
    away = np.linalg.norm(rings[:, :, None] - np.array(corners_m), axis=-1)
    return away.argmin(axis=-1)
