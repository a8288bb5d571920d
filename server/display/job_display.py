"""Bulk material of open jobs in the 3D view of each session."""

import threading
from collections.abc import Callable

from server.viewer.scene import ViewerScene
from server.viewer.shapes import LaidMaterial


class JobDisplay:
    """Draws the material around the machine that each session watches."""

    def __init__(
        self, scene: ViewerScene, material_of: Callable[[str], LaidMaterial | None]
    ) -> None:
        """Begin.

        Args:
            scene: the 3D view.
            material_of: material of a machine's open job; None without one.
        """
        self._scene = scene
        self._material_of = material_of
        self._lock = threading.Lock()
        self._watched: dict[str, str] = {}

    def watch(self, session_id: str, machine_id: str) -> None:
        """Show the material around a machine to a session."""
        with self._lock:
            self._watched[session_id] = machine_id
        self._scene.set_material(session_id, self._material_of(machine_id))

    def refresh(self, machine_id: str) -> None:
        """Redraw the material in all sessions that watch a machine."""
        with self._lock:
            sessions = [key for key, watched in self._watched.items() if watched == machine_id]
        if sessions:
            material = self._material_of(machine_id)
            for session_id in sessions:
                self._scene.set_material(session_id, material)

    def end_session(self, session_id: str) -> None:
        """Forget a session."""
        with self._lock:
            self._watched.pop(session_id, None)
