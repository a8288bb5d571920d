"""What a session marks on the ground: reach, impacts, target and the predicted throw."""

import math
from collections.abc import Callable
from typing import Literal

import numpy as np
import viser

from machine.conventions import Array
from server.viewer import shapes
from server.viewer.ground import GroundNodes
from server.viewer.pick import Ray
from server.viewer.state import ImpactMarks, Point, ShownPlan, ShownSession
from server.viewer.theme import THEMES, Rgb, Theme

Node = viser.SceneNodeHandle
OnTargetDrag = Callable[[Ray], None]
TARGET_HANDLE = "/target/handle"
"""What is dragged; the only node whose drags the proxy lets through."""
HANDLE_RADIUS_M = 0.6
LIFT_M = 0.03
"""Marks lie this much above the ground they mark, so that neither hides the other."""
LABEL_SCALE = 1.2
LABEL_AWAY_M = 0.95
"""Labels stand this far beside what they name, so that it stays visible from above too."""


class MarkNodes:
    """The marks of one browser, in groups that are drawn anew one by one."""

    def __init__(self, client: viser.ClientHandle, on_target_drag: OnTargetDrag) -> None:
        """Prepare.

        Args:
            client: browser to draw in.
            on_target_drag: called in viser's event loop while the target is dragged.
        """
        self._on_target_drag = on_target_drag
        self._scene = client.scene
        self._groups: dict[str, list[Node]] = {}

    def draw_all(self, state: ShownSession, ground: GroundNodes) -> None:
        """Draw every group anew, in the session's colours."""
        self._clear("target")
        self.draw_reach(state, ground)
        self.draw_impacts(state)
        self.draw_plan(state)
        self.draw_target(state)

    def draw_lost(self, text: str | None) -> None:
        """Large words over the machine; None takes them away."""
        nodes = self._groups.get("lost", [])
        if text is None:
            self._clear("lost")
        elif nodes and isinstance(nodes[0], viser.LabelHandle):
            nodes[0].text = text
        else:
            self._groups["lost"] = [self._label("/lost", text, (0.0, 0.0, 4.6), 2.2)]

    def _clear(self, group: str) -> list[Node]:
        # Children stand after their parent, and a parent takes its children along.
        for node in reversed(self._groups.pop(group, [])):
            node.remove()
        return self._groups.setdefault(group, [])

    def _label(
        self,
        name: str,
        text: str,
        at: Point,
        scale: float = LABEL_SCALE,
        anchor: Literal["bottom-center", "top-center"] = "bottom-center",
    ) -> Node:
        return self._scene.add_label(
            name, text, position=at, font_screen_scale=scale, anchor=anchor
        )

    def _lines(
        self, name: str, segments: Array, colour: Rgb, width: float, at: Point = (0.0, 0.0, 0.0)
    ) -> Node:
        return self._scene.add_line_segments(
            name, segments, colour, thickness=width, thickness_units="screen", position=at
        )

    def _flat(
        self, name: str, mesh: shapes.Mesh, colour: Rgb, opacity: float, at: Point = (0.0, 0.0, 0.0)
    ) -> Node:
        return self._scene.add_mesh_simple(
            name,
            *mesh,
            color=colour,
            opacity=opacity,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
            position=at,
        )

    def draw_reach(self, state: ShownSession, ground: GroundNodes) -> None:
        """Range rings with labels, that of the target's height too, and the dimmed ground out of reach."""
        nodes = self._clear("reach")
        reach = state.reach
        if reach is None:
            return
        theme = THEMES[state.theme]
        nodes += ground.dim_outside(reach.min_m, reach.dimmed_beyond_m)
        rings = [("static", reach.static_m, f"{reach.static_m:.1f} m static reach", 122.0)]
        planar_m, spatial_m = reach.planar_m, reach.spatial_m
        is_same = f"{planar_m or 0.0:.1f}" == f"{spatial_m or 0.0:.1f}"
        if planar_m is not None:
            modes = "2D and 3D" if is_same else "2D"
            rings.append(("planar", planar_m, f"{planar_m:.1f} m {modes}", 114.0))
        if spatial_m is not None and not is_same:
            rings.append(("spatial", spatial_m, f"{spatial_m:.1f} m 3D", 103.0))
        for name, radius, text, degrees in rings:
            nodes += self._ring(name, radius, LIFT_M, text, degrees, theme.ring)
        if reach.raised_m is not None:
            # In the air at the target's height: beyond it the surface there is out of reach.
            label = "" if reach.mode is None else f" {reach.mode.value.upper()}"
            text = f"{reach.raised_m:.1f} m{label} at {reach.height_m:+.2f} m"
            height_m = reach.height_m + LIFT_M
            nodes += self._ring("raised", reach.raised_m, height_m, text, 108.0, theme.accent)

    def _ring(
        self, name: str, radius_m: float, height_m: float, text: str, degrees: float, colour: Rgb
    ) -> list[Node]:
        """A ring about the slew axis with its label; the static reach is drawn through, others dashed."""
        solid = name == "static"
        circle = (
            shapes.polyline(shapes.circle(radius_m)) if solid else shapes.dashed_circle(radius_m)
        )
        angle = math.radians(degrees)
        at = (radius_m * math.cos(angle), radius_m * math.sin(angle), height_m)
        return [
            self._lines(f"/reach/{name}", circle, colour, 1.6, (0, 0, height_m)),
            self._label(f"/reach/{name}_label", text, at, 1.0),
        ]

    def draw_impacts(self, state: ShownSession) -> None:
        """Past impacts as crosses; the newest one larger, with its miss in words."""
        nodes = self._clear("impacts")
        marks: ImpactMarks = state.impacts
        theme = THEMES[state.theme]
        lift = (0.0, 0.0, LIFT_M)
        if len(marks.points_m):
            past = shapes.crosses(marks.points_m, 0.09)
            nodes.append(self._lines("/impacts/past", past, theme.past, 1.6, lift))
        if marks.latest is not None:
            newest = shapes.crosses(np.array([marks.latest]), 0.17)
            nodes.append(self._lines("/impacts/latest", newest, theme.measured, 3.0, lift))
            if marks.latest_text:
                # On the machine's side of its cross: the target's own label is on the far side.
                dx, dy, dz = shapes.beside(marks.latest, -LABEL_AWAY_M, -0.1)
                at = (marks.latest[0] + dx, marks.latest[1] + dy, marks.latest[2] + dz)
                name = "/impacts/latest_label"
                nodes.append(self._label(name, marks.latest_text, at, anchor="top-center"))

    def draw_target(self, state: ShownSession) -> None:
        """The target mark with range and bearing; moved, not made anew, while it exists."""
        nodes = self._groups.get("target", [])
        if state.target_m is None:
            self._clear("target")
            return
        x, y, z = state.target_m
        text = shapes.range_label(state.target_m)
        outward = shapes.beside(state.target_m, LABEL_AWAY_M, 0.3)
        if nodes:
            frame, label = nodes
            if isinstance(label, viser.LabelHandle):
                frame.position = (x, y, z + LIFT_M)
                label.text = text
                label.position = outward
        else:
            theme = THEMES[state.theme]
            frame = self._scene.add_frame("/target", show_axes=False, position=(x, y, z + LIFT_M))
            # Open in the middle, where the landing ellipse and the impacts will be.
            ring = shapes.polyline(shapes.circle(0.45, 48))
            self._lines("/target/ring", ring, theme.accent, 2.5)
            self._lines("/target/ticks", shapes.target_cross(0.45, 0.75), theme.accent, 2.5)
            self._flat("/target/dot", shapes.disc(0.045, 24), theme.accent, 1.0)
            grip = self._flat(TARGET_HANDLE, shapes.disc(HANDLE_RADIUS_M, 32), theme.accent, 0.06)
            if isinstance(grip, viser.MeshHandle):
                grip.on_drag(self._drag)
            label = self._label("/target/label", text, outward, 1.3)
            self._groups["target"] = [frame, label]

    async def _drag(self, event: viser.SceneNodeDragEvent[viser.MeshHandle]) -> None:
        """The pointer while the target is held, as a ray from the camera."""
        origin = np.asarray(event.client.camera.position, dtype=np.float64)
        self._on_target_drag(Ray(origin, np.asarray(event.end_position) - origin))

    def draw_plan(self, state: ShownSession) -> None:
        """Predicted path of the load, landing ellipses of 1 and 2 sigma, predicted impact."""
        nodes = self._clear("plan")
        plan = state.plan
        if plan is None:
            return
        theme = THEMES[state.theme]
        if len(plan.motion.ball_path_m) > 1 and not plan.is_estimate:
            path = shapes.polyline(plan.motion.ball_path_m)
            nodes.append(self._lines("/plan/path", path, theme.accent, 2.5))
        nodes += self._ellipses(plan, theme)
        if plan.impact_m is not None:
            cross = shapes.crosses(np.array([plan.impact_m]), 0.13)
            at = (0.0, 0.0, LIFT_M - plan.impact_m[2] + plan.target_m[2])
            nodes.append(self._lines("/plan/impact", cross, theme.accent, 2.5, at))

    def _ellipses(self, plan: ShownPlan, theme: Theme) -> list[Node]:
        if plan.ellipse is None:
            return []
        nodes: list[Node] = []
        for sigma, fill in ((2.0, 0.16), (1.0, 0.30)):
            outline = shapes.landing_ellipse(plan.ellipse, plan.target_m, sigma)
            at = (0.0, 0.0, LIFT_M * (0.5 if sigma == 2.0 else 0.7))
            name = f"/plan/sigma{sigma:.0f}"
            if not plan.is_estimate:
                area = shapes.fan(outline)
                nodes.append(self._flat(f"{name}_fill", area, theme.accent, fill, at))
            nodes.append(self._lines(name, shapes.polyline(outline), theme.accent, 1.6, at))
        return nodes
