"""One throw with everything that belongs to it."""

from sqlalchemy import select

from machine.messages import EventKind
from server.errors import NotFoundError
from server.plans.plan_store import PlanStore
from server.schemas.history import ThrowDetail, ThrowEventView
from server.store.database import Database
from server.store.models import Event, Throw
from server.throws.impacts import impact_views
from server.throws.throw_logs import LogStore
from server.throws.throw_store import throw_row


def throw_detail(
    database: Database, plans: PlanStore, logs: LogStore, throw_id: str
) -> ThrowDetail:
    """Collect row, plan, impacts, events and log of a throw.

    Raises:
        NotFoundError: there is no such throw.
    """
    with database.read() as session:
        row = session.get(Throw, throw_id)
        if row is None:
            raise NotFoundError("no_throw", f"There is no throw '{throw_id[:40]}'.")
        impacts = impact_views(session, throw_id)
        events = session.scalars(
            select(Event).where(Event.throw_id == throw_id).order_by(Event.event_count)
        ).all()
    try:
        plan = plans.view(row.plan_id)
    except NotFoundError:
        plan = None  # imported throws have none
    return ThrowDetail(
        row=throw_row(row),
        plan=plan,
        epoch_count=row.epoch_count,
        impacts=impacts,
        events=tuple(
            ThrowEventView(
                boot_id=event.boot_id,
                sequence_count=event.sequence_count,
                t_mono_ns=event.t_mono_ns,
                t_utc=event.t_utc,
                kind=EventKind(event.kind),
                data=event.data,
            )
            for event in events
        ),
        log=logs.view(throw_id),
    )
