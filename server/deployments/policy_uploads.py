"""Policy versions that people upload: bounded, checked, and in their place all at once or not at all.

A version is written to a folder of its own under `.incoming` and takes its place by one rename; what a
cut-off upload leaves there is removed at the next start.
"""

import os
import secrets
import shutil
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from machine.errors import PolicyError
from machine.policy_card import CARD_FILE, GOLDEN_FILE, POLICY_FILE, PolicyFiles, policy_of
from runtime.control.policy_file import MAX_FILE_BYTES
from server.accounts.accounts import Session
from server.accounts.audit_chain import AuditChain, Entry
from server.deployments.policy_checks import check_in_child
from server.errors import ApiError, ConflictError
from server.limits.disk_space import disk_standing
from server.plans.policy_store import UPLOAD_FILE, PolicyStore, UploadRecord
from server.schemas.history import PolicyView
from server.schemas.policies import PolicyState

LIMITS_BYTES: Final[Mapping[str, int]] = {
    POLICY_FILE: MAX_FILE_BYTES,
    CARD_FILE: 64 * 1024,
    GOLDEN_FILE: 256 * 1024,
}
"""Files of a version, and the most that each may have."""
UPLOAD_LIMIT_BYTES: Final = sum(LIMITS_BYTES.values()) + 64 * 1024
"""Of a whole upload with what separates its parts."""
MAX_OPEN_COUNT: Final = 50
"""Versions that are neither approved nor retired."""
INCOMING: Final = ".incoming"
NAMES: Final = f"{POLICY_FILE}, {CARD_FILE} and {GOLDEN_FILE}"


class PolicyUploads:
    """Takes versions in; thread-safe."""

    def __init__(
        self,
        policies: PolicyStore,
        audit: AuditChain,
        folder: Path,
        min_free_bytes: int = 0,
    ) -> None:
        """Begin.

        Args:
            policies: the versions that are here.
            audit: notes uploads.
            folder: of uploaded versions.
            min_free_bytes: that the disk keeps.
        """
        self._min_free_bytes = min_free_bytes
        self._policies = policies
        self._audit = audit
        self._folder = folder
        self._lock = threading.Lock()

    def start(self) -> None:
        """Remove what a cut-off upload has left."""
        shutil.rmtree(self._folder / INCOMING, ignore_errors=True)

    def add(self, contents: Mapping[str, bytes], reason: str, session: Session) -> PolicyView:
        """Check a version and take it in.

        Args:
            contents: of its files by name.
            reason: why, for the history.
            session: who uploads.

        Raises:
            ApiError: it is incomplete or cannot be used, with what is wrong.
            ConflictError: the network, or a version of that name, is here already, too many versions are
                open, or the disk is full or refuses.
        """
        files = self._checked(contents)
        card = files.card
        with self._lock:
            self._require_new(files)
            self._require_space(contents)
            record = UploadRecord(uploaded_by=session.username, reason=reason)
            detail = {"policy_id": card.policy_id, "policy_sha256": card.policy_sha256}
            self._audit.record(Entry(session.actor, "policy.upload", "fact", detail=dict(detail)))
            try:
                self._place(card.policy_id, contents, record)
            except OSError as error:
                self._audit.record(
                    Entry(session.actor, "policy.upload.failed", "fact", detail=dict(detail))
                )
                raise ConflictError(
                    "disk", f"{card.policy_id} cannot be written, nothing has changed: {error}"
                ) from error
            self._policies.look_again()
        return self._policies.view(card.policy_sha256)

    def _checked(self, contents: Mapping[str, bytes]) -> PolicyFiles:
        for name in contents:
            if name not in LIMITS_BYTES:
                raise ApiError(
                    "policy_refused",
                    f"{name[:60]!r} does not belong to a version, which is {NAMES}.",
                )
        for name, limit_bytes in LIMITS_BYTES.items():
            if name not in contents:
                raise ApiError("policy_refused", f"{name} is missing; a version is {NAMES}.")
            if len(contents[name]) > limit_bytes:
                raise ApiError(
                    "policy_refused",
                    f"{name} has {len(contents[name])} bytes, at most {limit_bytes} are taken.",
                )
        try:
            files = policy_of(
                Path("upload"), contents[POLICY_FILE], contents[CARD_FILE], contents[GOLDEN_FILE]
            )
            check_in_child(files)
        except PolicyError as error:
            sentence = str(error).removeprefix("upload/").removeprefix("upload: ").rstrip(".")
            raise ApiError("policy_refused", f"{sentence}.") from error
        return files

    def _require_space(self, contents: Mapping[str, bytes]) -> None:
        folder = self._folder if self._folder.is_dir() else self._folder.parent
        needed_bytes = self._min_free_bytes + sum(len(content) for content in contents.values())
        standing = disk_standing(folder, needed_bytes)
        if standing != "ok":
            raise ConflictError("disk", f"The server's disk takes no version: {standing}.")

    def _require_new(self, files: PolicyFiles) -> None:
        card = files.card
        views = self._policies.views()
        closed = (PolicyState.APPROVED, PolicyState.RETIRED)
        if sum(v.is_present and v.state not in closed for v in views) >= MAX_OPEN_COUNT:
            raise ConflictError(
                "too_many_versions",
                f"{MAX_OPEN_COUNT} versions are neither approved nor retired; retire some first.",
            )
        for known in views:
            if known.policy_sha256 == card.policy_sha256:
                raise ConflictError(
                    "policy_known",
                    f"This network is here already as {known.policy_id} ({known.state.value}).",
                )
            if known.policy_id == card.policy_id:
                raise ConflictError(
                    "policy_name",
                    f"Another version is called {card.policy_id} already; export this one with another "
                    "policy id.",
                )

    def _place(self, policy_id: str, contents: Mapping[str, bytes], record: UploadRecord) -> None:
        """Write the version and give it its place; the rename is what makes it one."""
        incoming = self._folder / INCOMING / secrets.token_hex(8)
        incoming.mkdir(parents=True)
        try:
            for name, content in contents.items():
                _write(incoming / name, content)
            _write(incoming / UPLOAD_FILE, record.model_dump_json(indent=2).encode() + b"\n")
            _sync(incoming)
            # Fails where the name is taken by a folder that is not empty.
            incoming.rename(self._folder / policy_id)
            _sync(self._folder)
        except BaseException:
            shutil.rmtree(incoming, ignore_errors=True)
            raise


def _write(path: Path, content: bytes) -> None:
    with path.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def _sync(folder: Path) -> None:
    """Make names in a folder durable."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
