"""The machine's durable memory: events until the server has them, and what must outlive a restart.

One SQLite file in WAL mode with synchronous=FULL: what a method has returned from survives a power cut.
Motion commands are never stored here. Methods may be called from any thread.
"""

import re
import sqlite3
import threading
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from machine.errors import DownrangeError
from machine.messages import EventBatch, EventKind, MachineEvent

EVENT_LIMIT_COUNT: Final = 20_000
"""Events kept while no server takes them, about 2000 throws; beyond it the droppable kinds are dropped."""
BATCH_LIMIT_COUNT: Final = 64
DROPPABLE: Final = frozenset({EventKind.COMMAND_REFUSED, EventKind.DISARMED, EventKind.ARMED})
"""Kinds that a full outbox drops and counts. What throws did is kept without limit."""
THROW_MEMORY_COUNT: Final = 1000
"""Throw ids remembered so that a repeated fire is answered, not executed."""

_SCHEMA: Final = """
CREATE TABLE IF NOT EXISTS meta (key TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT;
CREATE TABLE IF NOT EXISTS boots (
    boot_id TEXT PRIMARY KEY, next_sequence INTEGER NOT NULL, control_number INTEGER NOT NULL
) STRICT;
CREATE TABLE IF NOT EXISTS events (
    id INTEGER PRIMARY KEY AUTOINCREMENT, boot_id TEXT NOT NULL, sequence INTEGER NOT NULL,
    body TEXT NOT NULL, UNIQUE (boot_id, sequence)
) STRICT;
CREATE TABLE IF NOT EXISTS throws (
    id INTEGER PRIMARY KEY AUTOINCREMENT, throw_id TEXT NOT NULL UNIQUE, plan_id TEXT,
    state TEXT NOT NULL, has_log INTEGER NOT NULL DEFAULT 0, is_uploaded INTEGER NOT NULL DEFAULT 0
) STRICT;
"""


class OutboxError(DownrangeError):
    """The machine's database cannot be opened or written."""

    code = "outbox"


@dataclass(frozen=True, slots=True)
class EventDraft:
    """An event before it has its place in the outbox."""

    kind: EventKind
    t_mono_ns: int
    throw_id: str | None
    plan_id: str | None
    data: dict[str, Any]
    t_utc: str


def utc_now() -> str:
    """Present time for people: ISO 8601 with zone."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def set_damaged_aside(path: Path) -> str:
    """Move a damaged database away, so that a new one can be begun; what was wrong, empty = nothing.

    A file that is empty, that SQLite finds damaged, or whose remembered epoch is no number. The file and its
    write-ahead log are kept beside it under a name with the time.

    Raises:
        OutboxError: the disk refuses.
    """
    if not path.exists():
        return ""
    damage = _damage(path)
    if not damage:
        return ""
    stamp = re.sub(r"[^0-9T]", "", utc_now().partition(".")[0])
    kept = path.with_name(f"{path.name}.damaged-{stamp}")
    try:
        for suffix in ("", "-wal", "-shm"):
            part = path.with_name(path.name + suffix)
            if part.exists():
                part.rename(kept.with_name(kept.name + suffix))
    except OSError as error:
        raise OutboxError(f"{path} is damaged and cannot be moved away ({error})") from error
    return f"the records were damaged ({damage}); they are kept as {kept.name}"


def _damage(path: Path) -> str:
    if path.stat().st_size == 0:
        return "the file is empty"
    try:
        database = sqlite3.connect(path, timeout=5.0)
        try:
            found = database.execute("PRAGMA quick_check(1)").fetchone()[0]
            if found != "ok":
                return str(found)
            row = database.execute("SELECT value FROM meta WHERE key='epoch_count'").fetchone()
            epoch = "0" if row is None else str(row[0])
            return "" if epoch.isdecimal() and int(epoch) < 2**53 else "the epoch is no number"
        finally:
            database.close()
    except sqlite3.OperationalError as error:
        # The disk, or another process: nothing is known against the file itself.
        is_missing = "no such table" in str(error)
        return str(error) if is_missing else ""
    except sqlite3.DatabaseError as error:
        return str(error)


class Outbox:
    """Events in order, unique by (boot, sequence), deleted when the server has acknowledged them."""

    def __init__(self, path: Path, machine_id: str, limit_count: int = EVENT_LIMIT_COUNT) -> None:
        self._machine_id = machine_id
        self._limit_count = limit_count
        self._lock = threading.RLock()
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            self._database = sqlite3.connect(
                path, isolation_level=None, check_same_thread=False, timeout=5.0
            )
            self._database.execute("PRAGMA journal_mode=WAL")
            self._database.execute("PRAGMA synchronous=FULL")
            self._database.executescript(_SCHEMA)
        except sqlite3.Error as error:
            raise OutboxError(
                f"cannot open {path} ({error}); it holds the lease epoch and unsent records, so it is "
                "not replaced: check the disk, or move the file away after reading its events"
            ) from error
        owner = self.meta("machine_id", machine_id)
        if owner != machine_id:
            raise OutboxError(
                f"{path} belongs to machine {owner}, not {machine_id}; use its folder"
            )
        with self.transaction():
            self.set_meta("machine_id", machine_id)

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            self._database.close()

    @contextmanager
    def transaction(self) -> Generator[sqlite3.Connection]:
        """One durable step; nested use joins the outer one.

        Raises:
            OutboxError: the disk refuses.
        """
        with self._lock:
            if self._database.in_transaction:
                yield self._database
                return
            try:
                self._database.execute("BEGIN IMMEDIATE")
                try:
                    yield self._database
                except BaseException:
                    self._database.execute("ROLLBACK")
                    raise
                self._database.execute("COMMIT")
            except sqlite3.Error as error:
                if self._database.in_transaction:
                    self._database.execute("ROLLBACK")
                raise OutboxError(
                    f"the machine's database refuses ({error}); check the disk"
                ) from error

    # Values ---------------------------------------------------------------------------------------

    def meta(self, key: str, default: str) -> str:
        """A remembered value."""
        with self._lock:
            row = self._database.execute("SELECT value FROM meta WHERE key=?", (key,)).fetchone()
        return default if row is None else str(row[0])

    def set_meta(self, key: str, value: str) -> None:
        """Remember a value; call within `transaction`."""
        self._database.execute("INSERT OR REPLACE INTO meta VALUES (?, ?)", (key, value))

    # Events ---------------------------------------------------------------------------------------

    def add(self, boot_id: str, draft: EventDraft) -> MachineEvent | None:
        """Append an event; None when the outbox is full and the event is of a droppable kind."""
        with self.transaction() as database:
            if draft.kind in DROPPABLE and self.count() >= self._limit_count:
                self.set_meta("dropped_count", str(self.dropped_count() + 1))
                return None
            database.execute("INSERT OR IGNORE INTO boots VALUES (?, 1, 0)", (boot_id,))
            sequence = database.execute(
                "UPDATE boots SET next_sequence = next_sequence + 1 WHERE boot_id=?"
                " RETURNING next_sequence - 1",
                (boot_id,),
            ).fetchone()[0]
            event = MachineEvent(
                machine_id=self._machine_id,
                boot_id=boot_id,
                sequence_count=sequence,
                t_mono_ns=draft.t_mono_ns,
                t_utc=draft.t_utc,
                kind=draft.kind,
                throw_id=draft.throw_id,
                plan_id=draft.plan_id,
                data=draft.data,
            )
            database.execute(
                "INSERT INTO events (boot_id, sequence, body) VALUES (?, ?, ?)",
                (boot_id, sequence, event.model_dump_json()),
            )
        return event

    def is_new_control_event(self, boot_id: str, number: int) -> bool:
        """Whether the control process's event of this number is not stored yet; marks it as stored.

        Call within the transaction that stores it: the control process repeats events until they are
        acknowledged, over restarts of the link process.
        """
        with self.transaction() as database:
            database.execute("INSERT OR IGNORE INTO boots VALUES (?, 1, 0)", (boot_id,))
            changed = database.execute(
                "UPDATE boots SET control_number=? WHERE boot_id=? AND control_number<?",
                (number, boot_id, number),
            )
            return changed.rowcount == 1

    def batch(self) -> EventBatch | None:
        """The oldest events of one boot, in order; None when all are acknowledged."""
        with self._lock:
            rows = self._database.execute(
                "SELECT boot_id, sequence, body FROM events ORDER BY id LIMIT ?",
                (BATCH_LIMIT_COUNT,),
            ).fetchall()
        if not rows:
            return None
        boot_id = rows[0][0]
        return EventBatch(
            machine_id=self._machine_id,
            boot_id=boot_id,
            events=tuple(
                self._event(boot_id, sequence, body)
                for boot, sequence, body in rows
                if boot == boot_id
            ),
        )

    def _event(self, boot_id: str, sequence: int, body: str) -> MachineEvent:
        """The stored event; one whose record is damaged is reported as such, in its place."""
        try:
            return MachineEvent.model_validate_json(body)
        except ValidationError:
            reason = "the machine's record of an event is damaged"
            return MachineEvent(
                machine_id=self._machine_id,
                boot_id=boot_id,
                sequence_count=sequence,
                t_mono_ns=0,
                t_utc=utc_now(),
                kind=EventKind.FAULT,
                data={"reason": reason, "record": str(body)[:1000]},
            )

    def acknowledge(self, batch: EventBatch, boot_id: str, sequence_count: int) -> int:
        """Delete what the server has committed of this batch; returns how many events went.

        An acknowledgement beyond the batch, or of another boot, deletes nothing it was not asked about.
        """
        if boot_id != batch.boot_id or not batch.events:
            return 0
        upto = min(sequence_count, batch.events[-1].sequence_count)
        with self.transaction() as database:
            deleted = database.execute(
                "DELETE FROM events WHERE boot_id=? AND sequence<=?", (boot_id, upto)
            )
            return deleted.rowcount

    def count(self) -> int:
        """Events that the server does not have yet."""
        with self._lock:
            return int(self._database.execute("SELECT count(*) FROM events").fetchone()[0])

    def dropped_count(self) -> int:
        """Events dropped because the outbox was full, ever."""
        return int(self.meta("dropped_count", "0"))
