"""A signed ZIP file with exactly one valid form of bytes, so that any altered byte is found.

Members are stored without compression, behind headers that follow from name, size and content alone::

    manifest.json    size and sha256 of every further member, in their order
    signature.json   Ed25519 (RFC 8032) over the manifest's bytes, and the public key
    further members
    directory        as ZIP has it (PKWARE APPNOTE 6.3.4, sections 4.3.7, 4.3.12, 4.3.16)

A reader knows from the signed manifest what every byte of the file has to be. Needs no server.
"""

import hashlib
import json
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, Final, Literal

from pydantic import BaseModel, ConfigDict, Field

from machine.errors import DownrangeError
from machine.policy_approval import KEY_ID_COUNT, SiteKey

MANIFEST_FILE: Final = "manifest.json"
SIGNATURE_FILE: Final = "signature.json"
SIGNED_PREFIX: Final = b"downrange dossier 1\n"
"""Before the manifest in what is signed: no other document of a site begins so."""
MAX_MANIFEST_BYTES: Final = 16 * 1024 * 1024
MAX_MEMBER_COUNT: Final = 20_000
MAX_TOTAL_BYTES: Final = 2 * 1024**3
"""Below the 4 GiB and 65 535 members of a ZIP file without extensions."""
CHUNK_BYTES: Final = 1024 * 1024

_LOCAL: Final = struct.Struct("<4s5H3I2H")
_CENTRAL: Final = struct.Struct("<4s6H3I5H2I")
_END: Final = struct.Struct("<4s4H2IH")
_VERSION: Final = 20
_MADE_BY_UNIX: Final = 3 << 8 | _VERSION
_UTF8_NAMES: Final = 0x0800
_DATE: Final = 0x0021
"""1980-01-01, the earliest that ZIP knows: times stand in the manifest."""
_FILE_MODE: Final = 0o100644 << 16


class DossierError(DownrangeError):
    """A dossier that cannot be made or read."""

    code = "dossier"


class ArchiveMember(BaseModel):
    """One member as the manifest lists it."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    name: str = Field(
        pattern=r"^[A-Za-z0-9_-][A-Za-z0-9._-]*(/[A-Za-z0-9_-][A-Za-z0-9._-]*)*$", max_length=200
    )
    size_bytes: int = Field(ge=0, le=MAX_TOTAL_BYTES)
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")


class DossierManifest(BaseModel):
    """What a dossier is about, and what every member has to be."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    format: Literal["downrange-dossier-1"] = "downrange-dossier-1"
    site: str
    machine_id: str
    throw_id: str | None
    """None: of a period."""
    since_utc: str | None
    until_utc: str | None
    throw_count: int
    created_utc: str
    created_by: str
    software: str
    audit_sequence_count: int
    """Newest row of the audit when the dossier was made, and its seal."""
    audit_sha256: str
    members: tuple[ArchiveMember, ...] = Field(max_length=MAX_MEMBER_COUNT)


class DossierSignature(BaseModel):
    """Who vouches for the manifest."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    key_id: str
    public_key: str
    """Base64 of the 32 bytes."""
    signature: str
    """Base64, over `SIGNED_PREFIX` and the manifest."""

    @property
    def key(self) -> SiteKey:
        """The key that has signed."""
        return SiteKey(key_id=self.key_id, public_key=self.public_key)


def canonical_json(value: Any) -> bytes:
    """JSON with one form: sorted keys, no spaces, ASCII, a line end."""
    return json.dumps(value, sort_keys=True, separators=(",", ":")).encode() + b"\n"


def model_json(model: BaseModel) -> bytes:
    """A model in the one form."""
    return canonical_json(model.model_dump(mode="json"))


@dataclass(slots=True)
class Placed:
    """A member with what its headers need."""

    name: str
    size_bytes: int
    crc: int

    def header(self) -> bytes:
        """What stands before the content."""
        name = self.name.encode()
        sizes = (self.crc, self.size_bytes, self.size_bytes, len(name), 0)
        return _LOCAL.pack(b"PK\x03\x04", _VERSION, _UTF8_NAMES, 0, 0, _DATE, *sizes) + name

    def entry(self, offset: int) -> bytes:
        """Its entry in the directory."""
        name = self.name.encode()
        fixed = (b"PK\x01\x02", _MADE_BY_UNIX, _VERSION, _UTF8_NAMES, 0, 0, _DATE)
        sizes = (self.crc, self.size_bytes, self.size_bytes, len(name), 0, 0, 0, 0)
        return _CENTRAL.pack(*fixed, *sizes, _FILE_MODE, offset) + name

    @property
    def length_bytes(self) -> int:
        """Header and content."""
        return _LOCAL.size + len(self.name.encode()) + self.size_bytes


def directory_of(members: list[Placed]) -> bytes:
    """What stands after the last member."""
    offset = 0
    parts: list[bytes] = []
    for member in members:
        parts.append(member.entry(offset))
        offset += member.length_bytes
    entries = b"".join(parts)
    count = len(members)
    return entries + _END.pack(b"PK\x05\x06", 0, 0, count, count, len(entries), offset, 0)


def placed(name: str, content: bytes) -> Placed:
    """A member whose content is at hand."""
    return Placed(name, len(content), zlib.crc32(content))


def read_header(header: bytes) -> tuple[int, int]:
    """Size and checksum that the fixed part of a header names.

    Raises:
        DossierError: it is none.
    """
    if len(header) != _LOCAL.size or not header.startswith(b"PK\x03\x04"):
        raise DossierError("this is no dossier, or its beginning was altered")
    fields = _LOCAL.unpack(header)
    return int(fields[7]), int(fields[6])


def header_size(name: str) -> int:
    """Bytes before a member's content."""
    return _LOCAL.size + len(name.encode())


@dataclass(slots=True)
class ArchiveBody:
    """The members behind manifest and signature, written to a scratch file as they come."""

    scratch: BinaryIO
    max_bytes: int = MAX_TOTAL_BYTES
    members: list[ArchiveMember] = field(default_factory=list[ArchiveMember])
    _placed: list[Placed] = field(default_factory=list[Placed])
    size_bytes: int = 0

    def add(self, name: str, chunks: Iterator[bytes]) -> ArchiveMember:
        """Write a member; its content comes in chunks.

        Raises:
            DossierError: too many members or bytes.
        """
        start = self.scratch.tell()
        self.scratch.write(bytes(header_size(name)))
        digest, crc, size = hashlib.sha256(), 0, 0
        for chunk in chunks:
            size += len(chunk)
            if self.size_bytes + size > self.max_bytes or len(self.members) >= MAX_MEMBER_COUNT:
                raise DossierError(
                    f"a dossier has at most {self.max_bytes // 10**6} MB and {MAX_MEMBER_COUNT} "
                    "members; choose a shorter period"
                )
            digest.update(chunk)
            crc = zlib.crc32(chunk, crc)
            self.scratch.write(chunk)
        found = Placed(name, size, crc)
        end = self.scratch.tell()
        self.scratch.seek(start)
        self.scratch.write(found.header())
        self.scratch.seek(end)
        member = ArchiveMember(name=name, size_bytes=size, sha256=digest.hexdigest())
        self.members.append(member)
        self._placed.append(found)
        self.size_bytes += found.length_bytes
        return member

    def add_bytes(self, name: str, content: bytes) -> ArchiveMember:
        """Write a member whose content is at hand."""
        return self.add(name, iter((content,)))

    def add_file(self, name: str, path: Path) -> ArchiveMember:
        """Write a file as a member."""
        with path.open("rb") as file:
            return self.add(name, chunks_of(file))

    def around(self, manifest: bytes, signature: bytes) -> tuple[bytes, bytes]:
        """What stands before and after the scratch file's content."""
        first = [(MANIFEST_FILE, manifest), (SIGNATURE_FILE, signature)]
        head = [placed(name, content) for name, content in first]
        before = b"".join(
            member.header() + content for member, (_, content) in zip(head, first, strict=True)
        )
        return before, directory_of([*head, *self._placed])


def chunks_of(file: BinaryIO) -> Iterator[bytes]:
    """The rest of a file."""
    while chunk := file.read(CHUNK_BYTES):
        yield chunk


def is_key_id_of(key: SiteKey, raw_key: bytes) -> bool:
    """Whether a key's id is that of its bytes."""
    return key.key_id == hashlib.sha256(raw_key).hexdigest()[:KEY_ID_COUNT]
