"""Fetches policy versions from the server by HTTP; goes on where it broke off, checks every hash."""

import http.client
import json
import logging
import os
import urllib.error
import urllib.parse
import urllib.request
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from machine.conventions import Mode
from machine.policy_approval import SiteTrust
from machine.policy_card import CARD_FILE, GOLDEN_FILE, POLICY_FILE
from runtime.policies.slots import PolicySlots
from runtime.records.log_upload import UploadTarget

logger = logging.getLogger(__name__)

TIMEOUT_S: Final = 10.0
CHUNK_BYTES: Final = 64 * 1024
ANSWER_LIMIT_BYTES: Final = 1024 * 1024
FILE_LIMIT_BYTES: Final = 8 * 1024 * 1024
"""As for the policy file itself (runtime/control/policy_file.py)."""
PARTIAL: Final = 206


class VersionFile(BaseModel):
    """One file of a version."""

    model_config = ConfigDict(frozen=True)
    name: str = Field(pattern=rf"^({POLICY_FILE}|{CARD_FILE}|{GOLDEN_FILE})$".replace(".", r"\."))
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
    size_bytes: int = Field(ge=1, le=FILE_LIMIT_BYTES)


class WantedPolicy(BaseModel):
    """The version that the server wants a machine to have in one mode."""

    model_config = ConfigDict(frozen=True)
    mode: Mode
    deployment_count: int = Field(ge=1)
    """Counts the deployments of a machine and mode; the machine acts on each once."""
    policy_sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
    is_rollback: bool = False
    """The version in use is not one to go back to; a server of older software does not say."""
    age_s: float = Field(default=0.0, ge=0.0)
    """Since it was asked for; a server of older software does not say."""
    files: tuple[VersionFile, ...]
    """Empty where the server does not have the version any more."""


class WantedPolicies(BaseModel):
    """What the server wants, one a mode at most."""

    model_config = ConfigDict(frozen=True)
    policies: tuple[WantedPolicy, ...]
    trust: SiteTrust | None = None
    """None from a server of older software."""


class TransferError(Exception):
    """The network, the server or the disk failed; to be tried again."""


def fetch_wanted(target: UploadTarget, trust: SiteTrust | None = None) -> WantedPolicies:
    """What the server wants this machine to have, and what the site has approved.

    Args:
        target: the server.
        trust: list on board; its number and the keys that it trusts go to the server.

    Raises:
        TransferError: no answer, or one that cannot be read.
    """
    try:
        with _open(target, f"policies/wanted{_query(trust)}") as answer:
            text = answer.read(ANSWER_LIMIT_BYTES)
        return WantedPolicies.model_validate_json(text)
    except (OSError, http.client.HTTPException, ValidationError) as error:
        raise TransferError(f"the wanted policies cannot be read: {error}") from error


def _query(trust: SiteTrust | None) -> str:
    if trust is None:
        return ""
    keys = [("key", key.key_id) for key in trust.keys if not key.is_revoked]
    return "?" + urllib.parse.urlencode([("list", trust.serial_count), *keys])


def has_version(wanted: WantedPolicy, slots: PolicySlots) -> bool:
    """Whether the version is complete on the disk, with the files that the server names."""
    folder = slots.version_folder(wanted.policy_sha256)
    is_usable = {file.name for file in wanted.files} >= {POLICY_FILE, CARD_FILE}
    return is_usable and all(_hash(folder / f.name) == f.sha256 for f in wanted.files)


def fetch_version(target: UploadTarget, wanted: WantedPolicy, slots: PolicySlots) -> Path:
    """The complete folder of a version, fetched where it is not there already.

    Raises:
        TransferError: it is not complete yet; what has come is kept.
    """
    if has_version(wanted, slots):
        return slots.version_folder(wanted.policy_sha256)
    if not {file.name for file in wanted.files} >= {POLICY_FILE, CARD_FILE}:
        raise TransferError(
            f"the server does not have policy {wanted.policy_sha256[:12]}... any more"
        )
    incoming = slots.incoming / wanted.policy_sha256
    try:
        incoming.mkdir(parents=True, exist_ok=True)
        for file in wanted.files:
            if _hash(incoming / file.name) != file.sha256:
                _fetch_file(target, wanted.policy_sha256, file, incoming)
        for path in incoming.iterdir():
            if path.name not in {file.name for file in wanted.files}:
                path.unlink()
        return slots.add(incoming, wanted.policy_sha256)
    except (OSError, http.client.HTTPException) as error:
        raise TransferError(
            f"policy {wanted.policy_sha256[:12]}... is not complete: {error}"
        ) from error


def _fetch_file(
    target: UploadTarget, policy_sha256: str, file: VersionFile, incoming: Path
) -> None:
    part = incoming / f"{file.name}.part"
    has_bytes = part.stat().st_size if part.exists() else 0
    if has_bytes >= file.size_bytes:
        part.unlink()
        has_bytes = 0
    headers = {"Range": f"bytes={has_bytes}-"} if has_bytes else {}
    with _open(target, f"policy-files/{policy_sha256}/{file.name}", headers) as answer:
        is_rest = answer.status == PARTIAL
        with part.open("ab" if is_rest else "wb") as out:
            room_bytes = file.size_bytes - (has_bytes if is_rest else 0)
            while room_bytes > 0 and (chunk := answer.read(min(CHUNK_BYTES, room_bytes))):
                out.write(chunk)
                room_bytes -= len(chunk)
            out.flush()
            os.fsync(out.fileno())
    if room_bytes > 0:
        raise TransferError(f"{file.name} broke off {room_bytes} bytes before its end")
    if _hash(part) != file.sha256:
        part.unlink()
        raise TransferError(f"{file.name} came with another hash than the server named")
    part.replace(incoming / file.name)


def _open(
    target: UploadTarget, path: str, headers: dict[str, str] | None = None
) -> Any:  # urllib has no type of its own for answers
    request = urllib.request.Request(
        f"{target.server_url.rstrip('/')}/api/v1/machines/{target.machine_id}/{path}",
        headers={"Authorization": f"Bearer {target.token}", **(headers or {})},
    )
    try:
        return urllib.request.urlopen(request, timeout=TIMEOUT_S)
    except urllib.error.HTTPError as error:
        with error:
            text = error.read(500).decode(errors="replace")
        raise TransferError(f"the server answers {error.code}: {_message(text)}") from error


def _message(text: str) -> str:
    try:
        return str(json.loads(text)["error"]["message"])
    except (ValueError, KeyError, TypeError):
        return text


def _hash(path: Path) -> str:
    try:
        return sha256(path.read_bytes()).hexdigest()
    except OSError:
        return ""
