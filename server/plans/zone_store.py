"""Exclusion zones of each machine, in versions: a draft is in force once a person has approved it.

Versions are only ever added; approving one writes who and when beside it, once. With four eyes nobody who
had a hand in a draft may approve it.
"""

import threading
from collections.abc import Callable, Sequence
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from machine.messages import RejectReason
from machine.site.zones import Zone, ZoneSet, zones_sha256
from server.accounts.accounts import Session
from server.accounts.audit_chain import AuditChain, Entry
from server.clock import utc_now
from server.errors import ConflictError, from_reason
from server.event_hub import EventHub
from server.machines.machine_registry import MachineRegistry
from server.schemas.events import ZonesUpdatedEvent
from server.schemas.zones import ZoneApprovalBody, ZoneChangeBody, ZonesView, ZoneVersionView
from server.store.database import Database
from server.store.models import ZoneVersion

LISTED_COUNT = 100


class ZoneStore:
    """Reads, changes and approves zones."""

    def __init__(
        self,
        database: Database,
        audit: AuditChain,
        registry: MachineRegistry,
        hub: EventHub,
        is_four_eyes: Callable[[], bool] = lambda: False,
    ) -> None:
        """Args: is_four_eyes: whoever drew zones may not approve them."""
        self._database = database
        self._audit = audit
        self._registry = registry
        self._hub = hub
        self._is_four_eyes = is_four_eyes
        self._lock = threading.Lock()
        self._approved_sets: dict[str, ZoneSet] = {}
        """Looked up at every state of a machine; written with the lock held."""
        self.on_change: list[Callable[[str], None]] = []
        """Called with the machine's id."""

    def approved(self, machine_id: str) -> ZoneSet:
        """The approved set; an empty one before the first approval."""
        known = self._approved_sets.get(machine_id)
        if known is not None:
            return known
        with self._lock:
            if machine_id not in self._approved_sets:
                with self._database.read() as database:
                    self._approved_sets[machine_id] = _set_of(
                        self._newest_approved(database, machine_id)
                    )
            return self._approved_sets[machine_id]

    def draft(self, machine_id: str) -> tuple[Zone, ...]:
        """Zones of the newest version, where they are not approved; else none."""
        view = self.view(machine_id)
        return () if view.is_approved else view.zones

    def view(self, machine_id: str) -> ZonesView:
        """The zones for the console.

        Raises:
            NotFoundError: no such machine.
        """
        self._registry.get(machine_id)
        with self._database.read() as database:
            newest = self._newest(database, machine_id)
            approval = self._newest_approved(database, machine_id)
            drawn_by = self._drawn_by(database, machine_id)
        approved = _set_of(approval)
        return ZonesView(
            machine_id=machine_id,
            version_count=0 if newest is None else newest.version_count,
            zones=_zones_of(newest),
            is_approved=newest is None or newest.zones_sha256 == approved.sha256,
            approved=approved.zones,
            approved_version_count=approved.version_count,
            approved_sha256=approved.sha256,
            reason="" if newest is None else newest.reason,
            changed_by=None if newest is None else newest.created_by,
            changed_utc=None if newest is None else newest.created_utc,
            approved_by=None if approval is None else approval.approved_by,
            approved_utc=None if approval is None else approval.approved_utc,
            undo_version_count=None if newest is None else newest.before_version_count,
            drawn_by=drawn_by,
            is_four_eyes=self._is_four_eyes(),
        )

    def versions(self, machine_id: str) -> list[ZoneVersionView]:
        """The newest versions, newest first.

        Raises:
            NotFoundError: no such machine.
        """
        self._registry.get(machine_id)
        query = (
            select(ZoneVersion)
            .where(ZoneVersion.machine_id == machine_id)
            .order_by(ZoneVersion.version_count.desc())
            .limit(LISTED_COUNT)
        )
        with self._database.read() as database:
            rows = database.scalars(query).all()
        return [
            ZoneVersionView(
                version_count=row.version_count,
                zones=_zones_of(row),
                zones_sha256=row.zones_sha256,
                reason=row.reason,
                created_by=row.created_by,
                created_utc=row.created_utc,
                approved_by=row.approved_by,
                approved_utc=row.approved_utc,
            )
            for row in rows
        ]

    def change(self, machine_id: str, body: ZoneChangeBody, session: Session) -> ZonesView:
        """Add a draft with these zones.

        Raises:
            ConflictError: somebody else has changed the zones meanwhile.
        """
        self._registry.get(machine_id)
        with self._lock, self._database.write() as database:
            newest = self._newest(database, machine_id)
            present = self._require_newest(newest, machine_id, body.from_version_count)
            row = _row(machine_id, present, body.zones, body.reason, session)
            row.before_version_count = present
            self._add(database, row, "zones.edit", session)
        return self._announced_view(machine_id)

    def undo(self, machine_id: str, session: Session) -> ZonesView:
        """Add a draft that says what the version before said, and has that version's past.

        Raises:
            ConflictError: there is no version before.
        """
        self._registry.get(machine_id)
        with self._lock, self._database.write() as database:
            newest = self._newest(database, machine_id)
            if newest is None or newest.before_version_count is None:
                raise ConflictError(
                    "nothing_to_undo", f"No change of the zones of {machine_id} is left to undo."
                )
            earlier = database.get(ZoneVersion, (machine_id, newest.before_version_count))
            reason = f"undo of version {newest.version_count}"
            row = _row(machine_id, newest.version_count, _zones_of(earlier), reason, session)
            row.before_version_count = None if earlier is None else earlier.before_version_count
            self._add(database, row, "zones.undo", session)
        return self._announced_view(machine_id)

    def approve(self, machine_id: str, body: ZoneApprovalBody, session: Session) -> ZonesView:
        """Put the newest version in force.

        Raises:
            ConflictError: it is not the one that was looked at, or approved already, or another person
                has to approve it.
        """
        self._registry.get(machine_id)
        is_four_eyes = self._is_four_eyes()
        with self._lock, self._database.write() as database:
            newest = self._newest(database, machine_id)
            self._require_newest(newest, machine_id, body.version_count)
            if newest is None or newest.approved_utc is not None:
                raise ConflictError(
                    "zones_approved", f"Version {body.version_count} is approved already."
                )
            drawn_by = self._drawn_by(database, machine_id)
            if is_four_eyes and session.username in drawn_by:
                raise ConflictError(
                    "four_eyes",
                    f"{session.username} has drawn these zones; another supervisor approves them.",
                )
            newest.approved_by, newest.approved_utc = session.username, utc_now()
            detail: dict[str, Any] = {
                "version_count": newest.version_count,
                "zones_sha256": newest.zones_sha256,
                "drawn_by": list(drawn_by),
            }
            entry = Entry(
                session.actor, "zones.approve", "fact", machine_id=machine_id, detail=detail
            )
            self._audit.append(database, entry)
            approved = _set_of(newest)
        self._approved_sets[machine_id] = approved
        return self._announced_view(machine_id)

    def require_approved(self, machine_id: str, sha256: str | None) -> None:
        """Refuse what was previewed with other zones than those that are approved.

        Raises:
            ApiError: the zones were changed.
        """
        if (sha256 or "") != self.approved(machine_id).sha256:
            raise from_reason(
                RejectReason.ZONES_MISMATCH,
                "Other exclusion zones were approved since the preview. Preview again.",
            )

    @staticmethod
    def _require_newest(newest: ZoneVersion | None, machine_id: str, version_count: int) -> int:
        present = 0 if newest is None else newest.version_count
        if present != version_count:
            raise ConflictError(
                "zones_changed",
                f"The zones of {machine_id} are at version {present} now, you looked at version "
                f"{version_count}. Look at them again.",
            )
        return present

    @staticmethod
    def _newest(database: DatabaseSession, machine_id: str) -> ZoneVersion | None:
        return database.scalars(
            select(ZoneVersion)
            .where(ZoneVersion.machine_id == machine_id)
            .order_by(ZoneVersion.version_count.desc())
            .limit(1)
        ).first()

    @staticmethod
    def _newest_approved(database: DatabaseSession, machine_id: str) -> ZoneVersion | None:
        return database.scalars(
            select(ZoneVersion)
            .where(ZoneVersion.machine_id == machine_id, ZoneVersion.approved_utc.is_not(None))
            .order_by(ZoneVersion.version_count.desc())
            .limit(1)
        ).first()

    @classmethod
    def _drawn_by(cls, database: DatabaseSession, machine_id: str) -> tuple[str, ...]:
        """Who made the versions since the newest one that says what is approved.

        All of them count: a later version may keep what an earlier one drew.
        """
        approved_sha256 = _set_of(cls._newest_approved(database, machine_id)).sha256
        query = (
            select(ZoneVersion.zones_sha256, ZoneVersion.created_by)
            .where(ZoneVersion.machine_id == machine_id)
            .order_by(ZoneVersion.version_count.desc())
        )
        names: set[str] = set()
        for sha256, created_by in database.execute(query):
            if sha256 == approved_sha256:
                break
            names.add(created_by)
        return tuple(sorted(names))

    def _add(
        self, database: DatabaseSession, row: ZoneVersion, action: str, session: Session
    ) -> None:
        database.add(row)
        detail: dict[str, Any] = {
            "version_count": row.version_count,
            "reason": row.reason,
            "zones_sha256": row.zones_sha256,
            "zones": row.zones,
        }
        entry = Entry(session.actor, action, "fact", machine_id=row.machine_id, detail=detail)
        self._audit.append(database, entry)

    def _announced_view(self, machine_id: str) -> ZonesView:
        view = self.view(machine_id)
        self._hub.publish(ZonesUpdatedEvent(zones=view))
        for listener in self.on_change:
            listener(machine_id)
        return view


def dump_zones(zones: Sequence[Zone]) -> list[Any]:
    """Zones as they are stored."""
    return [zone.model_dump(mode="json") for zone in zones]


def _row(
    machine_id: str, present: int, zones: Sequence[Zone], reason: str, session: Session
) -> ZoneVersion:
    return ZoneVersion(
        machine_id=machine_id,
        version_count=present + 1,
        zones=dump_zones(zones),
        zones_sha256=zones_sha256(zones),
        reason=reason,
        created_by=session.username,
        created_utc=utc_now(),
        approved_by=None,
        approved_utc=None,
    )


def _zones_of(row: ZoneVersion | None) -> tuple[Zone, ...]:
    return () if row is None else tuple(Zone.model_validate(item) for item in row.zones)


def _set_of(row: ZoneVersion | None) -> ZoneSet:
    if row is None:
        return ZoneSet(version_count=0)
    return ZoneSet(
        version_count=row.version_count, approved_by=row.approved_by or "", zones=_zones_of(row)
    )
