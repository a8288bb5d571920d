"""Writes throw logs: one MCAP file a throw, in a thread behind a bounded queue.

A full queue is counted and visible, and never slows anything; a file that was cut off by a crash stays
readable up to its last flushed chunk (log_reader.py). The recorder decides nothing about throws.
"""

import json
import logging
import os
import queue
import threading
import time
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

logger = logging.getLogger(__name__)

CHUNK_BYTES: Final = 8 * 1024
"""About 0.1 s of rows: what a killed process may lose at most."""
OFFLINE_CHUNK_BYTES: Final = 256 * 1024
"""Nobody dies in the middle of a log that is written at once; larger chunks compress better."""
SYNC_PERIOD_S: Final = 0.5
"""How often a growing file is forced to the disk: what a power cut may lose at most."""
QUEUE_LENGTH: Final = 4000
"""About 10 s of a throw's rows; memory stays bounded when the disk hangs."""
RESERVED_COUNT: Final = 200
"""Places that rows may not take: begin, events and end of a throw must not be the ones that are dropped."""
PART_SUFFIX: Final = ".part"
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
        # MCAP times are unsigned; a time before the clock's start cannot be told from the start.
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
            _write_rows(writer, log)
            writer.close(result)
        return publish_log(scratch, path, str(log.metadata.get("throw_id", "")))
    except OSError as error:
        raise LogError(
            f"cannot write {path} ({error}); check the disk and its permissions"
        ) from error


def _write_rows(writer: LogWriter, log: ThrowLog) -> None:
    # Merged by time, so that a reader that streams the file sees the throw as it happened.
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


@dataclass(slots=True)
class _Begin:
    throw_id: str
    metadata: dict[str, Any]
    earlier: ThrowLog | None
    has_gap: bool
    dropped_count: int
    """Of the recorder, when this throw began: what is dropped from here on is missing in its log."""


@dataclass(slots=True)
class _Rows:
    name: str
    rows: np.ndarray[Any, np.dtype[np.void]]
    log_t_mono_ns: int


@dataclass(slots=True)
class _Impact:
    impact: ImpactSurvey
    t_mono_ns: int


@dataclass(slots=True)
class _End:
    result: dict[str, Any]
    dropped_count: int
    """Of the recorder, when this throw ended."""


_Item = _Begin | _Rows | MachineEvent | _Impact | _End | None


class ThrowRecorder:
    """Takes rows from any thread, writes them in its own; one throw at a time."""

    def __init__(
        self,
        folder: Path,
        on_stored: Callable[[StoredLog], None],
        queue_length: int = QUEUE_LENGTH,
    ) -> None:
        self._folder = folder
        self._row_limit_count = max(queue_length - RESERVED_COUNT, 1)
        self._on_stored = on_stored
        self._queue: queue.Queue[_Item] = queue.Queue(queue_length)
        self._writer: LogWriter | None = None
        self._stream: IO[bytes] | None = None
        self._throw_id = ""
        self._synced_s = 0.0
        self._dropped_at_begin_count = 0
        self._has_gap = False
        self.dropped_count = 0
        """Items that found the queue full, or that the disk refused, since the start."""
        self.failure = ""
        """Why the last log could not be written; empty when it could."""
        folder.mkdir(parents=True, exist_ok=True)
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def begin(
        self,
        throw_id: str,
        metadata: Mapping[str, Any],
        earlier: ThrowLog | None = None,
        *,
        has_gap: bool = False,
    ) -> None:
        """Start the log of a throw; an open one is closed as it is.

        Args:
            throw_id: names the file.
            metadata: context of the throw.
            earlier: what a recorder that died had written of this throw; it comes first.
            has_gap: rows are missing already; the log will not count as complete.
        """
        self._put(_Begin(throw_id, dict(metadata), earlier, has_gap, self.dropped_count))

    def add_rows(
        self, name: str, rows: np.ndarray[Any, np.dtype[np.void]], log_t_mono_ns: int
    ) -> None:
        """Add rows of a numeric channel."""
        if self._queue.qsize() >= self._row_limit_count:
            self.dropped_count += 1
            return
        self._put(_Rows(name, rows, log_t_mono_ns))

    def count_lost(self, count: int) -> None:
        """Rows that were lost before they got here: the log is not complete."""
        self.dropped_count += count

    def add_event(self, event: MachineEvent) -> None:
        """Add an event of the throw."""
        self._put(event)

    def add_impact(self, impact: ImpactSurvey, t_mono_ns: int) -> None:
        """Add the surveyed impact."""
        self._put(_Impact(impact, t_mono_ns))

    def end(self, result: Mapping[str, Any]) -> None:
        """Close the log of the throw; `on_stored` is called from the recorder's thread."""
        self._put(_End(dict(result), self.dropped_count))

    def close(self, timeout_s: float = 5.0) -> None:
        """Write what waits, then stop; an open log stays a part file, to be recovered at the next start."""
        try:
            self._queue.put(None, timeout=timeout_s)
        except queue.Full:
            logger.error("the recorder's disk hangs: %d items are lost", self._queue.qsize())
        self._thread.join(timeout_s)

    def _put(self, item: _Item) -> None:
        try:
            self._queue.put_nowait(item)
        except queue.Full:
            self.dropped_count += 1

    def _run(self) -> None:
        while (item := self._queue.get()) is not None:
            try:
                self._take(item)
            except (OSError, LogError) as error:
                self.dropped_count += 1
                self.failure = f"the throw log cannot be written ({error}); check the disk"
                logger.error("%s", self.failure)
                self._drop_open_log()
        self._drop_open_log()

    def _take(self, item: _Item) -> None:
        if isinstance(item, _Begin):
            self._begin(item)
        elif (writer := self._writer) is None:
            return
        elif isinstance(item, _Rows):
            for row in item.rows:
                writer.add_row(item.name, row, item.log_t_mono_ns)
            self._sync_now_and_then()
        elif isinstance(item, MachineEvent):
            writer.add_event(item)
        elif isinstance(item, _Impact):
            writer.add_impact(item.impact, item.t_mono_ns)
        elif isinstance(item, _End):
            self._end(item)

    def _begin(self, item: _Begin) -> None:
        if self._writer is not None:
            self._end(_End({"outcome": "interrupted"}, item.dropped_count))
        self._throw_id = item.throw_id
        self._dropped_at_begin_count = item.dropped_count
        self._stream = part_path(self._folder, item.throw_id).open("wb")
        self._writer = LogWriter(self._stream, item.metadata)
        self._has_gap = item.has_gap
        if item.earlier is not None:
            _write_rows(self._writer, item.earlier)
        self._sync()

    def _end(self, item: _End) -> None:
        if self._writer is None or self._stream is None:
            return
        result, dropped = item.result, item.dropped_count - self._dropped_at_begin_count
        is_complete = dropped == 0 and not self._has_gap and result.get("is_complete", True)
        self._writer.close({**result, "is_complete": is_complete, "dropped_count": dropped})
        self._stream.close()
        self._writer = self._stream = None
        part = part_path(self._folder, self._throw_id)
        stored = publish_log(part, log_path(self._folder, self._throw_id), self._throw_id)
        self.failure = ""
        self._on_stored(stored)

    def _sync_now_and_then(self) -> None:
        if self._stream is not None:
            self._stream.flush()
        if time.monotonic() - self._synced_s >= SYNC_PERIOD_S:
            self._sync()

    def _sync(self) -> None:
        if self._stream is not None:
            self._stream.flush()
            os.fsync(self._stream.fileno())
            self._synced_s = time.monotonic()

    def _drop_open_log(self) -> None:
        stream, self._stream, self._writer = self._stream, None, None
        if stream is not None:
            try:
                stream.close()
            except OSError as error:
                logger.error("the part file cannot be closed: %s", error)


def log_path(folder: Path, throw_id: str) -> Path:
    """Where the finished log of a throw lies."""
    return folder / f"{throw_id}.mcap"


def part_path(folder: Path, throw_id: str) -> Path:
    """Where the log of a running throw grows."""
    return folder / f"{throw_id}.mcap{PART_SUFFIX}"
