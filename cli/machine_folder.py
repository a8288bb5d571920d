"""Files of one machine in a folder of machines."""

from pathlib import Path
from typing import NamedTuple

from diagnosis.loading.kept_reference import KeptReference, kept_reference


class MachineFolder(NamedTuple):
    """Where a machine's files lie: ``FOLDER/MACHINE.*``."""

    folder: Path
    machine_id: str

    def file(self, ending: str) -> Path:
        """The file with an ending, such as ``valves.png``."""
        return self.folder / f"{self.machine_id}.{ending}"

    @property
    def calibration(self) -> Path:
        """Valve tables and registrations."""
        return self.file("calibration.json")

    @property
    def profile(self) -> Path:
        """Twin profile."""
        return self.file("profile.json")

    @property
    def reference(self) -> KeptReference:
        """Reference throws by day."""
        return kept_reference(self.folder, self.machine_id)
