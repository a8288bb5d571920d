"""Ground, light and haze of the 3D view, and what stands around the machine."""

import math
from collections.abc import Sequence

import numpy as np
import viser

from machine.conventions import Array, IntArray
from machine.site.objects import SiteKind, SiteObject
from server.viewer import shapes
from server.viewer.theme import Rgb, Theme

GROUND_RADIUS_M = 400.0
GRID_RADIUS_M = 60.0
GROUND_LIFT_M = -0.02
"""The ground is drawn a little below its marks."""
LABEL_AWAY_M = 0.5
NEXT_LOAD_RATIO = 0.35
"""Opacity of loads that are proposed."""
DIM_SLOPE_RATIO = 0.005
"""The dimmed ground rises outwards: far away the depth buffer cannot tell 24 mm from nothing, and white
spikes of the ground came through (24 bits for 0.01 to 1000 m: steps of 0.02 m at 60 m, 0.2 m at 190 m)."""
HAZE_NEAR_M = 45.0
HAZE_FAR_M = 190.0


class GroundNodes:
    """Everything that lies still under the machine."""

    def __init__(self, scene: viser.SceneApi, theme: Theme, *, shadows: bool) -> None:
        self._scene = scene
        self._theme = theme
        scene.configure_default_lights(enabled=False)
        scene.configure_environment_map("park", environment_intensity=theme.sky_intensity_ratio)
        scene.configure_fog(HAZE_NEAR_M, HAZE_FAR_M, color=theme.haze)
        self._shadows = shadows
        self._site: list[viser.SceneNodeHandle] = []
        self._material: list[viser.SceneNodeHandle] = []
        self._pits: list[Array] = []
        self._hole: list[Array] = []
        self._ground = self._lay()
        self._nodes: list[viser.SceneNodeHandle] = [
            scene.add_light_directional(
                "/sun",
                intensity=theme.light_intensity_ratio,
                cast_shadow=shadows,
                position=(-5.0, -9.0, 14.0),
            ),
            scene.add_light_hemisphere(
                "/sky",
                sky_color=(255, 255, 255),
                ground_color=(120, 118, 112),
                intensity=theme.sky_intensity_ratio,
            ),
            scene.add_grid(
                "/grid",
                2 * GRID_RADIUS_M,
                2 * GRID_RADIUS_M,
                cell_size=1.0,
                section_size=5.0,
                cell_color=theme.grid_cell,
                section_color=theme.grid_section,
                cell_thickness=0.8,
                section_thickness=1.0,
                fade_distance=GRID_RADIUS_M,
                fade_from="origin",
                shadow_opacity=0.0,
            ),
        ]

    def _lay(self) -> viser.SceneNodeHandle:
        return self._scene.add_mesh_simple(
            "/ground",
            *shapes.ground_mesh(GROUND_RADIUS_M, [*self._pits, *self._hole]),
            color=self._theme.ground,
            cast_shadow=False,
            receive_shadow=self._theme.shadow_ratio if self._shadows else False,
            position=(0.0, 0.0, GROUND_LIFT_M),
        )

    def draw_site(self, objects: Sequence[SiteObject]) -> None:
        """What stands around the machine, in place of what was drawn of it before."""
        for node in reversed(self._site):
            node.remove()
        self._site.clear()
        self._pits = [shapes.site_outline(item) for item in objects if item.kind is SiteKind.PIT]
        self._lay_anew()
        for index, item in enumerate(objects):
            self._add(f"/site/{index}", item)

    def _lay_anew(self) -> None:
        self._ground.remove()
        self._ground = self._lay()

    def _add(self, name: str, item: SiteObject) -> None:
        theme, is_pit = self._theme, item.kind is SiteKind.PIT
        top_m = 0.0 if is_pit else item.base_height_m + item.height_m
        # Beyond an end of it: over its middle the marks of targets and impacts have their labels.
        away_m = 0.5 * item.length_m + LABEL_AWAY_M
        x_m = item.x_m + away_m * math.cos(item.turn_rad)
        y_m = item.y_m + away_m * math.sin(item.turn_rad)
        self._site += [
            self._scene.add_mesh_simple(
                name,
                *shapes.site_mesh(item),
                color=theme.pit if is_pit else theme.site,
                flat_shading=True,
                side="double" if is_pit else "front",
                cast_shadow=self._shadows and not is_pit,
                receive_shadow=False,  # its own shadow would streak it
            ),
            self._scene.add_line_segments(
                f"{name}/edges",
                shapes.site_edges(item),
                theme.site_edge,
                thickness=1.6,
                thickness_units="screen",
            ),
            self._scene.add_label(
                f"{name}/label",
                item.name,
                position=(x_m, y_m, top_m),
                font_screen_scale=1.0,
                anchor="bottom-center",
            ),
        ]

    def draw_material(self, material: shapes.LaidMaterial | None) -> None:
        """Bulk material with its contour lines, in place of what was drawn of it before."""
        for node in reversed(self._material):
            node.remove()
        self._material.clear()
        self._draw_surveyed(None if material is None else material.ground)
        if material is None:
            return
        if len(material.faces):
            self._lay_material(material)
        for index, load in enumerate(material.next_loads):
            # On the machine's side: a target there has its label on the far one.
            inward = shapes.beside(load.at_m, -LABEL_AWAY_M, LABEL_AWAY_M)
            self._material += [
                self._sheet(
                    f"/next_loads/{index}",
                    load.vertices_m,
                    load.faces,
                    self._theme.accent,
                    opacity=NEXT_LOAD_RATIO,
                ),
                self._scene.add_label(
                    f"/next_loads/{index}/label",
                    load.text,
                    position=tuple(np.add(load.at_m, inward).tolist()),
                    font_screen_scale=1.0,
                    anchor="bottom-center",
                ),
            ]

    def _sheet(
        self, name: str, vertices_m: Array, faces: IntArray, color: Rgb,
        *, opacity: float | None = None, flat_shading: bool = False,
    ) -> viser.SceneNodeHandle:  # fmt: skip
        """A surface without thickness, seen from both sides."""
        return self._scene.add_mesh_simple(
            name,
            vertices_m.astype(np.float32),
            faces.astype(np.uint32),
            color=color,
            opacity=opacity,
            flat_shading=flat_shading,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )

    def _draw_surveyed(self, ground: shapes.SurveyedGround | None) -> None:
        """Ground that is not level; below level it takes the level ground's place."""
        hole = [] if ground is None or ground.hole_m is None else [ground.hole_m]
        if not np.array_equal(hole, self._hole):
            self._hole = hole
            self._lay_anew()
        if ground is not None:
            sheet = self._sheet(
                "/surveyed", ground.vertices_m, ground.faces, self._theme.ground, flat_shading=True
            )
            sheet.position = (0.0, 0.0, GROUND_LIFT_M)
            self._material.append(sheet)

    def _lay_material(self, material: shapes.LaidMaterial) -> None:
        self._material.append(
            self._sheet("/material", material.vertices_m, material.faces, self._theme.material)
        )
        if len(material.contours_m):
            self._material.append(
                self._scene.add_line_segments(
                    "/material/contours",
                    material.contours_m.astype(np.float32),
                    self._theme.site_edge,
                    thickness=1.2,
                    thickness_units="screen",
                )
            )

    def dim_outside(self, inner_m: float, outer_m: float) -> list[viser.SceneNodeHandle]:
        """Dim the ground nearer than `inner_m` and beyond `outer_m`; returns the new nodes."""
        full = self._theme.dim_ratio
        meshes = {
            "beyond": (shapes.rising_annulus(outer_m, GROUND_RADIUS_M, DIM_SLOPE_RATIO), full)
        }
        if inner_m > 0.0:
            # Weaker: the machine stands there, and nobody takes that ground for a target.
            meshes["near"] = (shapes.disc(inner_m), 0.4 * full)
        return [
            self._scene.add_mesh_simple(
                f"/dim/{name}",
                *mesh,
                color=self._theme.dim,
                opacity=opacity,
                cast_shadow=False,
                receive_shadow=False,
                position=(0.0, 0.0, 0.004),
            )
            for name, (mesh, opacity) in meshes.items()
        ]

    def remove(self) -> None:
        """Take everything out of the scene."""
        for node in [*reversed(self._site), *reversed(self._material), self._ground, *self._nodes]:
            node.remove()
        self._site.clear()
        self._material.clear()
        self._nodes.clear()
