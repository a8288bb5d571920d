"""One browser's scene: draws a session's view and keeps it in step. Runs in the view's own thread only."""

import numpy as np
import viser

from machine.conventions import wrap_angle_rad
from server.viewer.ground import GroundNodes
from server.viewer.marks import MarkNodes, OnTargetDrag
from server.viewer.nodes import PAYLOAD, MachineKit, MachineNodes, Tint
from server.viewer.replay import Moment
from server.viewer.state import LiveSample, Point, ShownSession
from server.viewer.theme import MAX_ORBIT_M, MIN_ORBIT_M, THEMES, VIEWPOINTS
from server.viewer.zone_nodes import ZoneNodes

GHOST_RATIO = 0.34
SAME_SLEW_RAD = 0.02
LOST_RATIO = 0.45


class ClientView:
    """The nodes of one connected browser."""

    def __init__(
        self,
        client: viser.ClientHandle,
        kit: MachineKit,
        state: ShownSession,
        *,
        on_target_drag: OnTargetDrag,
        shadows: bool,
    ) -> None:
        self.client = client
        self.marks = MarkNodes(client, on_target_drag)
        self._scene = client.scene
        self._kit = kit
        self._shadows = shadows
        self._live: MachineNodes | None = None
        self._ghost: MachineNodes | None = None
        self._replay: MachineNodes | None = None
        self._balls: dict[str, viser.GlbHandle] = {}
        self._shown: tuple[int, bool] | None = None
        self._camera_count = -1
        """Of the last preset gone to; a fresh browser goes to the session's, fitted to its picture."""
        self._lost_text: str | None = None
        self.ground = self._make_ground(state)
        self._zones = ZoneNodes(client.scene)
        client.camera.min_orbit_distance = MIN_ORBIT_M
        client.camera.max_orbit_distance = MAX_ORBIT_M

    def _make_ground(self, state: ShownSession) -> GroundNodes:
        theme = THEMES[state.theme]
        self.client.gui.configure_theme(
            dark_mode=theme.is_dark, show_logo=False, show_share_button=False
        )
        return GroundNodes(self._scene, theme, shadows=self._shadows)

    def rebuild(self, state: ShownSession) -> None:
        """Draw everything anew in the session's theme."""
        self.ground.remove()
        self.ground = self._make_ground(state)
        self.draw_all(state)

    def draw_site(self, state: ShownSession) -> None:
        """Draw what stands around the machine."""
        self.ground.draw_site(state.drawn_site)

    def draw_material(self, state: ShownSession) -> None:
        """Draw the bulk material of the open job."""
        self.ground.draw_material(state.drawn_material)

    def draw_zones(self, state: ShownSession) -> None:
        """Draw the exclusion zones of today; a replay shows none, as nobody asks what they were then."""
        is_live = state.replay is None
        active = state.zones if is_live else ()
        self._zones.draw(THEMES[state.theme], active, state.draft_zones if is_live else ())

    def draw_sketch(self, state: ShownSession) -> None:
        """Draw the zone that is being drawn."""
        self._zones.draw_sketch(THEMES[state.theme], *state.sketch)

    def draw_all(self, state: ShownSession) -> None:
        """Draw all marks of the session and place the camera; the machine follows with its sample."""
        self.draw_site(state)
        self.draw_material(state)
        self.draw_zones(state)
        self.draw_sketch(state)
        self.marks.draw_all(state, self.ground)
        self.place_camera(state)

    def place_camera(self, state: ShownSession) -> None:
        """Go to the asked camera preset, once an asking."""
        if state.camera_count == self._camera_count:
            return
        self._camera_count = state.camera_count
        view = VIEWPOINTS[state.camera]
        with self.client.atomic():
            self.fit_camera(state)
            self.client.camera.position = view.position_m
            self.client.camera.look_at = view.look_at_m

    def fit_camera(self, state: ShownSession) -> None:
        """Show as much from left to right after the picture got another shape, from the same place."""
        camera = self.client.camera
        camera.fov = VIEWPOINTS[state.camera].fov_of(camera.aspect)

    def show_live(self, sample: LiveSample | None, *, is_hidden: bool) -> None:
        """Follow the live machine; hidden while a throw is replayed or no machine is chosen."""
        if sample is None:
            if self._live is not None:
                self._live.remove()
                self._live = self._shown = self._lost_text = None
                self.marks.draw_lost(None)
            self._show_ball("live", None)
            return
        if self._live is None:
            self._live = MachineNodes(self._scene, "/live", self._kit)
        if self._shown == (sample.number, is_hidden):
            return
        self._shown = (sample.number, is_hidden)
        self._live.set_visible(not is_hidden)
        with self.client.atomic():
            self._live.pose(sample.joints_rad_m)
            self._live.show_load(sample.is_load_held)
            self._show_ball("live", None if is_hidden else sample.ball_m)

    def show_lost(self, text: str | None, state: ShownSession) -> None:
        """Say that the live machine is lost and grey it; None takes that back."""
        if text == self._lost_text or self._live is None:
            return
        if (text is None) != (self._lost_text is None):
            lost = THEMES[state.theme].lost
            self._live.set_tint(None if text is None else Tint(lost, LOST_RATIO))
        self._lost_text = text
        self.marks.draw_lost(text)

    def show_ghost(self, moment: Moment | None, state: ShownSession) -> None:
        """Draw what moves of the previewed machine at a moment; None takes it away."""
        if moment is None:
            self._drop_ghost()
            return
        if self._ghost is None:
            tint = Tint(THEMES[state.theme].accent, GHOST_RATIO)
            skip = self._ghost_skips(state)
            self._ghost = MachineNodes(self._scene, "/ghost", self._kit, tint, skip=skip)
        with self.client.atomic():
            self._ghost.pose(moment.joints_rad_m)
            self._ghost.show_load(moment.ball_m is None)
            self._show_ball("ghost", moment.ball_m)

    def _ghost_skips(self, state: ShownSession) -> frozenset[str]:
        """What stands where the solid machine's stands, and would only muddy its colours."""
        playback = state.replay_ghost or state.preview
        solid = self._replay or self._live
        if playback is None or solid is None:
            return frozenset({"chassis"})
        away = wrap_angle_rad(playback.motion.frames_rad_m[:, 0] - solid.joints_rad_m[0])
        stays = bool(np.abs(away).max() < SAME_SLEW_RAD)
        return frozenset({"chassis", "upper"} if stays else {"chassis"})

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
