"""The machine's throw logs from the first row to the report that they are stored; recovery after a crash.

Sits between the link process and the recorder's thread.
"""

import logging
from collections.abc import Callable, Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from machine.errors import LogError
from machine.messages import ImpactSurvey, MachineEvent
from runtime.records.journal import Journal
from runtime.records.log_reader import read_throw_log, recover_log
from runtime.records.log_writer import StoredLog
from runtime.records.outbox import OutboxError
from runtime.records.recorder import PART_SUFFIX, ThrowRecorder, log_path, part_path

logger = logging.getLogger(__name__)

KEPT_LOGS_COUNT: Final = 500
"""Uploaded logs kept on the machine, about 200 MB; those that were never uploaded are all kept."""


class Records:
    """Logs of one machine."""

    def __init__(self, folder: Path, journal: Journal, on_reported: Callable[[], None]) -> None:
        self._folder = folder
        self._journal = journal
        self._on_reported = on_reported
        self._open_id: str | None = None
        self._last_ns = 0
        self._recorder = ThrowRecorder(folder, self._report)

    def close(self) -> None:
        """Write what waits; an open log stays to be recovered at the next start."""
        self._recorder.close()

    @property
    def dropped_count(self) -> int:
        """Items that did not reach the disk."""
        return self._recorder.dropped_count

    @property
    def failure(self) -> str:
        """Why logs cannot be written; empty when they can."""
        return self._recorder.failure

    def resume(self, context: Mapping[str, Any] | None, *, is_open: bool) -> None:
        """Control has said hello: go on with its log where one is unfinished here, recover all others.

        Args:
            context: of control's last log; None when it has begun none.
            is_open: whether that throw still runs; else its end follows, after the events.
        """
        known_id = None if context is None else str(context["throw_id"])
        broken_off = self._open_id if self._open_id != known_id else None
        if broken_off is not None:
            self.end({"outcome": "interrupted", "is_complete": False})
        for part in sorted(self._folder.glob(f"*.mcap{PART_SUFFIX}")):
            throw_id = part.name.removesuffix(f".mcap{PART_SUFFIX}")
            if throw_id not in (known_id, broken_off):
                self._recover(throw_id)
        for throw_id in self._journal.without_log():
            path = log_path(self._folder, throw_id)
            if path.exists():
                content = path.read_bytes()
                self._report(StoredLog(throw_id, path, sha256(content).hexdigest(), len(content)))
        if context is None or known_id is None or known_id == self._open_id:
            return
        if is_open or part_path(self._folder, known_id).exists():
            self.begin(known_id, context, has_gap=True)

    def _recover(self, throw_id: str) -> None:
        try:
            stored = recover_log(self._folder, throw_id)
        except LogError as error:
            logger.error("the log of %s cannot be recovered: %s", throw_id, error)
            return
        if stored is not None:
            logger.info("recovered the log of %s, %d bytes", throw_id, stored.size_bytes)
            self._report(stored)

    def begin(self, throw_id: str, context: Mapping[str, Any], *, has_gap: bool = False) -> None:
        """A throw's log starts; one that an earlier link process began goes on with a gap."""
        earlier = None
        if part_path(self._folder, throw_id).exists():
            try:
                earlier = read_throw_log(part_path(self._folder, throw_id))
            except LogError as error:
                logger.warning("the first part of the log of %s is lost: %s", throw_id, error)
        self._open_id = throw_id
        self._recorder.begin(throw_id, context, earlier, has_gap=has_gap)

    def add_rows(self, rows: Mapping[str, NDArray[np.void]], log_t_mono_ns: int) -> None:
        """Rows of one tick, by channel."""
        self._last_ns = log_t_mono_ns
        for name, part in rows.items():
            self._recorder.add_rows(name, part, log_t_mono_ns)

    def count_lost(self, tick_count: int) -> None:
        """Ticks of the open log that never reached this process."""
        self._recorder.count_lost(tick_count)

    def add_event(self, event: MachineEvent) -> None:
        """An event; kept if it belongs to the open log."""
        if event.throw_id is not None and event.throw_id == self._open_id:
            self._recorder.add_event(event)

    def add_impact(self, impact: ImpactSurvey, t_mono_ns: int) -> None:
        """A surveyed impact of the open log's throw."""
        self._recorder.add_impact(impact, t_mono_ns)

    def end(self, result: Mapping[str, Any]) -> None:
        """The open log is complete."""
        self._recorder.end(result)
        self._open_id = None

    def _report(self, stored: StoredLog) -> None:
        # On the recorder's thread, or on the link's main thread after a crash.
        try:
            self._journal.add_log(self._journal.boot_id(), stored, self._last_ns)
            for throw_id in self._journal.surplus_logs(KEPT_LOGS_COUNT):
                log_path(self._folder, throw_id).unlink(missing_ok=True)
        except (OutboxError, OSError) as error:
            logger.error("the log of %s is stored but not reported: %s", stored.throw_id, error)
            return
        self._on_reported()
