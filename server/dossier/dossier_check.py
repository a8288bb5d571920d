"""Verify a dossier: every byte against the signed manifest, then what the members say of each other.

Needs the file alone. The public key in the file shows that nothing was altered since it was signed; who
signed is known only where the site's key comes from somewhere else.
"""

import base64
import binascii
import hashlib
import json
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, Final

from pydantic import ValidationError

from machine.errors import PolicyError, UsageError
from machine.messages import ThrowPlan
from machine.policy_approval import SiteKey, SiteTrust
from machine.policy_card import CARD_FILE, GOLDEN_FILE, POLICY_FILE, PolicyCard, PolicyFiles
from server.accounts.audit_seal import SEALED_FIELDS, seal_of
from server.dossier.signed_archive import (
    CHUNK_BYTES,
    MANIFEST_FILE,
    MAX_MANIFEST_BYTES,
    SIGNATURE_FILE,
    SIGNED_PREFIX,
    DossierError,
    DossierManifest,
    DossierSignature,
    Placed,
    directory_of,
    header_size,
    is_key_id_of,
    model_json,
    placed,
    read_header,
)

AUDIT_FILE: Final = "audit.jsonl"
KEYS_FILE: Final = "site_keys.json"
PLAN_FILE: Final = "plan.json"
THROW_FILE: Final = "throw.json"
LOG_FILE: Final = "log.mcap"
FIRED: Final = "fire"
LOGGED: Final = "throw.log"
HASH_NAMES: Final = {FIRED: "plan_hash", LOGGED: "log_sha256"}
"""Actions of the audit, and where their rows hold a hash."""
MAX_READ_BYTES: Final = 64 * 1024 * 1024
"""Largest member that is read as a whole, to check what it says."""


_UNREADABLE: Final = (ValueError, KeyError, TypeError, AttributeError, RecursionError)
"""What members raise that are signed but of another form: anybody can sign with a key of their own."""


@dataclass(slots=True)
class DossierVerdict:
    """What was found."""

    problems: list[str] = field(default_factory=list[str])
    """Altered parts, each by its name; empty: whole."""
    notes: list[str] = field(default_factory=list[str])
    manifest: DossierManifest | None = None
    key: SiteKey | None = None
    """That has signed it."""
    is_key_given: bool = False
    """The signing key was compared with one from outside of the file."""
    checked_plan_count: int = 0
    checked_audit_count: int = 0
    checked_policy_count: int = 0

    @property
    def is_whole(self) -> bool:
        """Whether nothing was altered."""
        return not self.problems


def public_keys(text: str) -> frozenset[str]:
    """Public keys, base64, from a key, a file with one a line, or a site's list of keys.

    Raises:
        UsageError: it is none of them.
    """
    path = Path(text)
    try:
        content = path.read_text(encoding="utf-8") if path.is_file() else text
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"key file {path} cannot be read: {error}") from error
    try:
        return frozenset(key.public_key for key in SiteTrust.model_validate_json(content).keys)
    except ValidationError:
        keys = frozenset(content.split())
    for key in keys:
        if _raw_key(key) is None:
            raise UsageError(
                f"{text[:60]!r} is no public key: 32 bytes in base64, as `downrange policy keys list` "
                "prints it, or a file with it"
            )
    if not keys:
        raise UsageError(f"{text[:60]!r} holds no public key")
    return keys


def _raw_key(text: str) -> bytes | None:
    try:
        raw = base64.b64decode(text, validate=True)
    except (ValueError, binascii.Error):
        return None
    return raw if len(raw) == 32 and base64.b64encode(raw).decode() == text else None


def check_dossier(path: Path, trusted: frozenset[str] = frozenset()) -> DossierVerdict:
    """Verify a file.

    Args:
        path: of the dossier.
        trusted: public keys of the site, base64; empty: only the file itself is checked.

    Raises:
        DossierError: it cannot be read.
    """
    try:
        with path.open("rb") as file:
            return check_open_dossier(file, trusted)
    except OSError as error:
        raise DossierError(f"{path} cannot be read: {error.strerror}") from error


def check_open_dossier(file: BinaryIO, trusted: frozenset[str] = frozenset()) -> DossierVerdict:
    """Verify an open file from its beginning, as `check_dossier`."""
    verdict = DossierVerdict(is_key_given=bool(trusted))
    _Reader(file, verdict, trusted).run()
    return verdict


class _Reader:
    """Walks the file once, from its first byte to its last."""

    def __init__(self, file: BinaryIO, verdict: DossierVerdict, trusted: frozenset[str]) -> None:
        self._file = file
        self._verdict = verdict
        self._trusted = trusted
        self._members: list[Placed] = []
        self._kept: dict[str, bytes] = {}
        """Contents that are compared with each other."""

    def run(self) -> None:
        problems = self._verdict.problems
        try:
            manifest = self._first(MANIFEST_FILE)
            signature = self._first(SIGNATURE_FILE)
            self._check_signature(manifest, signature)
            self._verdict.manifest = DossierManifest.model_validate_json(manifest)
        except (DossierError, ValidationError) as error:
            what = str(error) if isinstance(error, DossierError) else f"{MANIFEST_FILE} was altered"
            problems.append(what)
            return
        names = [member.name for member in self._verdict.manifest.members]
        if len(set(names)) < len(names):
            problems.append(f"{MANIFEST_FILE} names a member twice")
        for member in self._verdict.manifest.members:
            if not self._member(member.name, member.size_bytes, member.sha256):
                return
        rest = self._file.read(len(directory := directory_of(self._members)) + 1)
        if rest[: len(directory)] != directory:
            problems.append("the directory at the end of the file was altered")
        elif len(rest) > len(directory):
            problems.append("there are bytes after the end of the dossier")
        if problems:
            return
        try:
            check_contents(self._verdict, self._kept)
        except _UNREADABLE as error:
            problems.append(f"signed as it is, but its members cannot be read: {error}")

    def _first(self, name: str) -> bytes:
        """A member before the manifest is known."""
        header = self._file.read(header_size(name))
        size, _ = read_header(header[: header_size("")])
        if size > MAX_MANIFEST_BYTES:
            raise DossierError(f"the header of {name} was altered")
        content = self._file.read(size)
        found = placed(name, content)
        self._members.append(found)
        if found.header() != header:
            raise DossierError(f"{name} or its header was altered")
        return content

    def _check_signature(self, manifest: bytes, content: bytes) -> None:
        try:
            signature = DossierSignature.model_validate_json(content)
        except ValidationError as error:
            raise DossierError(f"{SIGNATURE_FILE} was altered") from error
        raw = _raw_key(signature.public_key)
        if model_json(signature) != content or raw is None or not is_key_id_of(signature.key, raw):
            raise DossierError(f"{SIGNATURE_FILE} was altered")
        self._verdict.key = signature.key
        if self._trusted and signature.public_key not in self._trusted:
            self._verdict.problems.append(
                f"it is signed by key {signature.key_id}, which is not the given one"
            )
        try:
            signature.key.verify(signature.signature, SIGNED_PREFIX + manifest, MANIFEST_FILE)
            decoded = base64.b64decode(signature.signature, validate=True)
        except PolicyError as error:
            raise DossierError(
                f"{MANIFEST_FILE} or {SIGNATURE_FILE} was altered: the signature is not valid"
            ) from error
        if base64.b64encode(decoded).decode() != signature.signature:
            raise DossierError(f"{SIGNATURE_FILE} was altered")

    def _member(self, name: str, size_bytes: int, sha256: str) -> bool:
        """Read one member; whether the next can be read."""
        header = self._file.read(header_size(name))
        digest, crc, left = hashlib.sha256(), 0, size_bytes
        is_kept = _is_compared(name) and size_bytes <= MAX_READ_BYTES
        parts: list[bytes] = []
        while left > 0 and (chunk := self._file.read(min(left, CHUNK_BYTES))):
            left -= len(chunk)
            digest.update(chunk)
            crc = zlib.crc32(chunk, crc)
            if is_kept:
                parts.append(chunk)
        if left > 0:
            self._verdict.problems.append(f"the file ends within {name}")
            return False
        is_same = digest.hexdigest() == sha256
        if not is_same:
            self._verdict.problems.append(f"{name} was altered")
            if header.startswith(b"PK\x03\x04"):
                # Compare the rest of the header, and the directory, as if the content were right.
                _, crc = read_header(header[: header_size("")])
        found = Placed(name, size_bytes, crc)
        self._members.append(found)
        if found.header() != header:
            self._verdict.problems.append(f"the header of {name} was altered")
        if is_kept and is_same:
            self._kept[name] = b"".join(parts)
        return True


def _is_compared(name: str) -> bool:
    last = name.rpartition("/")[2]
    return name.startswith("policies/") or last in (AUDIT_FILE, KEYS_FILE, PLAN_FILE, THROW_FILE)


def check_contents(verdict: DossierVerdict, kept: dict[str, bytes]) -> None:
    """What members say of each other: plans and their hashes, audit rows and seals, approvals.

    Args:
        verdict: takes problems and notes.
        kept: contents by name.
    """
    for name, content in kept.items():
        if name.endswith(f"/{PLAN_FILE}"):
            _check_plan(
                verdict, name, content, kept.get(name.replace(PLAN_FILE, THROW_FILE), b"{}")
            )
    if AUDIT_FILE in kept:
        _check_against_audit(verdict, kept, _check_audit(verdict, kept[AUDIT_FILE]))
    trust = SiteTrust.model_validate_json(kept[KEYS_FILE]) if KEYS_FILE in kept else None
    if trust is not None:
        _check_keys(verdict, trust)
    for folder in sorted({n.rpartition("/")[0] for n in kept if n.startswith("policies/")}):
        if trust is not None and f"{folder}/{POLICY_FILE}" in kept:
            _check_policy(verdict, folder, kept, trust)


def _check_plan(verdict: DossierVerdict, name: str, content: bytes, throw: bytes) -> None:
    facts: dict[str, Any] = json.loads(throw)
    plan = ThrowPlan.model_validate_json(content)
    if plan.plan_hash != facts.get("plan_hash"):
        verdict.problems.append(f"{name} does not have the hash that was armed")
    verdict.checked_plan_count += 1


def _check_against_audit(
    verdict: DossierVerdict, kept: dict[str, bytes], recorded: dict[tuple[str, str], str]
) -> None:
    """Plans and logs against the hashes that the audit's sealed rows hold of them."""
    for name, content in kept.items():
        if name.endswith(f"/{THROW_FILE}"):
            plan_hash = recorded.get((name.split("/")[1], FIRED))
            if plan_hash not in (None, json.loads(content).get("plan_hash")):
                verdict.problems.append(f"{name} names another plan than the audit says was fired")
    members = () if verdict.manifest is None else verdict.manifest.members
    for member in members:
        if member.name.endswith(f"/{LOG_FILE}"):
            log_sha256 = recorded.get((member.name.split("/")[1], LOGGED))
            if log_sha256 not in (None, member.sha256):
                verdict.problems.append(f"{member.name} is not the log that the machine sent")


def _check_audit(verdict: DossierVerdict, content: bytes) -> dict[tuple[str, str], str]:
    """Check seals; returns the hashes that rows hold, by throw and action, the newest of each."""
    recorded: dict[tuple[str, str], str] = {}
    before: dict[str, Any] | None = None
    for line in content.splitlines():
        row: dict[str, Any] = json.loads(line)
        number = row["sequence_count"]
        sealed = seal_of(row["previous_sha256"], [row[name] for name in SEALED_FIELDS])
        if sealed != row["row_sha256"]:
            verdict.problems.append(f"audit row {number} was changed before the dossier was made")
        is_next = before is not None and number == before["sequence_count"] + 1
        if before is not None and is_next and row["previous_sha256"] != before["row_sha256"]:
            verdict.problems.append(f"audit row {number} does not follow the one before")
        before = row
        verdict.checked_audit_count += 1
        name = HASH_NAMES.get(row["action"]) if row["phase"] in ("intent", "fact") else None
        found = None if name is None else json.loads(row["detail_json"]).get(name)
        if found is not None:
            recorded[row["throw_id"], row["action"]] = found
    return recorded


def _check_keys(verdict: DossierVerdict, trust: SiteTrust) -> None:
    try:
        trust.require_successor_of(None)
    except PolicyError as error:
        verdict.problems.append(str(error))
    if verdict.key is not None and verdict.key not in trust.keys:
        verdict.problems.append(f"the key that signed the dossier is not one of {KEYS_FILE}")


def _check_policy(
    verdict: DossierVerdict, folder: str, kept: dict[str, bytes], trust: SiteTrust
) -> None:
    policy, text = kept[f"{folder}/{POLICY_FILE}"], kept[f"{folder}/{CARD_FILE}"]
    card = PolicyCard.model_validate_json(text)
    name = f"policy {card.policy_id}"
    if hashlib.sha256(policy).hexdigest() != folder.rpartition("/")[2]:
        verdict.problems.append(f"{name} is not the version that threw")
    verdict.checked_policy_count += 1
    if not any(one.policy_sha256 == card.policy_sha256 for one in trust.approvals):
        verdict.notes.append(f"{name} had no approval when the dossier was made; see its history")
        return
    golden = kept.get(f"{folder}/{GOLDEN_FILE}")
    try:
        trust.check(PolicyFiles(Path(folder), card, policy, text, golden), card.mode)
    except PolicyError as error:
        verdict.problems.append(str(error))
