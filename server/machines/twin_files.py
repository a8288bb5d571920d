"""Files of each machine's twin: profile and valve calibration."""

import hashlib
import os
import threading
from pathlib import Path

from diagnosis.loading.kept_reference import KeptReference, kept_reference
from machine.errors import UsageError
from machine.spec import MachineSpec, load_spec
from sim_twin.twin.profile import TwinProfile, load_profile, nominal_profile, profile_text


class TwinFiles:
    """`<data>/machines/<id>.profile.json` and `.calibration.json`; without a file the nominal values.

    Versions that were in use before lie beside it, as `<id>.profile.v<number>-<hash>.json`.
    """

    def __init__(self, data_dir: Path, spec: MachineSpec | None = None) -> None:
        self.folder = data_dir / "machines"
        """Everything that is kept of every machine."""
        self._spec = load_spec() if spec is None else spec
        self._lock = threading.Lock()
        self._versions: dict[tuple[Path, int], int] = {}

    def profile_path(self, machine_id: str) -> Path | None:
        """The machine's twin profile, None for the nominal one."""
        return _existing(self.folder / f"{machine_id}.profile.json")

    def calibration_path(self, machine_id: str) -> Path | None:
        """The machine's valve calibration, None for the nominal one."""
        return _existing(self.folder / f"{machine_id}.calibration.json")

    def profile(self, machine_id: str) -> TwinProfile:
        """The profile that previews use now."""
        path = self.profile_path(machine_id)
        return nominal_profile(self._spec) if path is None else load_profile(path)

    def file(self, machine_id: str, ending: str) -> Path:
        """Where a file of a machine lies that has this ending; it may be missing."""
        return self.folder / f"{machine_id}.{ending}"

    def reference(self, machine_id: str) -> KeptReference:
        """Reference throws that commissioning has kept."""
        return kept_reference(self.folder, machine_id)

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

    def kept(self, name: str) -> TwinProfile:
        """A version that was in use before, by the name that `replace` gave it.

        Raises:
            UsageError: its file is gone.
        """
        path = self.folder / Path(name).name
        if not path.is_file():
            raise UsageError(
                f"the twin profile's earlier version is not at {path}; bring the file back from a backup"
            )
        return load_profile(path)

    def replace(self, machine_id: str, profile: TwinProfile) -> str:
        """Put a new version in use, which previews read at once; returns where the old one is kept."""
        self.folder.mkdir(parents=True, exist_ok=True)
        before = self.profile(machine_id)
        digest = content_sha256(before)[:8]
        name = f"{machine_id}.profile.v{before.version_count}-{digest}.json"
        _write(profile_text(before), self.folder / name)
        _write(profile_text(profile), self.folder / f"{machine_id}.profile.json")
        return name


def content_sha256(profile: TwinProfile) -> str:
    """Hash of what a profile says, whatever its number."""
    text = profile_text(profile.model_copy(update={"version_count": 0}))
    return hashlib.sha256(text.encode()).hexdigest()


def _existing(path: Path) -> Path | None:
    return path if path.is_file() else None


def _write(text: str, path: Path) -> None:
    """Write a file atomically: a preview may be reading it."""
    scratch = path.with_name(f".{path.name}.part")
    with scratch.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    scratch.replace(path)
