"""Two slots a mode: the version in use, and the one before it. One small file, replaced as a whole.

Versions lie beside it in folders named by the policy's sha256. A version enters `versions/` by a rename, so
that a folder there is always complete.
"""

import json
import logging
import os
import shutil
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from machine.conventions import Mode
from machine.errors import PolicyError, UsageError
from machine.policy_approval import SiteTrust

logger = logging.getLogger(__name__)

INSTALLED: Final = ""
"""In place of a sha256: the version that was installed with the software (`--policies`)."""
SLOTS_FILE: Final = "slots.json"
TRUST_FILE: Final = "site.json"
NO_FIRST_KEY: Final = "refuse"
"""In place of a key's id: a machine that is bound to no site takes no site's list by itself."""
_SHA256: Final = r"^([0-9a-f]{64})?$"


def version_words(policy_sha256: str) -> str:
    """A version in words; `policy_sha256` is empty for the installed one."""
    return f"policy {policy_sha256[:12]}" if policy_sha256 else "the installed policy"


class ModeSlots(BaseModel):
    """The slots of one mode."""

    model_config = ConfigDict(frozen=True)
    current: str = Field(default=INSTALLED, pattern=_SHA256)
    """sha256 of the policy in use."""
    previous: str | None = Field(default=None, pattern=_SHA256)
    """The one before; None = there was none."""
    is_previous_rolled_back: bool = False
    """A rollback took `previous` out of use: no rollback leads to it until it has been deployed anew."""
    deployment_count: int = Field(default=0, ge=0)
    """Newest deployment of the server that was carried out or refused here."""
    rolled_back_s: float | None = Field(default=None, ge=0.0)
    """Unix time of a rollback at the machine after which no deployment was carried out or refused."""


_SLOTS: Final = TypeAdapter(dict[Mode, ModeSlots])


class PolicySlots:
    """The slots of one machine; safe from any thread."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._lock = threading.RLock()

    @property
    def incoming(self) -> Path:
        """Folder of versions on their way."""
        return self._folder / "incoming"

    def version_folder(self, policy_sha256: str) -> Path:
        """Where a complete version lies."""
        return self._folder / "versions" / policy_sha256

    def of(self, mode: Mode) -> ModeSlots:
        """The slots of a mode; those of a machine that never switched where the file cannot be read."""
        return self._read().get(mode, ModeSlots())

    def switch(
        self,
        mode: Mode,
        policy_sha256: str,
        deployment_count: int | None = None,
        *,
        is_rollback: bool = False,
    ) -> None:
        """Put a version into use; the one in use becomes the previous one. The same again changes nothing.

        Args:
            mode: whose slots.
            policy_sha256: the version; empty for the installed one.
            deployment_count: of the server; None where a person at the machine asked.
            is_rollback: no later rollback leads to the version now in use.

        Raises:
            OSError: the disk refuses; the slots are as before.
        """
        with self._lock:
            slots = self.of(mode)
            counted = max(slots.deployment_count, deployment_count or 0)
            changes: dict[str, Any] = {"deployment_count": counted}
            # Without a count, a person at the machine asked.
            changes["rolled_back_s"] = time.time() if deployment_count is None else None
            if policy_sha256 != slots.current:
                changes |= {"current": policy_sha256, "previous": slots.current}
                changes["is_previous_rolled_back"] = is_rollback
            self._write(mode, slots.model_copy(update=changes))

    def note(self, mode: Mode, deployment_count: int) -> None:
        """Remember that a deployment was refused, so that it is not tried again.

        Raises:
            OSError: the disk refuses.
        """
        with self._lock:
            slots = self.of(mode)
            if deployment_count > slots.deployment_count:
                changes = {"deployment_count": deployment_count, "rolled_back_s": None}
                self._write(mode, slots.model_copy(update=changes))

    def roll_back(self, mode: Mode) -> str:
        """Put the previous version into use; returns its sha256, empty for the installed one.

        Raises:
            UsageError: there is none, or it was rolled back from.
            OSError: the disk refuses.
        """
        with self._lock:
            previous = self.previous(mode)
            self.switch(mode, previous, is_rollback=True)
            return previous

    def previous(self, mode: Mode) -> str:
        """The version that a rollback leads to.

        Raises:
            UsageError: there is none, or it was rolled back from.
        """
        slots = self.of(mode)
        if slots.previous is None:
            raise UsageError(f"mode {mode.value} has no version before the one in use")
        if slots.is_previous_rolled_back:
            raise UsageError(
                f"mode {mode.value} has no version before {version_words(slots.current)} on this machine: "
                f"{version_words(slots.previous)} was rolled back; deploy the version that it is to have "
                "(`downrange policy deploy`)"
            )
        return slots.previous

    def rolled_back_from(self) -> dict[str, str]:
        """Mode -> version that a rollback at the machine took away, where no deployment came since."""
        return {
            mode.value: slots.previous
            for mode, slots in self._read().items()
            if slots.previous and slots.is_previous_rolled_back and slots.rolled_back_s is not None
        }

    def add(self, incoming: Path, policy_sha256: str) -> Path:
        """Take in a folder that is complete; returns where it lies now.

        Raises:
            OSError: the disk refuses.
        """
        folder = self.version_folder(policy_sha256)
        with self._lock:
            if folder.exists():
                shutil.rmtree(folder)
            folder.parent.mkdir(parents=True, exist_ok=True)
            incoming.rename(folder)
            _sync(folder.parent)
        return folder

    def remove_unused(self, kept: frozenset[str] = frozenset()) -> None:
        """Remove versions that no slot names, but for those to be kept."""
        with self._lock:
            slots = self._read().values()
            named = {s.current for s in slots} | {s.previous or "" for s in slots} | kept
            folder = self._folder / "versions"
            for path in folder.iterdir() if folder.is_dir() else ():
                if path.name not in named:
                    shutil.rmtree(path, ignore_errors=True)

    # What may be loaded ---------------------------------------------------------------------------

    def trust(self) -> SiteTrust | None:
        """The site's keys and approvals; None for a machine that is bound to no site yet.

        Raises:
            PolicyError: they cannot be read.
        """
        path = self._folder / TRUST_FILE
        try:
            return SiteTrust.model_validate_json(path.read_bytes())
        except FileNotFoundError:
            return None
        except (OSError, ValidationError) as error:
            raise PolicyError(
                f"{path} cannot be read, so no policy is known to be approved: {error}"
            ) from error

    def keep_trust(self, trust: SiteTrust, site_key: str | None = None) -> bool:
        """Store what the site's server says; whether it is news. The first one binds the machine.

        Args:
            trust: the site's list.
            site_key: id of the key by which the first list must be signed, or by which its key must have
                been vouched for; `NO_FIRST_KEY` = no first list is taken; None = any is.

        Raises:
            PolicyError: it is no newer list of the site that the machine is bound to, or may not bind it;
                nothing changes.
            OSError: the disk refuses.
        """
        with self._lock:
            known = self.trust()
            if known == trust:
                return False
            if known is None:
                trust.require_successor_of(_first_binding(trust, site_key))
                self._replace(TRUST_FILE, trust.model_dump_json(indent=2) + "\n")
                return True
            try:
                trust.require_successor_of(known)
            except PolicyError as error:
                raise PolicyError(
                    f"{error}; if that is meant, remove {self._folder / TRUST_FILE} at the machine"
                ) from error
            self._replace(TRUST_FILE, trust.model_dump_json(indent=2) + "\n")
            return True

    def _read(self) -> Mapping[Mode, ModeSlots]:
        path = self._folder / SLOTS_FILE
        try:
            return _SLOTS.validate_json(path.read_bytes())
        except FileNotFoundError:
            return {}
        except (OSError, ValidationError) as error:
            logger.error("%s cannot be read; the installed policies are used: %s", path, error)
            return {}

    def _write(self, mode: Mode, slots: ModeSlots) -> None:
        every = {**self._read(), mode: slots}
        body = {key.value: value.model_dump(mode="json") for key, value in every.items()}
        self._replace(SLOTS_FILE, json.dumps(body, indent=2) + "\n")

    def _replace(self, name: str, text: str) -> None:
        self._folder.mkdir(parents=True, exist_ok=True)
        part = self._folder / f"{name}.part"
        with part.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        part.replace(self._folder / name)
        _sync(self._folder)


def _first_binding(trust: SiteTrust, site_key: str | None) -> SiteTrust | None:
    if site_key == NO_FIRST_KEY:
        raise PolicyError(
            f"site {trust.site} shows key {trust.signed_by[:16]}, and this machine takes no key by itself: "
            "start it with --site-key and the key that page Policies of the console names"
        )
    return None if site_key is None else trust.bound_by(site_key)


def _sync(folder: Path) -> None:
    """Make renames in a folder durable."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
