"""Throw logs as MCAP files: written row by row while a throw goes on, or whole and at once."""

import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
from mcap.writer import CompressionType, Writer

from machine.channels import LOG_CHANNELS
from machine.errors import LogError
from machine.messages import ImpactSurvey, MachineEvent
from runtime.records.throw_log import (
    CONTEXT_RECORD,
    LOG_SCHEMA_VERSION,
    PROFILE,
    RESULT_RECORD,
    ROW_TYPES,
    ThrowLog,
    channel_schema,
    event_to_json,
    impact_to_json,
    metadata_to_text,
    row_to_json,
)

CHUNK_BYTES: Final = 8 * 1024
"""About 0.1 s of rows: what a killed process may lose at most."""
OFFLINE_CHUNK_BYTES: Final = 256 * 1024
"""Nobody dies in the middle of a log that is written at once; larger chunks compress better."""
SCRATCH_SUFFIX: Final = ".new"


class LogWriter:
    """Writes one log to a stream, row by row; use `close` to make it complete."""

    def __init__(
        self, stream: IO[bytes], metadata: Mapping[str, Any], chunk_bytes: int = CHUNK_BYTES
    ) -> None:
        self._writer = Writer(stream, chunk_size=chunk_bytes, compression=CompressionType.ZSTD)
        self._writer.start(profile=PROFILE, library="downrange")
        self._writer.add_metadata(
            CONTEXT_RECORD,
            metadata_to_text({"log_schema_version": LOG_SCHEMA_VERSION, **metadata}),
        )
        self._channels: dict[str, int] = {}
        self.row_count: dict[str, int] = dict.fromkeys(LOG_CHANNELS, 0)
        for name, channel in LOG_CHANNELS.items():
            schema_id = self._writer.register_schema(
                f"downrange.{name}", "jsonschema", json.dumps(channel_schema(name)).encode()
            )
            self._channels[name] = self._writer.register_channel(
                channel.topic, channel.encoding, schema_id
            )

    def add_row(self, name: str, row: np.void, log_t_mono_ns: int) -> None:
        """Add one row of a numeric channel, logged at `log_t_mono_ns`."""
        self._add(name, log_t_mono_ns, int(row["t_mono_ns"]), row_to_json(row))

    def add_event(self, event: MachineEvent) -> None:
        """Add one event."""
        self._add("event", event.t_mono_ns, event.t_mono_ns, event_to_json(event))

    def add_impact(self, impact: ImpactSurvey, t_mono_ns: int) -> None:
        """Add the surveyed impact."""
        self._add("impact", t_mono_ns, t_mono_ns, impact_to_json(impact, t_mono_ns))

    def _add(self, name: str, log_ns: int, publish_ns: int, data: bytes) -> None:
        # MCAP times are unsigned; a time before the clock's start becomes the start.
        self._writer.add_message(
            self._channels[name], max(log_ns, 0), data, max(publish_ns, 0), self.row_count[name]
        )
        self.row_count[name] += 1

    def close(self, result: Mapping[str, Any]) -> None:
        """Write how the throw ended, and the file's index."""
        self._writer.add_metadata(
            RESULT_RECORD, metadata_to_text({**result, "row_count": self.row_count})
        )
        self._writer.finish()


@dataclass(frozen=True, slots=True)
class StoredLog:
    """A finished log file."""

    throw_id: str
    path: Path
    log_sha256: str
    size_bytes: int


def write_throw_log(path: Path, log: ThrowLog) -> StoredLog:
    """Write a whole log at once, atomically: `path` either holds all of it or is not touched.

    Raises:
        LogError: the file cannot be written.
    """
    scratch = path.with_name(path.name + SCRATCH_SUFFIX)
    context = {key: value for key, value in log.metadata.items() if key != RESULT_RECORD}
    context.pop("log_schema_version", None)
    result = {"is_complete": True, **log.metadata.get(RESULT_RECORD, {})}
    result.pop("row_count", None)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with scratch.open("wb") as stream:
            writer = LogWriter(stream, context, OFFLINE_CHUNK_BYTES)
            write_rows(writer, log)
            writer.close(result)
        return publish_log(scratch, path, str(log.metadata.get("throw_id", "")))
    except OSError as error:
        raise LogError(
            f"cannot write {path} ({error}); check the disk and its permissions"
        ) from error


def write_rows(writer: LogWriter, log: ThrowLog) -> None:
    """Add all of a log, merged by time: a reader that streams the file sees the throw as it happened."""
    waiting: list[tuple[int, Callable[[], None]]] = []
    for name in ROW_TYPES:
        for row in getattr(log, name):
            t_ns = int(row["t_mono_ns"])
            waiting.append((t_ns, lambda n=name, r=row, t=t_ns: writer.add_row(n, r, t)))
    for event in log.events:
        waiting.append((event.t_mono_ns, lambda e=event: writer.add_event(e)))
    if (impact := log.impact) is not None:
        t_ns = log.impact_t_mono_ns
        waiting.append((t_ns, lambda: writer.add_impact(impact, t_ns)))
    for _, add in sorted(waiting, key=lambda item: item[0]):
        add()


def publish_log(part: Path, path: Path, throw_id: str) -> StoredLog:
    """Force a written part file to the disk and give it its final name."""
    with part.open("rb") as stream:
        content = stream.read()
        os.fsync(stream.fileno())
    part.replace(path)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
    return StoredLog(throw_id, path, sha256(content).hexdigest(), len(content))
