"""The site's keys as people see them: who made and revoked each, and which machines trust it.

Who and when is read from the audit. A machine says which keys it trusts when it asks what it is to have.
"""

import json
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Final

from pydantic import JsonValue
from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from machine.policy_approval import SiteTrust
from server.accounts.audit_chain import Actor, AuditChain, Entry
from server.clock import utc_now
from server.schemas.policies import SiteKeyView
from server.store.database import Database
from server.store.enrolment_models import MachineTrust
from server.store.models import Audit, Machine

MAKE_KEY: Final = "policy.make_key"
ROTATE_KEY: Final = "policy.rotate_key"
REVOKE_KEY: Final = "policy.revoke_key"


@dataclass(frozen=True, slots=True)
class TrustReport:
    """What a machine says that it trusts."""

    serial_count: int
    """Number of the site's list on board."""
    key_ids: tuple[str, ...]
    """Keys that are not revoked there."""


def keep_report(
    database: Database, audit: AuditChain, machine_id: str, report: TrustReport
) -> None:
    """Store what a machine trusts where it is news; a change of keys goes to the audit."""
    with database.read() as reading:
        row = reading.get(MachineTrust, machine_id)
        before: Sequence[str] = () if row is None else row.key_ids
        is_known = row is not None and row.serial_count == report.serial_count
    if is_known and tuple(before) == report.key_ids:
        return
    with database.write() as session:
        session.merge(
            MachineTrust(
                machine_id=machine_id,
                serial_count=report.serial_count,
                key_ids=list(report.key_ids),
                reported_utc=utc_now(),
            )
        )
        if tuple(before) != report.key_ids:
            detail: dict[str, JsonValue] = {"key_ids": list(report.key_ids)}
            actor = Actor(machine_id)
            entry = Entry(actor, "machine.trust", "fact", machine_id=machine_id, detail=detail)
            audit.append(session, entry)


def key_views(database: DatabaseSession, trust: SiteTrust) -> list[SiteKeyView]:
    """The site's keys, the newest first."""
    made = _steps(database, (MAKE_KEY, ROTATE_KEY))
    revoked = _steps(database, (REVOKE_KEY,))
    machines = _trusting(database)
    rotated = {r.new_key.key_id: r.rotated_utc for r in trust.rotations or ()}
    views: list[SiteKeyView] = []
    for key in reversed(trust.keys):
        since, maker = made.get(key.key_id, (None, "server"))
        ended, ender = revoked.get(key.key_id, (None, None)) if key.is_revoked else (None, None)
        if key.key_id in rotated:
            since = datetime.fromisoformat(rotated[key.key_id])
        views.append(
            SiteKeyView(
                key_id=key.key_id,
                public_key=key.public_key,
                is_signing=key.key_id == trust.signed_by,
                is_revoked=key.is_revoked,
                since_utc=since,
                made_by=maker,
                revoked_utc=ended,
                revoked_by=ender,
                approval_count=sum(a.key_id == key.key_id for a in trust.approvals),
                machine_ids=tuple(machines.get(key.key_id, ())),
            )
        )
    return views


def _steps(database: DatabaseSession, actions: Sequence[str]) -> Mapping[str, tuple[datetime, str]]:
    """When and by whom, by key; the newest counts, for one that failed may have come before it."""
    wanted = (
        select(Audit.t_utc, Audit.actor, Audit.detail_json)
        .where(Audit.action.in_(actions))
        .order_by(Audit.sequence_count)
    )
    return {
        json.loads(detail).get("key_id", ""): (at, actor)
        for at, actor, detail in database.execute(wanted)
    }


def _trusting(database: DatabaseSession) -> Mapping[str, list[str]]:
    """Machines in service by the keys that they trust."""
    wanted = (
        select(MachineTrust)
        .join(Machine, Machine.machine_id == MachineTrust.machine_id)
        .where(Machine.retired_utc.is_(None))
        .order_by(MachineTrust.machine_id)
    )
    found: dict[str, list[str]] = defaultdict(list)
    for row in database.scalars(wanted):
        for key_id in row.key_ids:
            found[key_id].append(row.machine_id)
    return found
