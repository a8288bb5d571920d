"""The 3D view of all operators: what each session sees, and the one thread that draws it.

Display and picking only; nothing here moves a machine. All public methods may be called from any thread
or from a coroutine: they note what is asked and return, one thread does the drawing.
"""

import logging
import queue
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import viser

from machine.conventions import Array
from machine.messages import LandingEllipse
from machine.spec import MJCF_PATH, MachineSpec
from server.viewer_gate import ViewerGate
from server.viewer_nodes import MachineKit
from server.viewer_pick import PickRefusedError, Ray, pick_ground
from server.viewer_replay import Playback, ThrowMotion
from server.viewer_state import (
    ImpactMarks,
    LiveSample,
    PlanView,
    Point,
    Reach,
    ReplayState,
    SessionView,
    as_joints,
)
from server.viewer_theme import THEMES, VIEWPOINTS, CameraPreset, ThemeName
from server.viewer_view import ClientView

logger = logging.getLogger(__name__)

TICK_S = 1.0 / 60.0
"""How often new samples are looked for; a machine sends 25 a second (machine.channels)."""
FRAME_S = 1.0 / 30.0
"""Frames of previews and replays."""
GHOST_LINGER_S = 0.8
"""The ghost stays this long at the end of its one play."""

OnPick = Callable[[str, Point], None]
OnPickRefused = Callable[[str, PickRefusedError], None]


class ViewerScene:
    """Draws the view of every session on a viser server that only our proxy can reach."""

    def __init__(
        self,
        spec: MachineSpec,
        on_pick: OnPick,
        *,
        on_pick_refused: OnPickRefused | None = None,
        mjcf_path: Path = MJCF_PATH,
    ) -> None:
        """Prepare; nothing is opened before `start`.

        Args:
            spec: machine type that is drawn.
            on_pick: called with session id and point (m, frame `machine`) after a click on the ground,
                from a worker thread; the mark is drawn already.
            on_pick_refused: called when a click gave no target.
            mjcf_path: model whose visual geoms are drawn.
        """
        self._spec = spec
        self._on_pick = on_pick
        self._on_pick_refused = on_pick_refused
        self._mjcf_path = mjcf_path
        self._kit: MachineKit | None = None
        self._gate: ViewerGate | None = None
        self._thread: threading.Thread | None = None
        self._jobs: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._sessions: dict[str, SessionView] = {}
        self._views: dict[int, tuple[str, ClientView]] = {}
        self._lock = threading.Lock()
        self._samples: dict[str, LiveSample] = {}
        self._lost_since_s: dict[str, float] = {}
        self._next_frame_s = 0.0

    # Life -----------------------------------------------------------------------------------------

    def start(self) -> None:
        """Mesh the machine, open the loopback server and start drawing."""
        self._kit = MachineKit.load(self._spec, self._mjcf_path)
        self._gate = ViewerGate()
        camera = self._gate.server.initial_camera
        view = VIEWPOINTS["3d"]
        camera.position, camera.look_at, camera.fov = view.position_m, view.look_at_m, view.fov_rad
        self._thread = threading.Thread(target=self._run, name="viewer", daemon=True)
        self._thread.start()
        self._gate.server.on_client_connect(self._connected)
        self._gate.server.on_client_disconnect(self._disconnected)

    def close(self) -> None:
        """Stop drawing and close the server; harmless when not started."""
        if self._gate is None or self._thread is None:
            return
        self._jobs.put(None)
        self._thread.join(timeout=5.0)
        self._gate.stop()
        self._gate = self._thread = None

    @property
    def gate(self) -> ViewerGate:
        """The loopback server; for the proxy."""
        if self._gate is None:
            raise RuntimeError("The 3D view has not been started; call start() first.")
        return self._gate

    @property
    def port(self) -> int:
        """Loopback port of the view."""
        return self.gate.port

    def client_count(self, session_id: str) -> int:
        """How many browsers of a session are connected and drawn."""
        return sum(owner == session_id for owner, _ in list(self._views.values()))

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
        joints = as_joints(joints_rad_m)
        with self._lock:
            before = self._samples.get(machine_id)
            count = 0 if before is None else before.count + 1
            held = is_load_held and ball_m is None
            self._samples[machine_id] = LiveSample(count, joints, ball_m, held)
            self._lost_since_s.pop(machine_id, None)

    def mark_lost(self, machine_id: str, last_seen_s_ago: float) -> None:
        """Say in every view of this machine that it was last seen that long ago; the view counts on."""
        with self._lock:
            self._lost_since_s[machine_id] = time.monotonic() - last_seen_s_ago

    # Sessions -------------------------------------------------------------------------------------

    def show_machine(self, session_id: str, machine_id: str | None) -> None:
        """Choose the machine that a session watches; plan, replay and marks of another one go."""

        def change(state: SessionView) -> None:
            if state.machine_id == machine_id:
                return
            kept = (state.theme, state.camera, state.camera_count, state.is_picking)
            fresh = SessionView(machine_id=machine_id)
            fresh.theme, fresh.camera, fresh.camera_count, fresh.is_picking = kept
            state.__dict__.update(fresh.__dict__)

        def draw(view: ClientView, state: SessionView) -> None:
            view.show_live(None, is_hidden=False)
            view.show_replay(None)
            view.draw_all(state)

        self._apply(session_id, change, draw)

    def set_picking(self, session_id: str, is_picking: bool) -> None:
        """Let clicks place a target, or not."""
        self._apply(session_id, lambda state: setattr(state, "is_picking", is_picking), None)

    def set_pick_height(self, session_id: str, height_m: float) -> None:
        """Height of the plane on which clicks place the target."""
        self._apply(session_id, lambda state: setattr(state, "pick_height_m", height_m), None)

    def set_target(self, session_id: str, target_m: Point | None) -> None:
        """Show or take away the target mark."""
        self._apply(
            session_id,
            lambda state: setattr(state, "target_m", target_m),
            lambda view, state: view.draw_target(state, flush=True),
        )

    def set_reach(self, session_id: str, reach: Reach | None) -> None:
        """Show range rings and dim the ground out of reach."""
        self._apply(
            session_id,
            lambda state: setattr(state, "reach", reach),
            lambda view, state: view.draw_reach(state),
        )

    def set_zones(self, session_id: str, zones_m: Sequence[Array]) -> None:
        """Show exclusion zones: polygons (N, 2), m, frame `machine`."""
        zones = tuple(np.asarray(zone, dtype=np.float64).reshape(-1, 2) for zone in zones_m)
        self._apply(
            session_id,
            lambda state: setattr(state, "zones_m", zones),
            lambda view, state: view.draw_zones(state),
        )

    def set_theme(self, session_id: str, theme: ThemeName) -> None:
        """Light or dark."""
        if theme not in THEMES:
            raise ValueError(f"Theme {theme!r} is not one of {', '.join(THEMES)}.")

        def draw(view: ClientView, state: SessionView) -> None:
            view.rebuild(state)

        self._apply(session_id, lambda state: setattr(state, "theme", theme), draw)

    def set_camera(self, session_id: str, preset: CameraPreset) -> None:
        """Go to a preset: ``3d`` (start), ``top`` (map) or ``side``."""
        if preset not in VIEWPOINTS:
            raise ValueError(f"Camera {preset!r} is not one of {', '.join(VIEWPOINTS)}.")

        def change(state: SessionView) -> None:
            state.camera = preset
            state.camera_count += 1

        self._apply(session_id, change, lambda view, state: view.place_camera(state))

    def end_session(self, session_id: str) -> None:
        """Forget a session; its sockets are the proxy's to close."""
        self._jobs.put(lambda: self._forget(session_id))

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
        plan = PlanView(target_m, motion, impact_m, ellipse)

        def change(state: SessionView) -> None:
            state.plan, state.target_m = plan, target_m
            state.preview = Playback(motion) if play else None

        def draw(view: ClientView, state: SessionView) -> None:
            view.draw_target(state)
            view.draw_plan(state)

        self._apply(session_id, change, draw)

    def update_ellipse(self, session_id: str, ellipse: LandingEllipse) -> None:
        """Show a landing ellipse that came after the preview."""

        def change(state: SessionView) -> None:
            if state.plan is not None:
                plan = state.plan
                state.plan = PlanView(plan.target_m, plan.motion, plan.impact_m, ellipse)

        self._apply(session_id, change, lambda view, state: view.draw_plan(state))

    def play_preview(self, session_id: str) -> None:
        """Play the plan's ghost once more."""

        def change(state: SessionView) -> None:
            if state.plan is not None:
                state.preview = Playback(state.plan.motion)

        self._apply(session_id, change, None)

    def clear_plan(self, session_id: str) -> None:
        """Take the preview away; the target mark stays."""

        def change(state: SessionView) -> None:
            state.plan = state.preview = None

        self._apply(session_id, change, lambda view, state: view.draw_plan(state))

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
        self._apply(
            session_id,
            lambda state: setattr(state, "impacts", marks),
            lambda view, state: view.draw_impacts(state),
        )

    def replay(
        self,
        session_id: str,
        motion: ThrowMotion,
        *,
        predicted: ThrowMotion | None = None,
        is_playing: bool = True,
    ) -> None:
        """Replay a throw in place of the live machine; `predicted` runs along as a ghost."""

        def change(state: SessionView) -> None:
            state.replay = Playback(motion, is_playing=is_playing)
            state.replay_ghost = None if predicted is None else Playback(predicted, False)

        self._apply(session_id, change, None)

    def replay_control(
        self,
        session_id: str,
        *,
        at_s: float | None = None,
        is_playing: bool | None = None,
        speed_ratio: float = 1.0,
    ) -> None:
        """Seek, play or pause the running replay."""

        def change(state: SessionView) -> None:
            if state.replay is None:
                return
            if is_playing is not None:
                state.replay.play(is_playing, speed_ratio)
            if at_s is not None:
                state.replay.seek(at_s)

        self._apply(session_id, change, None)

    def stop_replay(self, session_id: str) -> None:
        """Return to the live machine."""

        def change(state: SessionView) -> None:
            state.replay = state.replay_ghost = None

        def draw(view: ClientView, state: SessionView) -> None:
            view.show_replay(None)
            view.show_ghost(None, state)

        self._apply(session_id, change, draw)

    def replay_state(self, session_id: str) -> ReplayState | None:
        """Where the session's replay stands; None when there is none."""
        state = self._sessions.get(session_id)
        playback = None if state is None else state.replay
        if playback is None:
            return None
        return ReplayState(playback.at_s, playback.motion.duration_s, playback.is_playing)

    # Drawing thread -------------------------------------------------------------------------------

    def _apply(
        self,
        session_id: str,
        change: Callable[[SessionView], None],
        draw: Callable[[ClientView, SessionView], None] | None,
    ) -> None:
        def job() -> None:
            state = self._sessions.setdefault(session_id, SessionView())
            change(state)
            if draw is None:
                return
            for owner, view in list(self._views.values()):
                if owner == session_id and ViewerGate.is_open(view.client):
                    draw(view, state)

        self._jobs.put(job)

    def _run(self) -> None:
        while True:
            try:
                job = self._jobs.get(timeout=TICK_S if self._views else None)
            except queue.Empty:
                self._guarded(self._tick)
                continue
            if job is None:
                return
            self._guarded(job)
            self._guarded(self._tick)

    @staticmethod
    def _guarded(job: Callable[[], None]) -> None:
        try:
            job()
        except Exception:
            # One view's trouble (a browser that left in mid-draw) must not end everyone's view.
            logger.exception("3D view: a drawing job failed")

    def _tick(self) -> None:
        now = time.monotonic()
        with self._lock:
            samples, lost = dict(self._samples), dict(self._lost_since_s)
        is_frame = now >= self._next_frame_s
        if is_frame:
            self._next_frame_s = now + FRAME_S
        for session_id, state in self._sessions.items():
            views = [view for owner, view in self._views.values() if owner == session_id]
            views = [view for view in views if ViewerGate.is_open(view.client)]
            if not views:
                continue
            sample = None if state.machine_id is None else samples.get(state.machine_id)
            since_s = None if state.machine_id is None else lost.get(state.machine_id)
            for view in views:
                view.show_live(sample, is_hidden=state.replay is not None)
                view.show_lost(None if since_s is None else lost_text(now - since_s), state)
            if is_frame:
                self._play(state, views, now)

    @staticmethod
    def _play(state: SessionView, views: list[ClientView], now_s: float) -> None:
        if state.replay is not None:
            moment = state.replay.advance(now_s)
            ghost = None
            if state.replay_ghost is not None:
                state.replay_ghost.seek(state.replay.at_s)
                ghost = state.replay_ghost.advance(now_s)
            for view in views:
                view.show_replay(moment)
                view.show_ghost(ghost, state)
        elif state.preview is not None:
            moment = state.preview.advance(now_s)
            if state.preview.ended_for_s(now_s) > GHOST_LINGER_S:
                state.preview = None
            for view in views:
                view.show_ghost(None if state.preview is None else moment, state)

    def _forget(self, session_id: str) -> None:
        self._sessions.pop(session_id, None)
        self._views = {k: v for k, v in self._views.items() if v[0] != session_id}

    # Browsers (called by viser's threads) -----------------------------------------------------------

    def _connected(self, client: viser.ClientHandle) -> None:
        session_id = self.gate.session_of(client.client_id)
        if session_id is None:
            return
        client.scene.on_click()(lambda event: self._clicked(session_id, event))
        self._jobs.put(lambda: self._add_view(session_id, client))

    def _add_view(self, session_id: str, client: viser.ClientHandle) -> None:
        if self._kit is None or not ViewerGate.is_open(client):
            return
        state = self._sessions.setdefault(session_id, SessionView())
        view = ClientView(client, self._kit, state)
        self._views[client.client_id] = (session_id, view)
        view.draw_all(state)
        client.flush()

    def _disconnected(self, client: viser.ClientHandle) -> None:
        self._jobs.put(lambda: self._drop_view(client.client_id))

    def _drop_view(self, client_id: int) -> None:
        self._views.pop(client_id, None)

    def _clicked(self, session_id: str, event: viser.SceneClickEvent) -> None:
        state = self._sessions.get(session_id)
        if state is None or state.machine_id is None or not state.is_picking:
            return
        ray = Ray(np.asarray(event.ray_origin), np.asarray(event.ray_direction))
        try:
            point = pick_ground(ray, state.pick_height_m)
        except PickRefusedError as refusal:
            if self._on_pick_refused is not None:
                self._on_pick_refused(session_id, refusal)
            return
        # The mark first: the operator's eye is on it.
        self.set_target(session_id, point)
        self._on_pick(session_id, point)


def lost_text(ago_s: float) -> str:
    """``Lost: last seen 14 s ago``, in minutes or hours when it is long ago."""
    if ago_s < 120.0:
        return f"Lost: last seen {max(0, int(ago_s))} s ago"
    if ago_s < 7200.0:
        return f"Lost: last seen {int(ago_s / 60.0)} min ago"
    return f"Lost: last seen {int(ago_s / 3600.0)} h ago"
