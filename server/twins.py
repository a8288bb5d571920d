"""Where the twin's knowledge about each machine lies: profile and valve calibration, files by machine."""

import threading
from pathlib import Path

from sim_twin.profile import load_profile


class TwinFiles:
    """`<data>/machines/<id>.profile.json` and `.calibration.json`; without a file the nominal values."""

    def __init__(self, data_dir: Path) -> None:
        self._folder = data_dir / "machines"
        self._lock = threading.Lock()
        self._versions: dict[tuple[Path, int], int] = {}

    def profile_path(self, machine_id: str) -> Path | None:
        """The machine's twin profile, None for the nominal one."""
        return _existing(self._folder / f"{machine_id}.profile.json")

    def calibration_path(self, machine_id: str) -> Path | None:
        """The machine's valve calibration, None for the nominal one."""
        return _existing(self._folder / f"{machine_id}.calibration.json")

    def profile_version(self, machine_id: str) -> int:
        """Version of the profile that previews use; 0 is the nominal one."""
        path = self.profile_path(machine_id)
        if path is None:
            return 0
        key = (path, path.stat().st_mtime_ns)
        with self._lock:
            if key not in self._versions:
                self._versions[key] = load_profile(path).version_count
            return self._versions[key]


def _existing(path: Path) -> Path | None:
    return path if path.is_file() else None
