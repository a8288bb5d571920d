"""What a dossier says, from the database: throws, plans, impacts, audit rows, policy versions."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any, Final

from sqlalchemy import ColumnElement, and_, or_, select
from sqlalchemy.orm import Session as DatabaseSession
from sqlalchemy.orm import undefer

from server.accounts.audit_chain import sealed_values
from server.dossier.dossier_page import ThrowRecord
from server.dossier.signed_archive import DossierError, canonical_json
from server.plans.plan_views import plan_view, unpack_frames
from server.store.models import Audit, Event, Plan, PolicyTransition, Throw
from server.throws.impacts import impact_views
from server.throws.throw_store import throw_row

AFTER_THROW: Final = timedelta(minutes=10)
"""How long after a throw what happens to its machine still belongs to it."""
BEFORE_THROW: Final = timedelta(minutes=10)
"""The same before it, where no plan says when it was begun."""
AUDIT_CHUNK: Final = 1000
MAX_AUDIT_ROWS: Final = 200_000


@dataclass(frozen=True, slots=True)
class DossierScope:
    """What a dossier is about."""

    machine_id: str
    throw_id: str | None
    """None: of a period."""
    since: datetime
    until: datetime


def scope_of_throw(database: DatabaseSession, throw: Throw) -> DossierScope:
    """The time from a throw's plan until some minutes after it."""
    plan = database.get(Plan, throw.plan_id)
    begun = throw.created_utc - BEFORE_THROW if plan is None else plan.created_utc
    return DossierScope(throw.machine_id, throw.throw_id, begun, throw.created_utc + AFTER_THROW)


def throw_record(database: DatabaseSession, throw: Throw) -> ThrowRecord:
    """Collect what belongs to a throw, its log apart."""
    plan = database.get(Plan, throw.plan_id, options=[undefer(Plan.frames)])
    facts = {
        "throw": throw_row(throw).model_dump(mode="json"),
        "operator": throw.operator,
        "session_id": throw.session_id,
        "lease_epoch_count": throw.epoch_count,
        "requested_utc": throw.created_utc.isoformat(),
        "plan_hash": None if plan is None else plan.plan_hash,
    }
    impacts = [view.model_dump(mode="json") for view in impact_views(database, throw.throw_id)]
    rows = database.scalars(
        select(Event).where(Event.throw_id == throw.throw_id).order_by(Event.event_count)
    )
    events = [
        {
            "boot_id": row.boot_id,
            "sequence_count": row.sequence_count,
            "t_mono_ns": row.t_mono_ns,
            "t_utc": row.t_utc,
            "kind": row.kind,
            "data": row.data,
            "received_utc": row.received_utc.isoformat(),
        }
        for row in rows
    ]
    members = [
        ("throw.json", canonical_json(facts)),
        ("impacts.json", canonical_json(impacts)),
        ("events.jsonl", b"".join(canonical_json(event) for event in events)),
    ]
    shown: dict[str, Any] | None = None
    if plan is not None:
        shown = plan_view(plan).model_dump(mode="json")
        preview = {
            "plan": shown,
            "site": plan.site,
            "zones": plan.zones,
            "start_rad_or_m": plan.start_rad_m,
            "armed_utc": None if plan.armed_utc is None else plan.armed_utc.isoformat(),
        }
        members.append(("preview.json", canonical_json(preview)))
        if plan.plan_json is not None:
            members.append(("plan.json", plan.plan_json.encode()))
        if plan.frames is not None:
            frames = unpack_frames(plan.frames).model_dump_json().encode()
            members.append(("preview_motion.json", frames))
    return ThrowRecord(facts, tuple(members), tuple(impacts), tuple(events), shown)


def audit_rows(
    database: DatabaseSession, scope: DossierScope, throws: Sequence[Throw]
) -> Iterator[dict[str, Any]]:
    """The rows of the audit that concern a dossier, oldest first, each with its seal and the one before.

    They are those of the throws, of the machine within the scope's time, of the lease under which it begins,
    of the people's logins, and of the life of the policy versions.

    Raises:
        DossierError: too many.
    """
    conditions = _conditions(database, scope, throws)
    after, count = 0, 0
    while True:
        rows = database.scalars(
            select(Audit)
            .where(or_(*conditions), Audit.sequence_count > after)
            .order_by(Audit.sequence_count)
            .limit(AUDIT_CHUNK)
        ).all()
        for row in rows:
            seals = {"previous_sha256": row.previous_sha256, "row_sha256": row.row_sha256}
            yield {**sealed_values(row), **seals}
        if len(rows) < AUDIT_CHUNK:
            return
        after, count = rows[-1].sequence_count, count + len(rows)
        if count >= MAX_AUDIT_ROWS:
            raise DossierError(
                f"there are more than {MAX_AUDIT_ROWS} audit rows; shorten the period"
            )


def _conditions(
    database: DatabaseSession, scope: DossierScope, throws: Sequence[Throw]
) -> list[ColumnElement[bool]]:
    conditions: list[ColumnElement[bool]] = [
        and_(
            Audit.machine_id == scope.machine_id,
            Audit.t_utc >= scope.since,
            Audit.t_utc <= scope.until,
        ),
        Audit.throw_id.in_([throw.throw_id for throw in throws]),
        and_(
            Audit.action == "login",
            Audit.session_id.in_({throw.session_id for throw in throws}),
        ),
    ]
    lease = database.scalar(
        select(Audit.sequence_count)
        .where(
            Audit.machine_id == scope.machine_id,
            Audit.action.in_(("lease.acquire", "lease.take")),
            Audit.phase == "fact",
            Audit.t_utc < scope.since,
        )
        .order_by(Audit.sequence_count.desc())
        .limit(1)
    )
    if lease is not None:
        conditions.append(Audit.sequence_count == lease)
    conditions += [
        and_(
            Audit.action >= "policy.",
            Audit.action < "policy/",
            Audit.detail_json.contains(policy_sha256, autoescape=True),
        )
        for policy_sha256 in sorted({throw.policy_sha256 for throw in throws})
    ]
    return conditions


def policy_history(database: DatabaseSession, policy_sha256: str) -> list[dict[str, Any]]:
    """The steps of a version, oldest first: who, when, why, on what it rested."""
    rows = database.scalars(
        select(PolicyTransition)
        .where(PolicyTransition.policy_sha256 == policy_sha256)
        .order_by(PolicyTransition.transition_count)
    )
    return [
        {
            "from_state": row.from_state,
            "to_state": row.to_state,
            "actor": row.actor,
            "reason": row.reason,
            "evidence": row.evidence,
            "at_utc": row.at_utc.isoformat(),
        }
        for row in rows
    ]
