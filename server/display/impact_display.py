"""Past impacts in the 3D view: crosses at the newest impacts, the latest one labelled with its error."""

import threading

from sqlalchemy import select

from server.plans.landing_errors import point_of
from server.store.database import Database
from server.store.models import Impact, Throw
from server.throws.impacts import target_of
from server.viewer.scene import ViewerScene

SHOWN_COUNT = 60
"""More crosses hide each other."""
Point = tuple[float, float, float]


class ImpactDisplay:
    """Draws the past impacts of the machine that each session watches."""

    def __init__(self, database: Database, scene: ViewerScene) -> None:
        self._database = database
        self._scene = scene
        self._lock = threading.Lock()
        self._watched: dict[str, str] = {}

    def watch(self, session_id: str, machine_id: str) -> None:
        """Show the impacts of a machine to a session."""
        with self._lock:
            self._watched[session_id] = machine_id
        self._show(machine_id, [session_id])

    def end_session(self, session_id: str) -> None:
        """Forget a session."""
        with self._lock:
            self._watched.pop(session_id, None)

    def refresh(self, machine_id: str) -> None:
        """Redraw a machine's impacts in all sessions that watch it."""
        with self._lock:
            sessions = [key for key, watched in self._watched.items() if watched == machine_id]
        if sessions:
            self._show(machine_id, sessions)

    def _show(self, machine_id: str, sessions: list[str]) -> None:
        marks = self._newest(machine_id)
        latest, text = marks[0] if marks else (None, "")
        for session_id in sessions:
            self._scene.show_impacts(
                session_id, [point for point, _ in marks[1:]], latest=latest, latest_text=text
            )

    def _newest(self, machine_id: str) -> list[tuple[Point, str]]:
        """Points, frame `machine`, and their misses in words; newest first."""
        query = (
            select(Throw)
            .where(Throw.machine_id == machine_id, Throw.measured_downrange_error_m.is_not(None))
            .order_by(Throw.throw_id.desc())
            .limit(SHOWN_COUNT)
        )
        with self._database.read() as database:
            throws = list(database.scalars(query))
            ids = [throw.throw_id for throw in throws]
            rows = database.execute(
                select(Impact.throw_id, Impact.z_m)
                .where(Impact.throw_id.in_(ids))
                .order_by(Impact.impact_id)
            )
            heights_m = {row[0]: row[1] for row in rows}
            return [_mark(throw, heights_m.get(throw.throw_id)) for throw in throws]


def _mark(throw: Throw, height_m: float | None) -> tuple[Point, str]:
    target = target_of(throw)
    along_m = throw.measured_downrange_error_m or 0.0
    across_m = throw.measured_crossrange_error_m or 0.0
    x_m, y_m = point_of(target, along_m, across_m)
    words = (
        f"{abs(along_m):.2f} m {'long' if along_m >= 0.0 else 'short'}, "
        f"{abs(across_m):.2f} m {'left' if across_m >= 0.0 else 'right'}"
    )
    return (x_m, y_m, target.z_m if height_m is None else height_m), words
