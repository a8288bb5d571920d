"""What a machine's folder says about its server, so that `downrange machine --data` needs nothing else."""

import os
from pathlib import Path
from typing import Final

from pydantic import BaseModel, ConfigDict, ValidationError

from machine.errors import UsageError
from runtime.policies.slots import NO_FIRST_KEY
from runtime.process.machine_settings import MachineSettings

ENROLMENT_FILE: Final = "enrolment.json"
PASSWORD_FILE: Final = "password"
ROOT_CA_FILE: Final = "root-ca.pem"


class EnrolmentFile(BaseModel):
    """Options of `downrange machine` by which a machine was set up."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    machine_id: str
    site: str
    connect: tuple[str, ...]
    server_url: str
    driver: str
    driver_options: dict[str, str] = {}
    unit_seed_count: int = 0
    root_ca_file: Path | None = None
    policies_dir: Path
    calibration_file: Path | None = None

    def settings(self, data_dir: Path) -> MachineSettings:
        """The same as settings of the machine's processes."""
        return MachineSettings(
            **self.model_dump(),
            data_dir=data_dir,
            password_file=data_dir / PASSWORD_FILE,
            # The enrolment has bound it; whoever removes that says by which key it is bound anew.
            site_key=NO_FIRST_KEY,
        )


def read_enrolment(data_dir: Path) -> EnrolmentFile | None:
    """What the folder says; None for a machine that was set up by options.

    Raises:
        UsageError: the file cannot be read.
    """
    path = data_dir / ENROLMENT_FILE
    try:
        return EnrolmentFile.model_validate_json(path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValidationError) as error:
        raise UsageError(f"{path} cannot be read ({error}); enrol the machine again") from error


def write_private(path: Path, text: str) -> None:
    """Write a file that only its owner can read, as a whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".part")
    descriptor = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    with os.fdopen(descriptor, "w", encoding="utf-8") as file:
        os.fchmod(file.fileno(), 0o600)
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)
