"""Settings of a machine's processes; made by the command line, handed to both processes as JSON."""

from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, field_validator

from runtime.link.zenoh_config import NAME_PATTERN


class MachineSettings(BaseModel):
    """Options of `downrange machine`. A password is never part of them, only the name of its file."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    driver: str = Field(pattern=r"^[\w.]+:\w+$")
    """``package.module:Class``"""
    driver_options: dict[str, str] = {}
    """Keyword arguments of the driver class."""
    unit_seed_count: int = Field(default=0, ge=0)
    """Number of the virtual machine's unit; given to drivers that ask for a `unit_seed`."""
    machine_id: str
    site: str
    connect: tuple[str, ...] = ()
    """Zenoh endpoints of the server; empty = work alone, records wait on the disk."""
    username: str | None = None
    password_file: Path | None = None
    root_ca_file: Path | None = None
    """For ``tls/...`` endpoints."""
    server_url: str | None = None
    """Where throw logs are uploaded to; empty = they stay on the disk."""
    site_key: str | None = Field(default=None, pattern=r"^([0-9a-f]{16}|refuse)$")
    """Key that may bind the machine to its site; None = the first that it meets."""
    data_dir: Path
    policies_dir: Path
    calibration_file: Path | None = None
    is_real_time: bool = True
    """Ask the system for real-time scheduling and locked memory."""

    @field_validator("machine_id", "site")
    @classmethod
    def _is_name(cls, value: str) -> str:
        if not NAME_PATTERN.match(value):
            raise ValueError(f"{value!r} is no name: 1 to 32 of a-z 0-9 _ - and not first a sign")
        return value

    @property
    def database_file(self) -> Path:
        """Outbox and journal."""
        return self.data_dir / "machine.db"

    @property
    def latch_file(self) -> Path:
        """The latched stop or fault."""
        return self.data_dir / "latch"

    @property
    def hours_file(self) -> Path:
        """Hours of operation."""
        return self.data_dir / "hours.json"

    @property
    def throws_dir(self) -> Path:
        """Throw logs."""
        return self.data_dir / "throws"

    @property
    def policy_slots_dir(self) -> Path:
        """Versions that came from the server, and which of them is in use."""
        return self.data_dir / "policies"

    @property
    def lock_file(self) -> Path:
        """Held while processes of this machine run."""
        return self.data_dir / "machine.lock"

    def password(self) -> str:
        """The password; empty without a file.

        Raises:
            OSError: the file cannot be read.
        """
        if self.password_file is None:
            return ""
        return self.password_file.read_text(encoding="utf-8").strip()
