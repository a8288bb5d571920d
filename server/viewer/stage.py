"""The one thread that draws all 3D views: browsers come and go, machines move, throws are played.

Everything that touches a browser's scene runs here, in order; callers hand in what they want as jobs.
"""

import contextlib
import logging
import queue
import threading
import time
from collections.abc import Callable, Coroutine
from pathlib import Path

import numpy as np
import viser

from machine.spec import MachineSpec
from server.viewer.nodes import MachineKit
from server.viewer.pick import PickRefusedError, Ray, pick_surface
from server.viewer.state import LiveSample, Point, ShownSession
from server.viewer.theme import VIEWPOINTS
from server.viewer.view import ClientView
from server.viewer.viewer_server import ViewerServer

logger = logging.getLogger(__name__)

TICK_S = 1.0 / 60.0
"""How often new samples are looked for; a machine sends 25 a second (machine.channels)."""
FRAME_S = 1.0 / 30.0
"""Frames of previews and replays."""
GHOST_LINGER_S = 0.8
"""The ghost stays this long at the end of its one play."""

MAX_SESSIONS = 1000
"""Beyond this the oldest session that no browser watches is forgotten; it is set anew when it returns."""

OnPick = Callable[[str, Point], None]
OnPickRefused = Callable[[str, PickRefusedError], None]
Change = Callable[[ShownSession], None]
Draw = Callable[[ClientView, ShownSession], None]


class ViewerStage:
    """Sessions, their browsers and the thread that draws them."""

    def __init__(
        self,
        spec: MachineSpec,
        mjcf_path: Path,
        on_pick: OnPick,
        on_pick_refused: OnPickRefused | None,
        *,
        shadows: bool,
    ) -> None:
        self._spec = spec
        self._mjcf_path = mjcf_path
        self._on_pick = on_pick
        self._on_pick_refused = on_pick_refused
        self._shadows = shadows
        self._kit: MachineKit | None = None
        self._gate: ViewerServer | None = None
        self._thread: threading.Thread | None = None
        self._jobs: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._sessions: dict[str, ShownSession] = {}
        self._views: dict[int, tuple[str, ClientView]] = {}
        self._lock = threading.Lock()
        self._samples: dict[str, LiveSample] = {}
        self._lost_since_s: dict[str, float] = {}
        self._drags: dict[str, Ray] = {}
        """Newest pointer of sessions whose target is being dragged."""
        self._next_frame_s = 0.0

    def start(self) -> None:
        """Mesh the machine, open the loopback server and start drawing."""
        self._kit = MachineKit.load(self._spec, self._mjcf_path)
        self._gate = ViewerServer()
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
    def gate(self) -> ViewerServer:
        """The loopback server."""
        if self._gate is None:
            raise RuntimeError("The 3D view has not been started; call start() first.")
        return self._gate

    def client_count(self, session_id: str) -> int:
        """How many browsers of a session are connected and drawn."""
        return sum(owner == session_id for owner, _ in list(self._views.values()))

    def session(self, session_id: str) -> ShownSession | None:
        """What a session shows, to be read only."""
        return self._sessions.get(session_id)

    def take_sample(self, machine_id: str, sample: LiveSample) -> None:
        """Keep the newest sample of a machine; its number is set here."""
        with self._lock:
            before = self._samples.get(machine_id)
            number = 0 if before is None else before.number + 1
            self._samples[machine_id] = sample._replace(number=number)
            self._lost_since_s.pop(machine_id, None)

    def mark_lost(self, machine_id: str, last_seen_s_ago: float) -> None:
        """Remember when a machine was last seen."""
        with self._lock:
            self._lost_since_s[machine_id] = time.monotonic() - last_seen_s_ago

    def apply(self, session_id: str, change: Change, draw: Draw | None) -> None:
        """Change what a session shows and draw the change in all its browsers, in the drawing thread."""

        def job() -> None:
            state = self._state_of(session_id)
            change(state)
            if draw is None:
                return
            for owner, view in list(self._views.values()):
                if owner == session_id and ViewerServer.is_open(view.client):
                    draw(view, state)

        self._jobs.put(job)

    def move_target(self, session_id: str, target_m: Point | None) -> None:
        """Set, move or remove a session's target mark, and the ellipse with it."""

        def draw(view: ClientView, state: ShownSession) -> None:
            view.marks.draw_target(state)
            if state.plan is not None and state.plan.is_estimate:
                view.marks.draw_plan(state)
                view.show_ghost(None, state)
            view.client.flush()

        self.apply(session_id, lambda state: state.move_target(target_m), draw)

    def _state_of(self, session_id: str) -> ShownSession:
        if session_id not in self._sessions and len(self._sessions) >= MAX_SESSIONS:
            watched = {owner for owner, _ in self._views.values()}
            oldest = next((name for name in self._sessions if name not in watched), None)
            self._sessions.pop(oldest or "", None)
        return self._sessions.setdefault(session_id, ShownSession())

    def forget(self, session_id: str) -> None:
        """Drop a session and stop drawing its browsers."""

        def job() -> None:
            self._sessions.pop(session_id, None)
            self._views = {k: v for k, v in self._views.items() if v[0] != session_id}

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
            views = [view for view in views if ViewerServer.is_open(view.client)]
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
    def _play(state: ShownSession, views: list[ClientView], now_s: float) -> None:
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

    # Browsers (called by viser's threads) -----------------------------------------------------------

    def _connected(self, client: viser.ClientHandle) -> None:
        session_id = self.gate.session_of(client.client_id)
        if session_id is None:
            return
        client.scene.on_click()(lambda event: self._clicked(session_id, event))
        client.camera.on_update(self._reshaped(session_id, client))
        self._jobs.put(lambda: self._add_view(session_id, client))

    def _reshaped(
        self, session_id: str, client: viser.ClientHandle
    ) -> Callable[[viser.CameraHandle], Coroutine[None, None, None]]:
        """Fits the camera when a browser's picture or lens is another; most updates are only of its place."""
        last = (0.0, 0.0)

        async def updated(camera: viser.CameraHandle) -> None:
            nonlocal last
            # The field of view too: a slow browser may have sent its previous one in between.
            if (camera.aspect, camera.fov) != last:
                last = (camera.aspect, camera.fov)
                self._jobs.put(lambda: self._fit(session_id, client.client_id))

        return updated

    def _fit(self, session_id: str, client_id: int) -> None:
        _, view = self._views.get(client_id, ("", None))
        if view is not None and ViewerServer.is_open(view.client):
            view.fit_camera(self._state_of(session_id))

    def _add_view(self, session_id: str, client: viser.ClientHandle) -> None:
        if self._kit is None or not ViewerServer.is_open(client):
            return
        state = self._state_of(session_id)
        view = ClientView(
            client,
            self._kit,
            state,
            on_target_drag=lambda ray: self._dragged(session_id, ray),
            shadows=self._shadows,
        )
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
            point = pick_surface(ray, state.site)
        except PickRefusedError as refusal:
            if self._on_pick_refused is not None:
                self._on_pick_refused(session_id, refusal)
            return
        if state.pick_for == "target":
            # The mark first: the operator's eye is on it.
            self.move_target(session_id, point)
        self._on_pick(session_id, point)

    def _dragged(self, session_id: str, ray: Ray) -> None:
        """The pointer of a browser that drags the target; of several waiting ones only the newest counts."""
        with self._lock:
            is_waiting = session_id in self._drags
            self._drags[session_id] = ray
        if not is_waiting:
            self._jobs.put(lambda: self._follow_drag(session_id))

    def _follow_drag(self, session_id: str) -> None:
        with self._lock:
            ray = self._drags.pop(session_id)
        state = self._sessions.get(session_id)
        if state is None or state.machine_id is None or not state.is_picking:
            return
        if state.pick_for != "target":
            return
        # A pointer over the sky or a side moves nothing.
        with contextlib.suppress(PickRefusedError):
            point = pick_surface(ray, state.site)
            self.move_target(session_id, point)
            self._on_pick(session_id, point)


def lost_text(ago_s: float) -> str:
    """``Lost: last seen 14 s ago``, in minutes or hours when it is long ago."""
    if ago_s < 120.0:
        return f"Lost: last seen {max(0, int(ago_s))} s ago"
    if ago_s < 7200.0:
        return f"Lost: last seen {int(ago_s / 60.0)} min ago"
    return f"Lost: last seen {int(ago_s / 3600.0)} h ago"
