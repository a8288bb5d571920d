"""Writes throw logs: one MCAP file a throw, in a thread behind a bounded queue.

A full queue is counted and visible, and never slows anything; a file that was cut off by a crash stays
readable up to its last flushed chunk (log_reader.py). The recorder decides nothing about throws.
"""

import logging
import os
import queue
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final

import numpy as np

from machine.errors import LogError
from machine.messages import ImpactSurvey, MachineEvent
from runtime.records.log_writer import LogWriter, StoredLog, publish_log, write_rows
from runtime.records.throw_log import ThrowLog

logger = logging.getLogger(__name__)

SYNC_PERIOD_S: Final = 0.5
"""How often a growing file is forced to the disk: what a power cut may lose at most."""
QUEUE_LENGTH: Final = 4000
"""About 10 s of a throw's rows; memory stays bounded when the disk hangs."""
RESERVED_COUNT: Final = 200
"""Places that rows may not take: begin, events and end of a throw must not be the ones that are dropped."""
PART_SUFFIX: Final = ".part"


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
            write_rows(self._writer, item.earlier)
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
