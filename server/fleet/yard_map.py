"""Where machines stand in the yard, and what is around them: the plan of a site.

Frame `yard`: metres from an origin that the site chooses, x to the right and y up on the plan. A machine's
place is the origin of its frame `machine` there, and the heading of its x axis, positive to the left.
"""

import math
from datetime import datetime
from typing import Final

from pydantic import Field, JsonValue
from sqlalchemy import delete, select

from machine.messages import Target
from machine.site.objects import SiteObjects
from machine.site.zones import Zones
from server.accounts.accounts import Session
from server.accounts.audit_chain import AuditChain, Entry
from server.clock import utc_now
from server.machines.machine_registry import MachineRegistry
from server.plans.landing_errors import point_of
from server.plans.site_store import SiteStore
from server.plans.zone_store import ZoneStore
from server.schemas.console import Request, View
from server.store.database import Database
from server.store.enrolment_models import MachinePlace
from server.store.models import Throw

IMPACT_COUNT: Final = 10
"""Newest measured impacts that a machine shows."""


class PlaceRequest(Request):
    """Where a machine stands, frame `yard`."""

    x_m: float = Field(ge=-10_000.0, le=10_000.0)
    y_m: float = Field(ge=-10_000.0, le=10_000.0)
    heading_rad: float = Field(default=0.0, ge=-math.pi, le=math.pi)


class PlaceView(View):
    """Where a machine stands, frame `yard`, as a person said."""

    x_m: float
    y_m: float
    heading_rad: float
    """Of the machine's x axis from the plan's, positive to the left."""
    changed_by: str
    changed_utc: datetime


class MapImpactView(View):
    """A measured impact, frame `machine`."""

    throw_id: str
    created_utc: datetime
    """Of the throw."""
    x_m: float
    y_m: float


class MapMachineView(View):
    """One machine on the plan; its objects, zones and impacts are in its frame `machine`."""

    machine_id: str
    place: PlaceView | None
    """None: nobody has placed it yet."""
    objects: SiteObjects
    zones: Zones
    """In force."""
    impacts: tuple[MapImpactView, ...]
    """Newest first."""


class YardMap:
    """Reads the plan and changes places."""

    def __init__(
        self,
        database: Database,
        audit: AuditChain,
        registry: MachineRegistry,
        sites: SiteStore,
        zones: ZoneStore,
    ) -> None:
        self._database = database
        self._audit = audit
        self._registry = registry
        self._sites = sites
        self._zones = zones

    def machines(self) -> list[MapMachineView]:
        """Every machine that people see, whether it has a place or a link or not."""
        with self._database.read() as database:
            places = {row.machine_id: row for row in database.scalars(select(MachinePlace))}
        return [
            MapMachineView(
                machine_id=known.machine_id,
                place=_view(places.get(known.machine_id)),
                objects=self._sites.objects(known.machine_id),
                zones=self._zones.approved(known.machine_id).zones,
                impacts=self._impacts(known.machine_id),
            )
            for known in self._registry.listed()
        ]

    def place(self, machine_id: str, body: PlaceRequest, session: Session) -> None:
        """Say where a machine stands.

        Raises:
            NotFoundError: there is none of this id.
        """
        self._registry.get(machine_id)
        values: dict[str, JsonValue] = {
            "x_m": body.x_m,
            "y_m": body.y_m,
            "heading_rad": body.heading_rad,
        }
        with self._database.write() as database:
            database.merge(
                MachinePlace(
                    machine_id=machine_id,
                    x_m=body.x_m,
                    y_m=body.y_m,
                    heading_rad=body.heading_rad,
                    changed_by=session.username,
                    changed_utc=utc_now(),
                )
            )
            entry = Entry(session.actor, "machine.place", "fact", machine_id, detail=values)
            self._audit.append(database, entry)

    def remove(self, machine_id: str, session: Session) -> None:
        """Take a machine off the plan; it stays in the fleet.

        Raises:
            NotFoundError: there is none of this id.
        """
        self._registry.get(machine_id)
        with self._database.write() as database:
            database.execute(delete(MachinePlace).where(MachinePlace.machine_id == machine_id))
            self._audit.append(
                database, Entry(session.actor, "machine.unplace", "fact", machine_id)
            )

    def _impacts(self, machine_id: str) -> tuple[MapImpactView, ...]:
        with self._database.read() as database:
            rows = database.scalars(
                select(Throw)
                .where(
                    Throw.machine_id == machine_id, Throw.measured_downrange_error_m.is_not(None)
                )
                .order_by(Throw.throw_id.desc())
                .limit(IMPACT_COUNT)
            ).all()
        return tuple(_impact(row) for row in rows)


def _view(row: MachinePlace | None) -> PlaceView | None:
    if row is None:
        return None
    return PlaceView(
        x_m=row.x_m,
        y_m=row.y_m,
        heading_rad=row.heading_rad,
        changed_by=row.changed_by,
        changed_utc=row.changed_utc,
    )


def _impact(row: Throw) -> MapImpactView:
    target = Target(x_m=row.target_x_m, y_m=row.target_y_m, z_m=row.target_z_m)
    x_m, y_m = point_of(
        target, row.measured_downrange_error_m or 0.0, row.measured_crossrange_error_m or 0.0
    )
    return MapImpactView(throw_id=row.throw_id, created_utc=row.created_utc, x_m=x_m, y_m=y_m)
