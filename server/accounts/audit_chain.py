"""The audit: an append-only chain of rows, each sealed with the hash of the one before.

A command's `intent` row is committed before the command is sent. The chain's end is written to an anchor
file at start and end of the service, so that a truncated chain is detected.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from pydantic import JsonValue
from sqlalchemy import select, text
from sqlalchemy.orm import Session

from machine.messages import Command
from server.accounts.audit_seal import FIRST_SHA256, SEALED_FIELDS, seal_of
from server.clock import utc_now
from server.schemas.audit import AuditVerdict
from server.secret_files import make_private
from server.store.database import Database
from server.store.models import Audit

Phase = Literal["intent", "outcome", "denied", "fact"]
_POSTGRES_LOCK = 0x41554449
"""Key of the advisory lock that makes appends wait for each other ("AUDI")."""
_VERIFY_CHUNK = 5000


@dataclass(frozen=True, slots=True)
class Actor:
    """Who acts: a person in a session, or the server itself."""

    name: str
    session_id: str | None = None


SERVER = Actor("server")


@dataclass(frozen=True, slots=True)
class Entry:
    """What is written into the chain."""

    actor: Actor
    action: str
    phase: Phase
    machine_id: str | None = None
    throw_id: str | None = None
    detail: dict[str, JsonValue] = field(default_factory=dict[str, JsonValue])


class AuditChain:
    """Appends to and checks the chain."""

    def __init__(self, database: Database, anchor_path: Path) -> None:
        self._database = database
        self._anchor_path = anchor_path

    def append(self, session: Session, entry: Entry) -> int:
        """Add a row within a write transaction; returns its sequence number."""
        if self._database.dialect == "postgresql":
            session.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _POSTGRES_LOCK})
        session.flush()
        last = session.execute(
            select(Audit.sequence_count, Audit.row_sha256)
            .order_by(Audit.sequence_count.desc())
            .limit(1)
        ).first()
        row = Audit(
            sequence_count=1 if last is None else last.sequence_count + 1,
            t_utc=utc_now(),
            actor=entry.actor.name[:64],
            session_id=entry.actor.session_id,
            machine_id=entry.machine_id,
            throw_id=entry.throw_id,
            action=entry.action,
            phase=entry.phase,
            detail_json=json.dumps(entry.detail, sort_keys=True, separators=(",", ":")),
            previous_sha256=FIRST_SHA256 if last is None else last.row_sha256,
            row_sha256="",
        )
        row.row_sha256 = row_hash(row)
        session.add(row)
        session.flush()
        return row.sequence_count

    def record(self, entry: Entry) -> int:
        """Add a row in a transaction of its own; when this returns it is on disk."""
        with self._database.write() as session:
            return self.append(session, entry)

    def anchor(self) -> None:
        """Write the chain's end to the anchor file."""
        with self._database.read() as session:
            last = session.execute(
                select(Audit.sequence_count, Audit.row_sha256)
                .order_by(Audit.sequence_count.desc())
                .limit(1)
            ).first()
        if last is None:
            return
        line = json.dumps(
            {
                "t_utc": utc_now().isoformat(),
                "sequence_count": last.sequence_count,
                "row_sha256": last.row_sha256,
            }
        )
        make_private(self._anchor_path)
        with self._anchor_path.open("a", encoding="utf-8") as file:
            file.write(line + "\n")

    def verify(self) -> AuditVerdict:
        """Walk the whole chain and compare it with the anchors."""
        anchors = self._anchors()
        count, previous = 0, FIRST_SHA256
        for row in self._rows():
            problem = _problem(row, count + 1, previous)
            anchored = anchors.pop(row.sequence_count, row.row_sha256)
            if problem is None and anchored != row.row_sha256:
                problem = f"row {row.sequence_count} is not the one that was anchored"
            if problem is not None:
                return AuditVerdict(
                    is_intact=False,
                    row_count=count,
                    first_bad_sequence_count=row.sequence_count,
                    problem=problem,
                )
            count, previous = count + 1, row.row_sha256
        if anchors:
            missing = min(anchors)
            return AuditVerdict(
                is_intact=False,
                row_count=count,
                first_bad_sequence_count=missing,
                problem=f"the chain ends at row {count}, but row {missing} was anchored: rows are cut off",
            )
        return AuditVerdict(
            is_intact=True, row_count=count, first_bad_sequence_count=None, problem=None
        )

    def _rows(self) -> Iterator[Audit]:
        after = 0
        while True:
            with self._database.read() as session:
                rows = session.scalars(
                    select(Audit)
                    .where(Audit.sequence_count > after)
                    .order_by(Audit.sequence_count)
                    .limit(_VERIFY_CHUNK)
                ).all()
            if not rows:
                return
            yield from rows
            after = rows[-1].sequence_count

    def _anchors(self) -> dict[int, str]:
        if not self._anchor_path.exists():
            return {}
        anchors: dict[int, str] = {}
        for line in self._anchor_path.read_text(encoding="utf-8").splitlines():
            try:
                item = json.loads(line)
                anchors[int(item["sequence_count"])] = str(item["row_sha256"])
            except (ValueError, KeyError, TypeError):
                continue  # a line that a crash cut off anchors nothing
        return anchors


def sealed_values(row: Audit) -> dict[str, str | int | None]:
    """What the seal of a row covers, by name."""
    values = {name: getattr(row, name) for name in SEALED_FIELDS}
    return values | {"t_utc": row.t_utc.isoformat(timespec="microseconds")}


def row_hash(row: Audit) -> str:
    """Seal of a row."""
    return seal_of(row.previous_sha256, list(sealed_values(row).values()))


def _problem(row: Audit, expected_count: int, previous: str) -> str | None:
    if row.sequence_count != expected_count:
        return f"row {expected_count} is missing"
    if row.previous_sha256 != previous:
        return f"row {row.sequence_count} does not follow the one before"
    if row.row_sha256 != row_hash(row):
        return f"row {row.sequence_count} was changed"
    return None


def intent_of(command: Command, actor: Actor, throw_id: str | None = None) -> Entry:
    """The audit row that goes before a command."""
    return Entry(
        actor,
        command.kind,
        "intent",
        machine_id=command.machine_id,
        throw_id=throw_id,
        detail=_without_nonce(command),
    )


def _without_nonce(command: Command) -> dict[str, JsonValue]:
    content: dict[str, JsonValue] = command.model_dump(mode="json")
    content.pop("nonce", None)  # a valid nonce permits a throw; it must not appear in a log
    return content
