"""Replays in a session's 3D view: the recorded throw replaces the live machine, the plan is a ghost."""

import threading

import numpy as np

from machine.site.objects import SiteObject
from server.accounts.accounts import Session
from server.errors import ConflictError, NotFoundError
from server.plans.plan_store import PlanStore
from server.plans.plan_views import plan_site
from server.schemas.history import ReplayRequest, ReplayView
from server.schemas.plans import PlanFrames
from server.throws.throw_logs import LogStore
from server.throws.throw_series import motion_of
from server.viewer.replay import ThrowMotion
from server.viewer.scene import ViewerScene


class ReplayControl:
    """Which session replays which throw."""

    def __init__(self, logs: LogStore, plans: PlanStore, scene: ViewerScene) -> None:
        self._logs = logs
        self._plans = plans
        self._scene = scene
        self._lock = threading.Lock()
        self._showing: dict[str, tuple[str, float]] = {}

    def control(
        self, throw_id: str, plan_id: str, request: ReplayRequest, session: Session
    ) -> ReplayView:
        """Start, steer or end a replay.

        Raises:
            ApiError: the throw has no log, or none with a motion.
        """
        session_id = session.session_id
        if request.close:
            with self._lock:
                self._showing.pop(session_id, None)
            self._scene.stop_replay(session_id)
            return ReplayView(throw_id=throw_id, duration_s=0.0, at_s=0.0, is_playing=False)
        with self._lock:
            showing = self._showing.get(session_id)
        if showing is not None and showing[0] == throw_id:
            is_new, duration_s = False, showing[1]
        else:
            is_new, duration_s = True, self._begin(throw_id, plan_id, session_id)
        playing = (
            request.playing
            if request.playing is not None
            else (None if request.at_s is not None and not is_new else request.at_s is None)
        )
        self._scene.replay_control(session_id, at_s=request.at_s, is_playing=playing)
        state = self._scene.replay_state(session_id)
        at_s = request.at_s or 0.0 if state is None or request.at_s is not None else state.at_s
        is_playing = bool(playing) if playing is not None else bool(state and state.is_playing)
        return ReplayView(
            throw_id=throw_id,
            duration_s=duration_s,
            at_s=min(at_s, duration_s),
            is_playing=is_playing,
        )

    def end_session(self, session_id: str) -> None:
        """Forget a session."""
        with self._lock:
            self._showing.pop(session_id, None)

    def _begin(self, throw_id: str, plan_id: str, session_id: str) -> float:
        try:
            motion = motion_of(self._logs.read(throw_id))
        except ValueError as error:
            raise ConflictError(
                "no_motion", f"Throw {throw_id} cannot be replayed: {error}."
            ) from error
        predicted, site = self._of_plan(plan_id)
        self._scene.replay(session_id, motion, predicted=predicted, is_playing=False, site=site)
        with self._lock:
            self._showing[session_id] = (throw_id, motion.duration_s)
        return motion.duration_s

    def _of_plan(self, plan_id: str) -> tuple[ThrowMotion | None, tuple[SiteObject, ...] | None]:
        """Predicted motion and site of a plan; None for what is not stored any more."""
        try:
            site = plan_site(self._plans.row(plan_id))
        except NotFoundError:
            return None, None  # the recording is shown without its plan
        try:
            return _motion_of_plan(self._plans.frames(plan_id)), site
        except NotFoundError:
            return None, site


def _motion_of_plan(frames: PlanFrames) -> ThrowMotion | None:
    if len(frames.frames_rad_m) < 2:
        return None
    return ThrowMotion(
        frames_rad_m=np.asarray(frames.frames_rad_m, dtype=np.float64),
        frame_period_s=frames.frame_period_s,
        ball_path_m=np.asarray(frames.ball_path_m, dtype=np.float64).reshape(-1, 3),
        release_s=frames.release_s,
        flight_s=frames.flight_s or 0.0,
    )
