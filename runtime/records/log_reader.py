"""Reads throw logs, recovers files that were cut off, and brings old schema versions up to date.

Whatever the file holds, the result is a `ThrowLog` or a `LogError` that says what is wrong with it.
Rules for a migration: it takes the decoded context and messages of version n and returns those of n + 1;
it never reads the clock or the disk; it is never changed after a release; readers migrate, writers do not.
"""

import json
import logging
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
import zstandard
from mcap.exceptions import McapError
from mcap.records import Channel, Chunk, Footer, Message, Metadata
from mcap.stream_reader import CRCValidationError, StreamReader, breakup_chunk
from mcap.writer import MCAP0_MAGIC

from machine.channels import LOG_CHANNELS
from machine.errors import LogError
from machine.messages import ImpactSurvey
from runtime.records.log_writer import StoredLog, write_throw_log
from runtime.records.recorder import log_path, part_path
from runtime.records.throw_log import (
    CONTEXT_RECORD,
    LOG_SCHEMA_VERSION,
    RESULT_RECORD,
    ROW_TYPES,
    ThrowLog,
    events_from_json,
    impact_from_json,
    metadata_from_text,
    rows_from_json,
)

logger = logging.getLogger(__name__)

RECORD_LIMIT_BYTES: Final = 64 * 1024 * 1024
"""No record or chunk of ours comes near; a damaged length must not ask for gigabytes of memory."""

TOTAL_LIMIT_BYTES: Final = 128 * 1024 * 1024
"""Decompressed bytes of all chunks of a log; two minutes of a throw have about 20 MB."""

_DAMAGE = (
    McapError,
    CRCValidationError,
    zstandard.ZstdError,
    struct.error,
    ValueError,
    KeyError,
    OverflowError,
    MemoryError,
    RecursionError,
)
"""What the MCAP library raises on damaged bytes."""


@dataclass(slots=True)
class RawLog:
    """A log as read from the file, before rows and events are built; what migrations work on."""

    metadata: dict[str, Any] = field(default_factory=dict[str, Any])
    messages: dict[str, list[bytes]] = field(
        default_factory=lambda: {name: [] for name in LOG_CHANNELS}
    )
    damage: str = ""
    """What stopped the reading; empty for a file read to its end."""
    size_bytes: int = 0
    """Decompressed bytes so far."""


_NAMES: Final = {channel.topic: name for name, channel in LOG_CHANNELS.items()}

_LFS_MARK: Final = b"version https://git-lfs"
"""First bytes of the stand-in for a file that Git LFS did not fetch."""

MIGRATIONS: dict[int, Callable[[RawLog], RawLog]] = {}
"""Version n -> function that makes version n + 1. Version 1 is the first one."""


def _explain_damage(path: Path) -> str:
    """Why a file without metadata is no throw log, and what to do."""
    with path.open("rb") as file:
        start = file.read(len(_LFS_MARK))
        file.seek(max(path.stat().st_size - len(MCAP0_MAGIC), 0))
        end = file.read()
    if start == _LFS_MARK:
        return "It is a Git LFS pointer, not the file itself: run git lfs pull"
    if not start.startswith(MCAP0_MAGIC):
        return "It is another file"
    if end != MCAP0_MAGIC:
        return "It is cut off at its end: fetch it from the machine again"
    return "It is an MCAP file of another program"


def read_throw_log(path: Path) -> ThrowLog:
    """Read a throw log; one that was cut off gives what was written, with ``is_complete`` false.

    Raises:
        LogError: the file is missing, is no throw log, was written by newer software, or is damaged
            before its first metadata record.
    """
    raw = _read_raw(path)
    if CONTEXT_RECORD not in raw.metadata:
        cause = raw.damage or "it has no metadata record 'throw'"
        raise LogError(f"{path} is not a readable throw log: {cause}. {_explain_damage(path)}")
    context: dict[str, Any] = raw.metadata[CONTEXT_RECORD]
    version = context.get("log_schema_version")
    if not isinstance(version, int) or version > LOG_SCHEMA_VERSION:
        raise LogError(
            f"{path} has log schema version {version!r}, this software reads up to "
            f"{LOG_SCHEMA_VERSION}; update it"
        )
    while version < LOG_SCHEMA_VERSION:
        if version not in MIGRATIONS:
            raise LogError(f"{path} has log schema version {version}, which never existed")
        raw = MIGRATIONS[version](raw)
        version += 1
    if raw.damage:
        logger.warning("%s was cut off or damaged (%s); read up to there", path, raw.damage)
    return _build(path, raw)


def recover_log(folder: Path, throw_id: str) -> StoredLog | None:
    """Make a complete file of what a crash left of a throw's log, marked as interrupted.

    Returns:
        The stored log; None when the throw left nothing readable.
    """
    part, path = part_path(folder, throw_id), log_path(folder, throw_id)
    try:
        log = read_throw_log(part)
    except LogError as error:
        logger.warning("nothing to recover of throw %s: %s", throw_id, error)
        part.unlink(missing_ok=True)
        return None
    result: dict[str, Any] = {"outcome": "interrupted", **log.metadata.get(RESULT_RECORD, {})}
    result["is_complete"] = False
    metadata = {**log.metadata, RESULT_RECORD: result}
    recovered = ThrowLog(
        metadata,
        log.control,
        log.policy,
        log.imu,
        log.ball,
        log.events,
        log.impact,
        log.impact_t_mono_ns,
    )
    stored = write_throw_log(path, recovered)
    part.unlink(missing_ok=True)
    return stored


def _read_raw(path: Path) -> RawLog:
    raw = RawLog()
    try:
        with path.open("rb") as stream:
            _read_records(stream, raw)
    except OSError as error:
        raise LogError(f"cannot open {path}: {error.strerror}") from error
    return raw


def _read_records(stream: IO[bytes], raw: RawLog) -> None:
    topics: dict[int, str] = {}
    is_finished = False
    try:
        reader = StreamReader(
            stream, emit_chunks=True, validate_crcs=True, record_size_limit=RECORD_LIMIT_BYTES
        )
        for record in reader.records:
            if isinstance(record, Metadata):
                raw.metadata[record.name] = metadata_from_text(record.metadata)
            elif isinstance(record, Chunk):
                _take_chunk(record, topics, raw)
            is_finished = isinstance(record, Footer)
    except _DAMAGE as error:
        raw.damage = str(error) or type(error).__name__
    if not is_finished and not raw.damage:
        raw.damage = "the file ends early"


def _take_chunk(chunk: Chunk, topics: dict[int, str], raw: RawLog) -> None:
    raw.size_bytes += max(chunk.uncompressed_size, len(chunk.data))
    if raw.size_bytes > TOTAL_LIMIT_BYTES:
        raise ValueError(f"the log holds more than {TOTAL_LIMIT_BYTES} bytes")
    for record in _open_chunk(chunk):
        if isinstance(record, Channel):
            topics[record.id] = record.topic
        elif isinstance(record, Message):
            # Unknown topics are a newer writer's additions.
            name = _NAMES.get(topics.get(record.channel_id, ""))
            if name is not None:
                raw.messages[name].append(record.data)


def _open_chunk(chunk: Chunk) -> list[Any]:
    if chunk.uncompressed_size > RECORD_LIMIT_BYTES:
        raise ValueError(f"a chunk claims {chunk.uncompressed_size} bytes")
    if chunk.compression not in ("", "zstd"):
        raise ValueError(f"a chunk is compressed with {chunk.compression[:16]!r}, not with zstd")
    claimed = zstandard.frame_content_size(chunk.data) if chunk.compression else len(chunk.data)
    # A frame that does not say its size, or another one, could become any number of bytes.
    if claimed != chunk.uncompressed_size:
        raise ValueError(f"a chunk of {claimed} bytes claims {chunk.uncompressed_size}")
    return breakup_chunk(chunk, validate_crc=True)


def _build(path: Path, raw: RawLog) -> ThrowLog:
    metadata = {**raw.metadata[CONTEXT_RECORD]}
    if RESULT_RECORD in raw.metadata:
        metadata[RESULT_RECORD] = raw.metadata[RESULT_RECORD]
    elif raw.damage:
        metadata[RESULT_RECORD] = {"is_complete": False}
    try:
        rows = {name: rows_from_json(name, raw.messages[name]) for name in ROW_TYPES}
        events = events_from_json(raw.messages["event"])
        impact, impact_t_ns = _impact(raw.messages["impact"])
    except (
        ValueError,
        TypeError,
        AttributeError,
        OverflowError,
        RecursionError,
        MemoryError,
    ) as error:
        raise LogError(f"{path} holds a message that does not fit the schema: {error}") from error
    return ThrowLog(
        metadata,
        rows["control"],
        rows["policy"],
        rows["imu"],
        rows["ball"],
        events,
        impact,
        impact_t_ns,
    )


def _impact(messages: list[bytes]) -> tuple[ImpactSurvey | None, int]:
    if not messages:
        return None, 0
    decoded = json.loads(messages[-1])
    t_ns = np.int64(decoded.get("t_mono_ns", 0))
    return impact_from_json(decoded), int(t_ns)
