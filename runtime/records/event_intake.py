"""Takes the control process's events to the disk: the latch first, then the journal, in order.

A disk that refuses loses nothing: what could not be written waits in memory, in order, and is tried again.
"""

import logging
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from machine.messages import EventKind, MachineEvent, ThrowState
from runtime.records.journal import Journal
from runtime.records.latch_file import LatchFile
from runtime.records.outbox import EventDraft, OutboxError
from runtime.throw.protocol import Latch

logger = logging.getLogger(__name__)

WAITING_LIMIT_COUNT: Final = 5000
"""Events kept while the disk refuses; beyond it the newest are dropped and counted."""
KEPT_IDS_COUNT: Final = 256
"""Latches that are remembered as written: an answer waits for its own for a few ticks."""
LATCHING: Final = {
    EventKind.STOP_LATCHED: ThrowState.STOPPED,
    EventKind.FAULT: ThrowState.FAULT,
}


@dataclass(frozen=True, slots=True)
class ControlEvent:
    """An event of the control process; `number` counts them within the boot, 0 for one of the link itself."""

    boot_id: str
    number: int
    draft: EventDraft


class EventIntake:
    """Latch file, journal, and what waits for the disk; safe from any thread."""

    def __init__(
        self, journal: Journal, latches: LatchFile, on_stored: Callable[[MachineEvent], None]
    ) -> None:
        """Begin.

        Args:
            journal: where events go.
            latches: where latches go, before the event that tells of them.
            on_stored: called with each event that is on the disk, on the thread that stored it.
        """
        self._journal = journal
        self._latches = latches
        self._on_stored = on_stored
        self._lock = threading.RLock()
        self._waiting: deque[ControlEvent] = deque()
        self._unwritten_latch: Latch | None = None
        self._unwritten_ids: list[str] = []
        known = latches.latch
        self._written_ids = deque([known.latch_id] if known else [], KEPT_IDS_COUNT)
        self.failure = ""
        """Why the disk refuses; empty when it does not."""
        self.dropped_count = 0

    @property
    def waiting_count(self) -> int:
        """Events that are not on the disk yet."""
        return len(self._waiting)

    def take(self, event: ControlEvent) -> bool:
        """Store an event, or keep it until the disk takes it; whether it is on the disk."""
        with self._lock:
            self._note_latch(event.draft)
            if len(self._waiting) >= WAITING_LIMIT_COUNT:
                self.dropped_count += 1
                return False
            self._waiting.append(event)
            return self.retry()

    def retry(self) -> bool:
        """Try what waits; whether everything is on the disk now."""
        with self._lock:
            try:
                if self._unwritten_latch is not None:
                    self._write(self._unwritten_latch)
                while self._waiting:
                    self._store(self._waiting[0])
                    self._waiting.popleft()
            except OutboxError as error:
                if not self.failure:
                    logger.error("%s", error)
                self.failure = str(error)
                return False
            self.failure = ""
            return True

    def latch(self, latch: Latch) -> bool:
        """Remember a latch that the link process itself decides on; whether it is on the disk."""
        with self._lock:
            self._unwritten_latch = latch
            self._unwritten_ids.append(latch.latch_id)
            try:
                self._write(latch)
            except OutboxError as error:
                logger.error("%s", error)
                return False
            return True

    def _write(self, latch: Latch) -> None:
        self._latches.write(latch)
        self._unwritten_latch = None
        # Those before it that the disk refused are over: the machine is latched by this one.
        self._written_ids += self._unwritten_ids
        self._unwritten_ids.clear()

    def latch_unless_latched(self, latch: Latch) -> bool:
        """Remember a latch where none stands, so that another thread's STOP stays; whether none stood."""
        with self._lock:
            if self._latches.latch is not None or self._unwritten_latch is not None:
                return False
            self.latch(latch)
            return True

    def is_durable(self, latch_id: str) -> bool:
        """Whether this latch is on the disk, or was until a clear or a later latch; empty: there is none.

        A latch may be over before anybody asks: of a STOP and its clear in one control tick, for one.
        """
        with self._lock:
            known = self._latches.latch
            if latch_id:
                return latch_id in self._written_ids
            return known is None

    def _note_latch(self, draft: EventDraft) -> None:
        latch_id = str(draft.data.get("latch_id", ""))
        if not latch_id:
            return
        state = LATCHING.get(draft.kind)
        if state is not None:
            self.latch(Latch(latch_id, state, str(draft.data.get("reason", ""))))
        elif draft.kind is EventKind.STOP_CLEARED:
            try:
                self._latches.clear(latch_id)
            except OutboxError as error:
                # It comes up STOPPED once more: the safe side.
                logger.error("%s", error)

    def _store(self, event: ControlEvent) -> None:
        stored = self._journal.record(event.boot_id, event.number, event.draft)
        if stored is not None:
            self._on_stored(stored)
