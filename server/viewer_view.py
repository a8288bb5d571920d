"""One browser's scene: draws a session's view and keeps it in step. Runs in the view's own thread only."""

import math

import numpy as np
import viser

from machine.conventions import Array
from server import viewer_shapes as shapes
from server.viewer_ground import GroundNodes
from server.viewer_nodes import PAYLOAD, MachineKit, MachineNodes, Tint
from server.viewer_replay import Moment
from server.viewer_state import ImpactMarks, LiveSample, PlanView, Point, SessionView
from server.viewer_theme import MAX_ORBIT_M, MIN_ORBIT_M, THEMES, VIEWPOINTS, Rgb, Theme

Node = viser.SceneNodeHandle
LIFT_M = 0.03
"""Marks lie this much above the ground they mark, so that neither hides the other."""
GHOST_RATIO = 0.34
LOST_RATIO = 0.45
LABEL_SCALE = 1.2


class ClientView:
    """The nodes of one connected browser."""

    def __init__(
        self, client: viser.ClientHandle, kit: MachineKit, state: SessionView, *, shadows: bool
    ) -> None:
        self._shadows = shadows
        self.client = client
        self._scene = client.scene
        self._kit = kit
        self._groups: dict[str, list[Node]] = {}
        self._live: MachineNodes | None = None
        self._ghost: MachineNodes | None = None
        self._replay: MachineNodes | None = None
        self._balls: dict[str, viser.GlbHandle] = {}
        self._ground: GroundNodes | None = None
        self._sample_number = -1
        self._camera_count = 0
        self._lost_text: str | None = None
        self._apply_theme(state)

    # Whole view -----------------------------------------------------------------------------------

    def _theme(self, state: SessionView) -> Theme:
        return THEMES[state.theme]

    def _apply_theme(self, state: SessionView) -> None:
        theme = self._theme(state)
        self.client.gui.configure_theme(
            dark_mode=theme.is_dark, show_logo=False, show_share_button=False
        )
        if self._ground is not None:
            self._ground.remove()
        self._ground = GroundNodes(self._scene, theme, shadows=self._shadows)
        self.client.camera.min_orbit_distance = MIN_ORBIT_M
        self.client.camera.max_orbit_distance = MAX_ORBIT_M

    def rebuild(self, state: SessionView) -> None:
        """Draw everything anew in the session's theme."""
        self._apply_theme(state)
        self._clear("target")
        self.draw_all(state)

    def draw_all(self, state: SessionView) -> None:
        """Draw all overlays of the session; the machine follows with its next sample."""
        self.draw_reach(state)
        self.draw_zones(state)
        self.draw_impacts(state)
        self.draw_plan(state)
        self.draw_target(state)
        self.place_camera(state)

    def place_camera(self, state: SessionView) -> None:
        """Go to the asked camera preset, once an asking."""
        if state.camera_count == self._camera_count:
            return
        self._camera_count = state.camera_count
        view = VIEWPOINTS[state.camera]
        with self.client.atomic():
            self.client.camera.fov = view.fov_rad
            self.client.camera.position = view.position_m
            self.client.camera.look_at = view.look_at_m

    def _clear(self, group: str) -> list[Node]:
        for node in self._groups.pop(group, []):
            node.remove()
        return self._groups.setdefault(group, [])

    def _label(self, name: str, text: str, at: Point, scale: float = LABEL_SCALE) -> Node:
        return self._scene.add_label(
            name, text, position=at, font_screen_scale=scale, anchor="bottom-center"
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

    # Ground ---------------------------------------------------------------------------------------

    def draw_reach(self, state: SessionView) -> None:
        """Range rings with labels, and the dimmed ground out of reach."""
        nodes = self._clear("reach")
        reach = state.reach
        if reach is None or self._ground is None:
            return
        theme = self._theme(state)
        nodes += self._ground.dim_outside(reach.min_m, reach.dimmed_beyond_m)
        rings = [("static", reach.static_m, f"{reach.static_m:.1f} m static reach", -62.0)]
        if reach.planar_m is not None:
            rings.append(("planar", reach.planar_m, f"{reach.planar_m:.1f} m 2D", -40.0))
        if reach.spatial_m is not None:
            rings.append(("spatial", reach.spatial_m, f"{reach.spatial_m:.1f} m 3D", -24.0))
        for name, radius, text, degrees in rings:
            solid = name == "static"
            circle = (
                shapes.polyline(shapes.circle(radius)) if solid else shapes.dashed_circle(radius)
            )
            nodes.append(self._lines(f"/reach/{name}", circle, theme.ring, 1.6, (0, 0, LIFT_M)))
            angle = math.radians(degrees)
            at = (radius * math.cos(angle), radius * math.sin(angle), LIFT_M)
            nodes.append(self._label(f"/reach/{name}_label", text, at, 1.0))

    def draw_zones(self, state: SessionView) -> None:
        """Exclusion zones: outline and hatching."""
        nodes = self._clear("zones")
        theme = self._theme(state)
        for index, polygon in enumerate(state.zones_m):
            outline = np.column_stack([polygon, np.zeros(len(polygon))])
            closed = shapes.polyline(np.concatenate([outline, outline[:1]]))
            segments = np.concatenate([closed, shapes.hatch(polygon)])
            nodes.append(self._lines(f"/zones/{index}", segments, theme.zone, 1.6, (0, 0, LIFT_M)))

    def draw_impacts(self, state: SessionView) -> None:
        """Past impacts as crosses; the newest one larger, with its miss in words."""
        nodes = self._clear("impacts")
        marks: ImpactMarks = state.impacts
        theme = self._theme(state)
        lift = (0.0, 0.0, LIFT_M)
        if len(marks.points_m):
            past = shapes.crosses(marks.points_m, 0.09)
            nodes.append(self._lines("/impacts/past", past, theme.past, 1.6, lift))
        if marks.latest is not None:
            newest = shapes.crosses(np.array([marks.latest]), 0.17)
            nodes.append(self._lines("/impacts/latest", newest, theme.measured, 3.0, lift))
            if marks.latest_text:
                at = (marks.latest[0], marks.latest[1], marks.latest[2] + LIFT_M)
                label = self._label("/impacts/latest_label", marks.latest_text, at)
                nodes.append(label)

    # Throw ----------------------------------------------------------------------------------------

    def draw_target(self, state: SessionView, *, flush: bool = False) -> None:
        """The target mark with range and bearing; moved, not made anew, while it exists."""
        nodes = self._groups.get("target", [])
        if state.target_m is None:
            self._clear("target")
            return
        x, y, z = state.target_m
        text = shapes.range_label(state.target_m)
        if nodes:
            frame, label = nodes
            if isinstance(label, viser.LabelHandle):
                frame.position = (x, y, z + LIFT_M)
                label.text = text
        else:
            theme = self._theme(state)
            frame = self._scene.add_frame("/target", show_axes=False, position=(x, y, z + LIFT_M))
            self._flat("/target/ring", shapes.annulus(0.30, 0.36, 48), theme.accent, 1.0)
            self._flat("/target/dot", shapes.disc(0.06, 24), theme.accent, 1.0)
            self._lines("/target/ticks", shapes.target_cross(0.36, 0.62), theme.accent, 2.5)
            post = np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 1.05]]])
            self._lines("/target/post", post, theme.accent, 1.6)
            label = self._label("/target/label", text, (0.0, 0.0, 1.05), 1.3)
            self._groups["target"] = [frame, label]
        if flush:
            self.client.flush()

    def draw_plan(self, state: SessionView) -> None:
        """Predicted path of the load, landing ellipses of 1 and 2 sigma, predicted impact."""
        nodes = self._clear("plan")
        plan = state.plan
        if plan is None:
            self._drop_ghost()
            return
        theme = self._theme(state)
        if len(plan.motion.ball_path_m) > 1:
            path = shapes.polyline(plan.motion.ball_path_m)
            nodes.append(self._lines("/plan/path", path, theme.accent, 2.5))
        nodes += self._ellipses(plan, theme)
        if plan.impact_m is not None:
            cross = shapes.crosses(np.array([plan.impact_m]), 0.13)
            at = (0.0, 0.0, LIFT_M - plan.impact_m[2] + plan.target_m[2])
            nodes.append(self._lines("/plan/impact", cross, theme.accent, 2.5, at))

    def _ellipses(self, plan: PlanView, theme: Theme) -> list[Node]:
        if plan.ellipse is None:
            return []
        nodes: list[Node] = []
        for sigma, fill in ((2.0, 0.16), (1.0, 0.30)):
            outline = shapes.landing_ellipse(plan.ellipse, plan.target_m, sigma)
            at = (0.0, 0.0, LIFT_M * (0.5 if sigma == 2.0 else 0.7))
            name = f"/plan/sigma{sigma:.0f}"
            nodes.append(self._flat(f"{name}_fill", shapes.fan(outline), theme.accent, fill, at))
            nodes.append(self._lines(name, shapes.polyline(outline), theme.accent, 1.6, at))
        return nodes

    # Machines -------------------------------------------------------------------------------------

    def show_live(self, sample: LiveSample | None, *, is_hidden: bool) -> None:
        """Follow the live machine; hidden while a throw is replayed or no machine is chosen."""
        if sample is None:
            if self._live is not None:
                self._live.remove()
                self._live = None
                self._lost_text = None
                self._clear("lost")
            self._sample_number = -1
            self._show_ball("live", None)
            return
        if self._live is None:
            self._live = MachineNodes(self._scene, "/live", self._kit)
        self._live.set_visible(not is_hidden)
        if sample.number == self._sample_number and not is_hidden:
            return
        self._sample_number = sample.number
        with self.client.atomic():
            self._live.pose(sample.joints_rad_m)
            self._live.show_load(sample.is_load_held)
            self._show_ball("live", None if is_hidden else sample.ball_m)

    def show_lost(self, text: str | None, state: SessionView) -> None:
        """Say that the live machine is lost and grey it; None takes that back."""
        if text == self._lost_text or self._live is None:
            return
        if (text is None) != (self._lost_text is None):
            lost = self._theme(state).lost
            self._live.set_tint(None if text is None else Tint(lost, LOST_RATIO))
        self._lost_text = text
        nodes = self._groups.get("lost", [])
        if text is None:
            self._clear("lost")
        elif nodes and isinstance(nodes[0], viser.LabelHandle):
            nodes[0].text = text
        else:
            self._groups["lost"] = [self._label("/lost", text, (0.0, 0.0, 4.6), 2.2)]

    def show_ghost(self, moment: Moment | None, state: SessionView) -> None:
        """Draw the previewed machine at a moment; None takes it away."""
        if moment is None:
            self._drop_ghost()
            return
        if self._ghost is None:
            tint = Tint(self._theme(state).accent, GHOST_RATIO)
            self._ghost = MachineNodes(self._scene, "/ghost", self._kit, tint)
        with self.client.atomic():
            self._ghost.pose(moment.joints_rad_m)
            self._ghost.show_load(moment.ball_m is None)
            self._show_ball("ghost", moment.ball_m)

    def _drop_ghost(self) -> None:
        if self._ghost is not None:
            self._ghost.remove()
            self._ghost = None
        self._show_ball("ghost", None)

    def show_replay(self, moment: Moment | None) -> None:
        """Draw the replayed machine at a moment; None takes it away."""
        if moment is None:
            if self._replay is not None:
                self._replay.remove()
                self._replay = None
            self._show_ball("replay", None)
            return
        if self._replay is None:
            self._replay = MachineNodes(self._scene, "/replay", self._kit)
        with self.client.atomic():
            self._replay.pose(moment.joints_rad_m)
            self._replay.show_load(moment.ball_m is None)
            self._show_ball("replay", moment.ball_m)

    def _show_ball(self, owner: str, at: Point | None) -> None:
        node = self._balls.get(owner)
        if at is None:
            if node is not None:
                node.visible = False
            return
        if node is None:
            ball = self._kit.glb[PAYLOAD]
            node = self._scene.add_glb(f"/ball_{owner}", ball, position=at)
            self._balls[owner] = node
        node.position = at
        node.visible = True
