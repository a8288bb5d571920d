"""Measured impacts of throws; rows are only ever added."""

from typing import Literal

from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from machine.messages import Target
from machine.site.thrown_material import MaterialFootprint
from server.clock import new_id, utc_now
from server.plans.landing_errors import errors_of
from server.schemas.history import ImpactView
from server.store.models import Impact, Throw

Source = Literal["survey", "tracker", "manual"]


def target_of(throw: Throw) -> Target:
    """The target of a throw."""
    return Target(x_m=throw.target_x_m, y_m=throw.target_y_m, z_m=throw.target_z_m)


def add_impact(
    database: DatabaseSession,
    throw: Throw,
    position_m: tuple[float, float, float],
    source: Source,
    *,
    sd_m: float | None,
    recorded_by: str,
    note: str = "",
    footprint: MaterialFootprint | None = None,
) -> Impact:
    """Add a record; the throw then shows the one that counts: the newest mark, else the newest survey."""
    downrange_m, crossrange_m = errors_of(target_of(throw), position_m[0], position_m[1])
    impact = Impact(
        impact_id=new_id(),
        throw_id=throw.throw_id,
        source=source,
        x_m=position_m[0],
        y_m=position_m[1],
        z_m=position_m[2],
        downrange_error_m=downrange_m,
        crossrange_error_m=crossrange_m,
        sd_m=sd_m,
        footprint=None if footprint is None else footprint.model_dump(mode="json"),
        recorded_by=recorded_by,
        note=note,
        created_utc=utc_now(),
    )
    database.add(impact)
    if source == "manual" or throw.impact_source != "manual":
        throw.measured_downrange_error_m = downrange_m
        throw.measured_crossrange_error_m = crossrange_m
        throw.impact_source = source
    return impact


def impact_views(database: DatabaseSession, throw_id: str) -> tuple[ImpactView, ...]:
    """All records of a throw, oldest first."""
    rows = database.scalars(
        select(Impact).where(Impact.throw_id == throw_id).order_by(Impact.impact_id)
    ).all()
    manual = [row for row in rows if row.source == "manual"]
    current = (manual or list(rows))[-1:] if rows else []
    return tuple(impact_view(row, is_current=row in current) for row in rows)


def impact_view(row: Impact, *, is_current: bool) -> ImpactView:
    """One record for the console."""
    source: Source = (
        "manual" if row.source == "manual" else "tracker" if row.source == "tracker" else "survey"
    )
    return ImpactView(
        impact_id=row.impact_id,
        throw_id=row.throw_id,
        source=source,
        x_m=row.x_m,
        y_m=row.y_m,
        z_m=row.z_m,
        downrange_error_m=row.downrange_error_m,
        crossrange_error_m=row.crossrange_error_m,
        sd_m=row.sd_m,
        recorded_by=row.recorded_by,
        note=row.note,
        created_utc=row.created_utc,
        is_current=is_current,
    )
