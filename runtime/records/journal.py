"""What the machine must remember over restarts: the lease epoch, throws begun and ended, logs to upload.

Rules: a fire is written down before it is executed; the end of a throw and its event are one transaction,
so that each throw is reported ended exactly once, whoever reports it.
"""

import logging
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from machine.messages import EventKind, MachineEvent, ThrowEnd
from machine.site.zones import ZoneSet
from runtime.records.log_writer import StoredLog
from runtime.records.outbox import THROW_MEMORY_COUNT, EventDraft, Outbox, utc_now

logger = logging.getLogger(__name__)

INTENDED = "intended"
"""A fire command came in; the control process has not answered yet."""
RUNNING = "running"
ENDED = "ended"
_ZONES = "zones"


class _ZoneRecord(BaseModel):
    """Exclusion zones as they are stored; the hash shows damage."""

    sha256: str
    zone_set: ZoneSet


@dataclass(frozen=True, slots=True)
class Memory:
    """What the control process is given at its start."""

    epoch_count: int
    throw_ids: tuple[str, ...]
    """Fired before, newest last: never to be executed again."""


class Journal:
    """Throws and the lease epoch, in the outbox's file."""

    def __init__(self, outbox: Outbox) -> None:
        self._outbox = outbox

    def memory(self) -> Memory:
        """What a restarted control process must know."""
        with self._outbox.transaction() as database:
            rows = database.execute(
                "SELECT throw_id FROM throws ORDER BY id DESC LIMIT ?", (THROW_MEMORY_COUNT,)
            ).fetchall()
        return Memory(self.epoch_count(), tuple(str(row[0]) for row in reversed(rows)))

    def epoch_count(self) -> int:
        """The highest lease epoch seen."""
        return int(self._outbox.meta("epoch_count", "0"))

    def raise_epoch(self, epoch_count: int) -> None:
        """Remember a higher epoch; a lower one changes nothing."""
        if epoch_count > self.epoch_count():
            with self._outbox.transaction():
                self._outbox.set_meta("epoch_count", str(epoch_count))

    # Exclusion zones ------------------------------------------------------------------------------

    def zone_set(self) -> ZoneSet:
        """The stored exclusion zones; none before the first.

        Raises:
            ValueError: they cannot be read, or were lost with the records.
        """
        text = self._outbox.meta(_ZONES, "")
        if not text:
            return ZoneSet(version_count=0)
        record = _ZoneRecord.model_validate_json(text)
        if record.sha256 != record.zone_set.sha256:
            raise ValueError("the stored exclusion zones are not those that were approved")
        return record.zone_set

    def zones_for_control(self) -> dict[str, Any] | None:
        """The stored exclusion zones as JSON; None where they cannot be read."""
        try:
            return self.zone_set().model_dump(mode="json")
        except ValueError as error:
            logger.error("the exclusion zones cannot be read: %s", error)
            return None

    def keep_zones(self, zone_set: ZoneSet) -> None:
        """Store another set; durable when this returns."""
        record = _ZoneRecord(sha256=zone_set.sha256, zone_set=zone_set)
        with self._outbox.transaction():
            self._outbox.set_meta(_ZONES, record.model_dump_json())

    def forget_zones(self) -> None:
        """Note that zones may have been lost with the records: nobody knows them until others are stored."""
        with self._outbox.transaction():
            self._outbox.set_meta(_ZONES, "lost")

    # Throws ---------------------------------------------------------------------------------------

    def boot_id(self) -> str:
        """The boot that was last begun; empty before the first."""
        return self._outbox.meta("boot_id", "")

    def intend_throw(self, throw_id: str) -> bool:
        """Write a fire down before it is passed on; False when this throw is known already."""
        with self._outbox.transaction() as database:
            added = database.execute(
                "INSERT OR IGNORE INTO throws (throw_id, state) VALUES (?, ?)", (throw_id, INTENDED)
            )
            return added.rowcount == 1

    def forget_intent(self, throw_id: str) -> None:
        """The control process refused the fire: it was never executed and may be tried again."""
        with self._outbox.transaction() as database:
            database.execute(
                "DELETE FROM throws WHERE throw_id=? AND state=?", (throw_id, INTENDED)
            )

    def open_throws(self) -> tuple[str, ...]:
        """Throws without an end."""
        with self._outbox.transaction() as database:
            rows = database.execute(
                "SELECT throw_id FROM throws WHERE state != ? ORDER BY id", (ENDED,)
            ).fetchall()
        return tuple(str(row[0]) for row in rows)

    def begin_boot(self, boot_id: str, draft: EventDraft) -> tuple[str, ...]:
        """Begin a boot: its first event, and the end of every throw that an earlier boot left open.

        Returns:
            Ids of the interrupted throws. Nothing happens when this boot was begun before.
        """
        with self._outbox.transaction() as database:
            if self.boot_id() == boot_id:
                return ()
            self._outbox.set_meta("boot_id", boot_id)
            self._outbox.add(boot_id, draft)
            rows = database.execute(
                "SELECT throw_id, plan_id, state FROM throws WHERE state != ? ORDER BY id", (ENDED,)
            ).fetchall()
            for throw_id, plan_id, state in rows:
                self._interrupt(boot_id, throw_id, plan_id, state, draft.t_mono_ns)
            self._prune()
        return tuple(str(row[0]) for row in rows)

    def _interrupt(
        self, boot_id: str, throw_id: str, plan_id: str | None, state: str, t_mono_ns: int
    ) -> None:
        detail = (
            "the machine's computer stopped during the throw"
            if state == RUNNING
            else "the machine's computer stopped before it answered the fire command"
        )
        end = ThrowEnd(outcome="interrupted", detail=detail)
        draft = EventDraft(
            EventKind.THROW_ENDED,
            t_mono_ns,
            throw_id,
            plan_id,
            end.model_dump(mode="json"),
            utc_now(),
        )
        self._end(boot_id, draft)

    def record(self, boot_id: str, number: int, draft: EventDraft) -> MachineEvent | None:
        """Store an event of the control process once; None when it is stored already or not to be.

        A second end of the same throw is not to be: the first one stands.
        """
        with self._outbox.transaction() as database:
            # Number 0: the link process's own, which is given once.
            if number and not self._outbox.is_new_control_event(boot_id, number):
                return None
            if draft.kind == EventKind.THROW_ACCEPTED:
                database.execute(
                    "INSERT INTO throws (throw_id, plan_id, state) VALUES (?, ?, ?)"
                    " ON CONFLICT (throw_id) DO UPDATE SET plan_id=excluded.plan_id,"
                    " state=excluded.state WHERE state=?",
                    (draft.throw_id, draft.plan_id, RUNNING, INTENDED),
                )
            if draft.kind == EventKind.THROW_ENDED:
                return self._end(boot_id, draft)
            return self._outbox.add(boot_id, draft)

    def _end(self, boot_id: str, draft: EventDraft) -> MachineEvent | None:
        with self._outbox.transaction() as database:
            ended = database.execute(
                "UPDATE throws SET state=? WHERE throw_id=? AND state!=?",
                (ENDED, draft.throw_id, ENDED),
            )
            return self._outbox.add(boot_id, draft) if ended.rowcount == 1 else None

    # Logs -----------------------------------------------------------------------------------------

    def add_log(self, boot_id: str, log: StoredLog, t_mono_ns: int) -> MachineEvent | None:
        """A log lies on the disk: report it and queue its upload; once a throw."""
        with self._outbox.transaction() as database:
            changed = database.execute(
                "UPDATE throws SET has_log=1 WHERE throw_id=? AND has_log=0", (log.throw_id,)
            )
            if changed.rowcount == 0:
                return None
            data = {"log_sha256": log.log_sha256, "size_bytes": log.size_bytes}
            draft = EventDraft(EventKind.LOG_STORED, t_mono_ns, log.throw_id, None, data, utc_now())
            return self._outbox.add(boot_id, draft)

    def without_log(self) -> tuple[str, ...]:
        """Ended throws of which no log was reported, oldest first."""
        with self._outbox.transaction() as database:
            rows = database.execute(
                "SELECT throw_id FROM throws WHERE has_log=0 AND state=? ORDER BY id", (ENDED,)
            ).fetchall()
        return tuple(str(row[0]) for row in rows)

    def to_upload(self) -> tuple[str, ...]:
        """Throws whose log the server does not have, oldest first; at most a hundred."""
        with self._outbox.transaction() as database:
            rows = database.execute(
                "SELECT throw_id FROM throws WHERE has_log=1 AND is_uploaded=0 ORDER BY id LIMIT 100"
            ).fetchall()
        return tuple(str(row[0]) for row in rows)

    def surplus_logs(self, kept_count: int) -> tuple[str, ...]:
        """Uploaded throws older than the newest `kept_count` throws: their files may go."""
        with self._outbox.transaction() as database:
            rows = database.execute(
                "SELECT throw_id FROM throws WHERE has_log=1 AND is_uploaded=1 AND id <="
                " (SELECT max(id) FROM throws) - ? ORDER BY id",
                (kept_count,),
            ).fetchall()
        return tuple(str(row[0]) for row in rows)

    def mark_uploaded(self, throw_id: str) -> None:
        """The server has the log (or it can never have it)."""
        with self._outbox.transaction() as database:
            database.execute("UPDATE throws SET is_uploaded=1 WHERE throw_id=?", (throw_id,))

    def _prune(self) -> None:
        with self._outbox.transaction() as database:
            database.execute(
                "DELETE FROM throws WHERE state=? AND (has_log=0 OR is_uploaded=1) AND id <="
                " (SELECT max(id) FROM throws) - ?",
                (ENDED, THROW_MEMORY_COUNT),
            )
            database.execute(
                "DELETE FROM boots WHERE boot_id != ? AND boot_id NOT IN (SELECT boot_id FROM events)",
                (self.boot_id(),),
            )
