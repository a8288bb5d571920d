"""What stands around each machine, in versions: every change is a new one, and undo is a change too."""

import logging
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from machine.errors import UsageError
from machine.messages import RejectReason, Target
from machine.site.files import SITE, load_site
from machine.site.job_surface import with_job_surface
from machine.site.objects import SiteObject
from server.accounts.accounts import Session
from server.accounts.audit_chain import SERVER, Actor, AuditChain, Entry
from server.clock import utc_now
from server.errors import ApiError, ConflictError, from_reason
from server.event_hub import EventHub
from server.machines.machine_registry import MachineRegistry
from server.schemas.events import SiteUpdatedEvent
from server.schemas.sites import SiteRequest, SiteView
from server.store.database import Database
from server.store.models import SiteVersion

logger = logging.getLogger(__name__)

SurfaceAt = Callable[[str, float, float], float | None]
"""Height of the surface of a machine's job at a point (x, y), frame `machine`; None where there is none."""


class SiteStore:
    """Reads and changes sites."""

    def __init__(
        self,
        database: Database,
        audit: AuditChain,
        registry: MachineRegistry,
        hub: EventHub,
        data_dir: Path,
    ) -> None:
        self._database = database
        self._audit = audit
        self._registry = registry
        self._hub = hub
        self._folder = data_dir / "machines"
        self._lock = threading.Lock()
        self.on_change: list[Callable[[str], None]] = []
        """Called with the machine's id."""
        self.surface_at: SurfaceAt = _no_surface
        """Of the open jobs."""

    def start(self) -> None:
        """Take up `<data>/machines/<id>.site.json` of machines whose site nobody has described yet."""
        for path in sorted(self._folder.glob("*.site.json")):
            machine_id = path.name.removesuffix(".site.json")
            try:
                objects = load_site(path)
                self._registry.get(machine_id)
            except (UsageError, ApiError) as error:
                logger.warning("%s is not used: %s", path.name, error)
                continue
            with self._lock, self._database.write() as database:
                if self._newest(database, machine_id) is None:
                    row = self._row(machine_id, 0, objects, SERVER)
                    self._record(database, row, SERVER, "site.import", 0)

    def objects(self, machine_id: str) -> tuple[SiteObject, ...]:
        """What stands around a machine now."""
        with self._database.read() as database:
            return objects_of(self._newest(database, machine_id))

    def around(self, machine_id: str, target: Target) -> tuple[SiteObject, ...]:
        """What stands around a machine now, with the material of its job under a target."""
        objects = self.objects(machine_id)
        surface_m = self.surface_at(machine_id, target.x_m, target.y_m)
        if surface_m is None:
            return objects
        return with_job_surface(objects, target.x_m, target.y_m, surface_m)

    def view(self, machine_id: str) -> SiteView:
        """The site for the console.

        Raises:
            NotFoundError: no such machine.
        """
        self._registry.get(machine_id)
        with self._database.read() as database:
            row = self._newest(database, machine_id)
        return SiteView(
            machine_id=machine_id,
            version_count=0 if row is None else row.version_count,
            objects=objects_of(row),
            undo_version_count=None if row is None else row.before_version_count,
            changed_by=None if row is None else row.created_by,
            changed_utc=None if row is None else row.created_utc,
        )

    def change(self, machine_id: str, request: SiteRequest, session: Session) -> SiteView:
        """Put other objects in place of all there were.

        Raises:
            ConflictError: somebody else has changed the site meanwhile.
        """
        self._registry.get(machine_id)
        with self._lock, self._database.write() as database:
            newest = self._newest(database, machine_id)
            present = 0 if newest is None else newest.version_count
            if present != request.from_version_count:
                raise ConflictError(
                    "site_changed",
                    f"The site of {machine_id} is at version {present} now, you changed version "
                    f"{request.from_version_count}. Look at it again.",
                )
            row = self._row(machine_id, present, request.objects, session.actor)
            row.before_version_count = present
            self._record(database, row, session.actor, "site.edit", present)
        return self._announced_view(machine_id)

    def undo(self, machine_id: str, session: Session) -> SiteView:
        """Go back to the version before, as a new version that has that version's past.

        Raises:
            ConflictError: there is no version before.
        """
        self._registry.get(machine_id)
        with self._lock, self._database.write() as database:
            newest = self._newest(database, machine_id)
            if newest is None or newest.before_version_count is None:
                raise ConflictError(
                    "nothing_to_undo", f"No change of the site of {machine_id} is left to undo."
                )
            earlier = database.get(SiteVersion, (machine_id, newest.before_version_count))
            row = self._row(machine_id, newest.version_count, objects_of(earlier), session.actor)
            row.before_version_count = None if earlier is None else earlier.before_version_count
            self._record(database, row, session.actor, "site.undo", newest.version_count)
        return self._announced_view(machine_id)

    def require_unchanged(
        self, machine_id: str, target: Target, objects: Sequence[SiteObject]
    ) -> None:
        """Refuse what was previewed with another site, or other material, than are there now.

        Raises:
            ApiError: it was changed.
        """
        if tuple(objects) != self.around(machine_id, target):
            raise from_reason(
                RejectReason.SITE_CHANGED,
                "What stands around the machine was changed since the preview. Preview again.",
            )

    @staticmethod
    def _newest(database: DatabaseSession, machine_id: str) -> SiteVersion | None:
        return database.scalars(
            select(SiteVersion)
            .where(SiteVersion.machine_id == machine_id)
            .order_by(SiteVersion.version_count.desc())
            .limit(1)
        ).first()

    @staticmethod
    def _row(
        machine_id: str, present: int, objects: Sequence[SiteObject], actor: Actor
    ) -> SiteVersion:
        return SiteVersion(
            machine_id=machine_id,
            version_count=present + 1,
            objects=dump(objects),
            created_by=actor.name,
            created_utc=utc_now(),
        )

    def _record(
        self, database: DatabaseSession, row: SiteVersion, actor: Actor, action: str, present: int
    ) -> None:
        database.add(row)
        detail: dict[str, Any] = {
            "from_version_count": present,
            "version_count": row.version_count,
            "objects": row.objects,
        }
        entry = Entry(actor, action, "fact", machine_id=row.machine_id, detail=detail)
        self._audit.append(database, entry)

    def _announced_view(self, machine_id: str) -> SiteView:
        view = self.view(machine_id)
        self._hub.publish(SiteUpdatedEvent(site=view))
        for listener in self.on_change:
            listener(machine_id)
        return view


def _no_surface(_machine_id: str, _x_m: float, _y_m: float) -> None:
    return None


def dump(objects: Sequence[SiteObject]) -> list[Any]:
    """Objects as they are stored."""
    return [item.model_dump(mode="json") for item in objects]


def objects_of(row: SiteVersion | None) -> tuple[SiteObject, ...]:
    """Objects of a version; none before the first."""
    return () if row is None else SITE.validate_python(row.objects)
