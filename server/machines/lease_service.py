"""Leases: one session at a time may command a machine. Every change of holder raises the epoch.

The database decides; the machine enforces it by refusing lower epochs and by disarming at a higher one.
Epochs never fall: a new one is above the machine's own.
"""

import logging
from collections.abc import Callable
from datetime import datetime, timedelta
from typing import Literal

from sqlalchemy import select, update
from sqlalchemy.orm import Session as DatabaseSession

from machine.messages import RejectReason
from server.accounts.accounts import Session
from server.accounts.audit_chain import SERVER, Actor, AuditChain, Entry
from server.clock import utc_now
from server.errors import ConflictError, from_reason
from server.event_hub import EventHub
from server.machines.machine_registry import MachineRegistry
from server.schemas.console import LeaseView
from server.schemas.events import LeaseChangedEvent
from server.store.database import Database
from server.store.models import Lease

logger = logging.getLogger(__name__)

USE_NOTED_EVERY = timedelta(seconds=20)
"""How often the use of a lease is written down; small against the time after which it is given back."""
Cause = Literal["acquired", "released", "taken", "expired", "idle", "session_ended"]
LeaseListener = Callable[[str, int], None]


class LeaseService:
    """All leases. A listener learns of every new epoch after it is committed."""

    def __init__(
        self,
        database: Database,
        audit: AuditChain,
        registry: MachineRegistry,
        hub: EventHub,
        *,
        ttl_s: float,
        idle_s: float,
        now: Callable[[], datetime] = utc_now,
    ) -> None:
        self._database = database
        self._audit = audit
        self._registry = registry
        self._hub = hub
        self._ttl = timedelta(seconds=ttl_s)
        self._idle = timedelta(seconds=idle_s)
        self._now = now
        self.on_new_epoch: list[LeaseListener] = []

    def acquire(self, machine_id: str, session: Session) -> LeaseView:
        """Take a free lease, or renew one's own.

        Raises:
            ApiError: another session holds it.
        """
        self._registry.get(machine_id)
        now = self._now()
        with self._database.write() as database:
            row = self._row(database, machine_id)
            if row.holder_session_id == session.session_id and self._is_held(row, now):
                row.expires_utc = now + self._ttl
                return self._view(row)
            if self._is_held(row, now):
                self._audit.append(
                    database,
                    Entry(
                        session.actor,
                        "lease.acquire",
                        "denied",
                        machine_id=machine_id,
                        detail={"holder": row.holder},
                    ),
                )
                held = self._view(row)
            else:
                self._hand_to(database, row, session, now, "lease.acquire", {})
                held = None
            view = self._view(row)
        if held is not None:
            raise self.held_error(held)
        self._tell(view, "acquired", session.username, "")
        return view

    def take(self, machine_id: str, session: Session, reason: str) -> LeaseView:
        """Take a lease from whoever holds it; the machine disarms."""
        self._registry.get(machine_id)
        now = self._now()
        with self._database.write() as database:
            row = self._row(database, machine_id)
            detail = {"reason": reason, "from": row.holder or ""}
            self._hand_to(database, row, session, now, "lease.take", detail)
            view = self._view(row)
        self._tell(view, "taken", session.username, reason)
        return view

    def release(self, machine_id: str, session: Session) -> LeaseView:
        """Give one's lease back; the machine disarms. Harmless when it is not held."""
        self._registry.get(machine_id)
        view = self._free(machine_id, session.actor, "released", session.session_id)
        return self.view(machine_id) if view is None else view

    def end_session(self, session: Session) -> None:
        """Give back what a session held."""
        for machine_id in self._held_by(session.session_id):
            self._free(machine_id, session.actor, "session_ended", session.session_id)

    def expire_due(self) -> None:
        """Free leases that were not renewed or not used; call once a second."""
        now = self._now()
        with self._database.read() as database:
            held = database.scalars(select(Lease).where(Lease.holder_session_id.is_not(None))).all()
        for row in held:
            if not self._is_held(row, now):
                self._free(row.machine_id, SERVER, "expired", row.holder_session_id)
            elif row.active_utc is not None and now - row.active_utc > self._idle:
                self._free(row.machine_id, SERVER, "idle", row.holder_session_id)

    def free_all(self) -> None:
        """After a restart nobody holds anything: what was armed before is disarmed by the new epochs."""
        with self._database.read() as database:
            held = database.scalars(select(Lease).where(Lease.holder_session_id.is_not(None))).all()
        for row in held:
            self._free(row.machine_id, SERVER, "expired", row.holder_session_id)

    def require(self, machine_id: str, session: Session) -> LeaseView:
        """The caller's lease, noted as used.

        Raises:
            ApiError: the caller does not hold it.
        """
        self._registry.get(machine_id)
        now = self._now()
        with self._database.read() as database:
            row = database.get(Lease, machine_id)
        is_held = row is not None and self._is_held(row, now)
        if row is not None and is_held and row.holder_session_id == session.session_id:
            self._note_use(row, session.session_id, now)
            return self._view(row)
        holder = row.holder if row is not None and is_held else None
        raise from_reason(
            RejectReason.NO_LEASE,
            f"Control of {machine_id} is with {holder}. Ask them, or let a supervisor take it."
            if holder
            else f"Nobody controls {machine_id}. Take control first.",
            {"holder": holder},
        )

    def _note_use(self, row: Lease, session_id: str, now: datetime) -> None:
        # A fire must not wait for the disk to learn that its lease is in use.
        if row.active_utc is not None and now - row.active_utc < USE_NOTED_EVERY:
            return
        with self._database.write() as database:
            database.execute(
                update(Lease)
                .where(Lease.machine_id == row.machine_id, Lease.holder_session_id == session_id)
                .values(active_utc=now)
            )
        row.active_utc = now

    def view(self, machine_id: str) -> LeaseView:
        """Who holds a machine's lease."""
        with self._database.read() as database:
            row = database.get(Lease, machine_id)
            if row is None:
                return _free_view(machine_id, 0)
            return (
                self._view(row)
                if self._is_held(row, self._now())
                else _free_view(machine_id, row.epoch_count)
            )

    def epoch(self, machine_id: str) -> int:
        """The present epoch."""
        return self.view(machine_id).epoch_count

    @staticmethod
    def held_error(held: LeaseView) -> ConflictError:
        """The refusal that names the holder."""
        return ConflictError(
            RejectReason.LEASE_HELD.value,
            f"Control of {held.machine_id} is with {held.holder}. "
            "Ask them to give it back, or let a supervisor take it.",
            {"holder": held.holder},
        )

    # Inside -----------------------------------------------------------------------------------------

    def _row(self, database: DatabaseSession, machine_id: str) -> Lease:
        row = database.get(Lease, machine_id, with_for_update=True)
        if row is None:
            row = Lease(machine_id=machine_id, epoch_count=0)
            database.add(row)
        return row

    @staticmethod
    def _is_held(row: Lease, now: datetime) -> bool:
        return (
            row.holder_session_id is not None
            and row.expires_utc is not None
            and row.expires_utc > now
        )

    def _next_epoch(self, row: Lease) -> int:
        # A database restored from a backup must not fall behind what the machine has accepted before.
        state = self._registry.get(row.machine_id).state
        return max(row.epoch_count, 0 if state is None else state.epoch_count) + 1

    def _hand_to(
        self,
        database: DatabaseSession,
        row: Lease,
        session: Session,
        now: datetime,
        action: str,
        detail: dict[str, str],
    ) -> None:
        row.epoch_count = self._next_epoch(row)
        row.holder, row.holder_session_id = session.username, session.session_id
        row.acquired_utc = row.active_utc = now
        row.expires_utc = now + self._ttl
        self._audit.append(
            database,
            Entry(
                session.actor,
                action,
                "fact",
                machine_id=row.machine_id,
                detail={"epoch_count": row.epoch_count, **detail},
            ),
        )

    def _free(
        self, machine_id: str, actor: Actor, cause: Cause, session_id: str | None
    ) -> LeaseView | None:
        with self._database.write() as database:
            row = self._row(database, machine_id)
            if row.holder_session_id is None or row.holder_session_id != session_id:
                return None
            holder = row.holder or ""
            row.epoch_count = self._next_epoch(row)
            row.holder = row.holder_session_id = None
            row.acquired_utc = row.active_utc = row.expires_utc = None
            self._audit.append(
                database,
                Entry(
                    actor,
                    f"lease.{cause}",
                    "fact",
                    machine_id=machine_id,
                    detail={"epoch_count": row.epoch_count, "holder": holder},
                ),
            )
            view = self._view(row)
        self._tell(view, cause, holder, "")
        return view

    def _held_by(self, session_id: str) -> list[str]:
        with self._database.read() as database:
            return list(
                database.scalars(
                    select(Lease.machine_id).where(Lease.holder_session_id == session_id)
                )
            )

    def _view(self, row: Lease) -> LeaseView:
        return LeaseView(
            machine_id=row.machine_id,
            epoch_count=row.epoch_count,
            holder=row.holder,
            holder_session_id=row.holder_session_id,
            acquired_utc=row.acquired_utc,
            expires_utc=row.expires_utc,
            idle_release_utc=None if row.active_utc is None else row.active_utc + self._idle,
        )

    def _tell(self, view: LeaseView, cause: Cause, by: str, reason: str) -> None:
        self._hub.publish(LeaseChangedEvent(lease=view, cause=cause, by=by, reason=reason))
        for listener in self.on_new_epoch:
            try:
                listener(view.machine_id, view.epoch_count)
            except Exception:
                logger.exception("a listener failed on epoch %d", view.epoch_count)


def _free_view(machine_id: str, epoch_count: int) -> LeaseView:
    return LeaseView(
        machine_id=machine_id,
        epoch_count=epoch_count,
        holder=None,
        holder_session_id=None,
        acquired_utc=None,
        expires_utc=None,
        idle_release_utc=None,
    )
