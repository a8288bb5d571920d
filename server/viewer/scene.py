"""The 3D view as the service uses it: what each operator's session sees.

Display and picking only; nothing here moves a machine. All methods may be called from any thread or from
a coroutine: they note what is asked and return within microseconds, one thread does the drawing.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from machine.conventions import Array
from machine.messages import LandingEllipse
from machine.site.objects import SiteObject
from machine.site.zones import Corner, Zone
from machine.spec import MJCF_PATH, MachineSpec
from server.viewer.replay import Playback, ThrowMotion
from server.viewer.shapes import LaidMaterial
from server.viewer.stage import OnPick, OnPickRefused, ViewerStage
from server.viewer.state import (
    ImpactMarks,
    LiveSample,
    PickFor,
    Point,
    Reach,
    ReplayState,
    ShownPlan,
    ShownSession,
    ZoneOutline,
    as_joints,
)
from server.viewer.theme import THEMES, VIEWPOINTS, CameraPreset, ThemeName
from server.viewer.view import ClientView
from server.viewer.viewer_server import ViewerServer


class ViewerScene:
    """Draws the view of every session on a viser server that only our proxy can reach."""

    def __init__(
        self,
        spec: MachineSpec,
        on_pick: OnPick,
        *,
        on_pick_refused: OnPickRefused | None = None,
        mjcf_path: Path = MJCF_PATH,
        shadows: bool = True,
    ) -> None:
        """Prepare; nothing is opened before `start`.

        Args:
            spec: machine type that is drawn.
            on_pick: called with session id and point (m, frame `machine`) after a click on the ground,
                from a worker thread; the mark is drawn already.
            on_pick_refused: called when a click gave no target.
            mjcf_path: model whose visual geoms are drawn.
            shadows: draw shadows; without them a browser that renders in software is twice as fast.
        """
        self._stage = ViewerStage(spec, mjcf_path, on_pick, on_pick_refused, shadows=shadows)

    def start(self) -> None:
        """Mesh the machine, open the loopback server and start drawing; takes about a second."""
        self._stage.start()

    def close(self) -> None:
        """Stop drawing and close the server; harmless when not started."""
        self._stage.close()

    @property
    def gate(self) -> ViewerServer:
        """The loopback server; for the proxy."""
        return self._stage.gate

    @property
    def port(self) -> int:
        """Loopback port of the view."""
        return self.gate.port

    def client_count(self, session_id: str) -> int:
        """How many browsers of a session are connected and drawn."""
        return self._stage.client_count(session_id)

    # Machines -------------------------------------------------------------------------------------

    def update_machine(
        self,
        machine_id: str,
        joints_rad_m: Sequence[float] | Array,
        ball_m: Point | None = None,
        *,
        is_load_held: bool = True,
    ) -> None:
        """Take a live sample: joints (6,) and a load in flight, frame `machine`. Ends `mark_lost`."""
        held = is_load_held and ball_m is None
        self._stage.take_sample(machine_id, LiveSample(0, as_joints(joints_rad_m), ball_m, held))

    def mark_lost(self, machine_id: str, last_seen_s_ago: float) -> None:
        """Say in every view of this machine that it was last seen that long ago; the view counts on."""
        self._stage.mark_lost(machine_id, last_seen_s_ago)

    # Sessions -------------------------------------------------------------------------------------

    def show_machine(self, session_id: str, machine_id: str | None) -> None:
        """Choose the machine that a session watches; plan, replay and marks of another one go."""

        def change(state: ShownSession) -> None:
            if state.machine_id == machine_id:
                return
            kept = (
                state.theme,
                state.camera,
                state.camera_count,
                state.is_picking,
                state.pick_for,
            )
            fresh = ShownSession(machine_id=machine_id)
            fresh.theme, fresh.camera, fresh.camera_count, fresh.is_picking, fresh.pick_for = kept
            state.__dict__.update(fresh.__dict__)

        def draw(view: ClientView, state: ShownSession) -> None:
            view.show_live(None, is_hidden=False)
            view.show_replay(None)
            view.show_ghost(None, state)
            view.draw_all(state)

        self._stage.apply(session_id, change, draw)

    def set_picking(self, session_id: str, is_picking: bool) -> None:
        """Let clicks place a target, or not."""
        self._stage.apply(session_id, lambda state: setattr(state, "is_picking", is_picking), None)

    def set_pick_for(self, session_id: str, pick_for: PickFor) -> None:
        """Let clicks place the target, or only report their point."""
        self._stage.apply(session_id, lambda state: setattr(state, "pick_for", pick_for), None)

    def set_site(self, session_id: str, objects: Sequence[SiteObject]) -> None:
        """Show what stands around the machine; clicks place the target on it."""

        def change(state: ShownSession) -> None:
            state.site = tuple(objects)

        self._stage.apply(session_id, change, lambda view, state: view.draw_site(state))

    def set_material(self, session_id: str, material: LaidMaterial | None) -> None:
        """Show the bulk material of the machine's open job; None takes it away."""
        self._stage.apply(
            session_id,
            lambda state: setattr(state, "material", material),
            lambda view, state: view.draw_material(state),
        )

    def set_zones(self, session_id: str, active: Sequence[Zone], draft: Sequence[Zone]) -> None:
        """Show the approved exclusion zones, and those of a draft."""

        def change(state: ShownSession) -> None:
            state.zones, state.draft_zones = tuple(active), tuple(draft)

        self._stage.apply(session_id, change, lambda view, state: view.draw_zones(state))

    def set_sketch(
        self, session_id: str, corners_m: Sequence[Corner], bottom_m: float, top_m: float
    ) -> None:
        """Show the zone that is being drawn; no corners take it away."""
        sketch = ZoneOutline(tuple(corners_m), bottom_m, top_m)
        self._stage.apply(
            session_id,
            lambda state: setattr(state, "sketch", sketch),
            lambda view, state: view.draw_sketch(state),
        )

    def set_target(self, session_id: str, target_m: Point | None) -> None:
        """Show or take away the target mark; the ellipse of the last preview goes along as an estimate."""
        self._stage.move_target(session_id, target_m)

    def set_reach(self, session_id: str, reach: Reach | None) -> None:
        """Show range rings and dim the ground out of reach."""
        self._stage.apply(
            session_id,
            lambda state: setattr(state, "reach", reach),
            lambda view, state: view.marks.draw_reach(state, view.ground),
        )

    def set_theme(self, session_id: str, theme: ThemeName) -> None:
        """Light or dark."""
        if theme not in THEMES:
            raise ValueError(f"Theme {theme!r} is not one of {', '.join(THEMES)}.")

        def draw(view: ClientView, state: ShownSession) -> None:
            view.rebuild(state)

        self._stage.apply(session_id, lambda state: setattr(state, "theme", theme), draw)

    def set_camera(self, session_id: str, preset: CameraPreset) -> None:
        """Go to a preset: ``3d`` (start), ``top`` (map) or ``side``."""
        if preset not in VIEWPOINTS:
            raise ValueError(f"Camera {preset!r} is not one of {', '.join(VIEWPOINTS)}.")

        def change(state: ShownSession) -> None:
            state.camera = preset
            state.camera_count += 1

        self._stage.apply(session_id, change, lambda view, state: view.place_camera(state))

    def end_session(self, session_id: str) -> None:
        """Forget a session; its sockets are the proxy's to close."""
        self._stage.forget(session_id)

    # Throws ---------------------------------------------------------------------------------------

    def show_plan(
        self,
        session_id: str,
        target_m: Point,
        motion: ThrowMotion,
        *,
        impact_m: Point | None = None,
        ellipse: LandingEllipse | None = None,
        play: bool = True,
    ) -> None:
        """Show a preview: path and impact; the ghost machine plays once if asked."""
        plan = ShownPlan(target_m, motion, impact_m, ellipse)

        def change(state: ShownSession) -> None:
            state.take_plan(plan, play=play)

        def draw(view: ClientView, state: ShownSession) -> None:
            view.marks.draw_target(state)
            view.marks.draw_plan(state)

        self._stage.apply(session_id, change, draw)

    def update_ellipse(self, session_id: str, ellipse: LandingEllipse) -> None:
        """Show a landing ellipse that came after the preview."""

        def change(state: ShownSession) -> None:
            plan = state.plan
            if plan is not None and not plan.is_estimate:
                state.plan = ShownPlan(plan.target_m, plan.motion, plan.impact_m, ellipse)

        self._stage.apply(session_id, change, lambda view, state: view.marks.draw_plan(state))

    def play_preview(self, session_id: str) -> None:
        """Play the plan's ghost once more."""

        def change(state: ShownSession) -> None:
            if state.plan is not None and not state.plan.is_estimate:
                state.preview = Playback(state.plan.motion)

        self._stage.apply(session_id, change, None)

    def clear_plan(self, session_id: str) -> None:
        """Take the preview away; the target mark stays."""

        def change(state: ShownSession) -> None:
            state.plan = state.preview = None

        def draw(view: ClientView, state: ShownSession) -> None:
            view.marks.draw_plan(state)
            view.show_ghost(None, state)

        self._stage.apply(session_id, change, draw)

    def show_impacts(
        self,
        session_id: str,
        points_m: Sequence[Point] | Array,
        *,
        latest: Point | None = None,
        latest_text: str = "",
    ) -> None:
        """Show past impacts (N, 3) as crosses, and the newest one with its miss in words."""
        points = np.asarray(points_m, dtype=np.float64).reshape(-1, 3)
        marks = ImpactMarks(points, latest, latest_text)
        self._stage.apply(
            session_id,
            lambda state: setattr(state, "impacts", marks),
            lambda view, state: view.marks.draw_impacts(state),
        )

    def replay(
        self,
        session_id: str,
        motion: ThrowMotion,
        *,
        predicted: ThrowMotion | None = None,
        is_playing: bool = True,
        site: Sequence[SiteObject] | None = None,
    ) -> None:
        """Replay a throw in place of the live machine.

        Args:
            session_id: who watches.
            motion: what was recorded.
            predicted: runs along as a ghost.
            is_playing: whether it starts at once.
            site: what stood around the machine then; None draws what stands there now.
        """

        def change(state: ShownSession) -> None:
            state.replay = Playback(motion, is_playing=is_playing)
            state.replay_ghost = None if predicted is None else Playback(predicted, False)
            state.replay_site = None if site is None else tuple(site)

        def draw(view: ClientView, state: ShownSession) -> None:
            view.draw_site(state)
            view.draw_material(state)
            view.draw_zones(state)

        self._stage.apply(session_id, change, draw)

    def replay_control(
        self,
        session_id: str,
        *,
        at_s: float | None = None,
        is_playing: bool | None = None,
        speed_ratio: float = 1.0,
    ) -> None:
        """Seek, play or pause the running replay."""

        def change(state: ShownSession) -> None:
            if state.replay is None:
                return
            if is_playing is not None:
                state.replay.play(is_playing, speed_ratio)
            if at_s is not None:
                state.replay.seek(at_s)

        self._stage.apply(session_id, change, None)

    def stop_replay(self, session_id: str) -> None:
        """Return to the live machine."""

        def change(state: ShownSession) -> None:
            state.replay = state.replay_ghost = state.replay_site = None

        def draw(view: ClientView, state: ShownSession) -> None:
            view.draw_site(state)
            view.draw_material(state)
            view.draw_zones(state)
            view.show_replay(None)
            view.show_ghost(None, state)

        self._stage.apply(session_id, change, draw)

    def replay_state(self, session_id: str) -> ReplayState | None:
        """Where the session's replay stands; None when there is none."""
        state = self._stage.session(session_id)
        playback = None if state is None else state.replay
        if playback is None:
            return None
        return ReplayState(playback.at_s, playback.motion.duration_s, playback.is_playing)
