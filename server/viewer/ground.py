"""Ground, light and haze of the 3D view."""

import viser

from server.viewer import shapes
from server.viewer.theme import Theme

GROUND_RADIUS_M = 400.0
GRID_RADIUS_M = 60.0
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
            scene.add_mesh_simple(
                "/ground",
                *shapes.disc(GROUND_RADIUS_M, 96),
                color=theme.ground,
                cast_shadow=False,
                receive_shadow=theme.shadow_ratio if shadows else False,
                position=(0.0, 0.0, -0.02),
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

    def dim_outside(self, inner_m: float, outer_m: float) -> list[viser.SceneNodeHandle]:
        """Dim the ground nearer than `inner_m` and beyond `outer_m`; returns the new nodes."""
        full = self._theme.dim_ratio
        meshes = {"beyond": (shapes.annulus(outer_m, GROUND_RADIUS_M), full)}
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
        for node in self._nodes:
            node.remove()
        self._nodes.clear()
