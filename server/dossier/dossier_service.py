"""Makes dossiers: collects, signs by the site's key, and gives them out in chunks."""

import hashlib
import tempfile
import threading
import time
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any, BinaryIO, Final

from sqlalchemy import ColumnElement, func, or_, select
from sqlalchemy.orm import Session as DatabaseSession

from machine.errors import PolicyError
from machine.policy_card import CARD_FILE, GOLDEN_FILE, POLICY_FILE, read_policy
from server.accounts.accounts import Session
from server.accounts.audit_chain import AuditChain, Entry
from server.accounts.audit_seal import FIRST_SHA256
from server.clock import first_id_at, utc_now
from server.deployments.site_approvals import SiteApprovals
from server.dossier.dossier_check import AUDIT_FILE, KEYS_FILE, LOG_FILE
from server.dossier.dossier_content import (
    DossierScope,
    audit_rows,
    policy_history,
    scope_of_throw,
    throw_record,
)
from server.dossier.dossier_page import ThrowRecord, dossier_page
from server.dossier.signed_archive import (
    SIGNED_PREFIX,
    ArchiveBody,
    DossierError,
    DossierManifest,
    DossierSignature,
    canonical_json,
    chunks_of,
    model_json,
)
from server.errors import (
    ApiError,
    ConflictError,
    NotFoundError,
    TooManyRequestsError,
    UnavailableError,
)
from server.limits.disk_space import disk_standing
from server.plans.policy_store import PolicyStore
from server.schemas.console import View
from server.schemas.history import ThrowPhase
from server.settings import Settings
from server.store.database import Database
from server.store.models import Audit, Machine, StoredThrowLog, Throw
from server.throws.throw_logs import LogStore
from server.version import SOFTWARE

NAMED_COUNT: Final = 20
"""Machines that are named where an unknown one is asked for."""
MAX_THROW_COUNT: Final = 1000
MAX_PERIOD: Final = timedelta(days=366)
MAX_LOG_BYTES: Final = 1024**3
TIME_LIMIT_S: Final = 120.0
"""A browser waits this long for the first byte."""
PAGE_AUDIT_COUNT: Final = 500
"""Rows of the audit that the page shows; the file has all of them."""
PAGE_FILE: Final = "index.html"


class DossierExtentView(View):
    """How much a dossier of a period would hold."""

    throw_count: int
    log_bytes: int
    problem: str | None
    """Why there can be none; None: there can."""


@dataclass(slots=True)
class Dossier:
    """A signed dossier, ready to be given out once."""

    file_name: str
    size_bytes: int
    _before: bytes
    _scratch: BinaryIO
    _after: bytes

    def chunks(self) -> Generator[bytes]:
        """The file's bytes; its scratch file is gone afterwards."""
        with self._scratch as scratch:
            yield self._before
            scratch.seek(0)
            yield from chunks_of(scratch)
            yield self._after


class Dossiers:
    """Makes one dossier at a time; thread-safe."""

    def __init__(
        self,
        database: Database,
        audit: AuditChain,
        logs: LogStore,
        policies: PolicyStore,
        approvals: SiteApprovals,
        settings: Settings,
    ) -> None:
        self._database = database
        self._audit = audit
        self._logs = logs
        self._policies = policies
        self._approvals = approvals
        self._settings = settings
        self._turn = threading.Lock()

    def of_throw(self, throw_id: str, session: Session) -> Dossier:
        """The dossier of one throw.

        Raises:
            NotFoundError: there is no such throw.
            ApiError: as `of_period`.
        """
        with self._database.read() as database:
            throw = database.get(Throw, throw_id)
            if throw is None:
                raise NotFoundError("no_throw", f"There is no throw '{throw_id[:40]}'.")
            if throw.phase != ThrowPhase.ENDED.value:
                raise ConflictError("throw_runs", "The throw has not ended yet. Wait for its end.")
            scope = scope_of_throw(database, throw)
        return self._make(scope, [throw], session)

    def of_period(
        self, machine_id: str, since: datetime, until: datetime, session: Session
    ) -> Dossier:
        """The dossier of a machine's throws from `since` until before `until`.

        Raises:
            NotFoundError: no such machine, or no throw in that time.
            ConflictError: more throws or logs than a dossier may hold, or longer than a year.
            TooManyRequestsError: another one is being made.
            UnavailableError: the disk is full, or it takes too long.
        """
        extent = self.extent(machine_id, since, until)
        if extent.throw_count == 0:
            raise NotFoundError("no_throws", extent.problem or "")
        if extent.problem is not None:
            raise ConflictError("period_too_long", extent.problem)
        with self._database.read() as database:
            throws = database.scalars(
                select(Throw)
                .where(*_in_period(machine_id, since, until))
                .order_by(Throw.throw_id)
                .limit(MAX_THROW_COUNT)
            ).all()
        return self._make(DossierScope(machine_id, None, since, until), throws, session)

    def extent(self, machine_id: str, since: datetime, until: datetime) -> DossierExtentView:
        """How much a dossier of a period would hold.

        Raises:
            NotFoundError: no machine of this id is in service or was.
        """
        with self._database.read() as database:
            _require_machine(database, machine_id)
            count, log_bytes = database.execute(
                select(func.count(), func.coalesce(func.sum(StoredThrowLog.size_bytes), 0))
                .select_from(Throw)
                .join(StoredThrowLog, StoredThrowLog.throw_id == Throw.throw_id, isouter=True)
                .where(*_in_period(machine_id, since, until))
            ).one()
        problem = None
        if until - since > MAX_PERIOD:
            problem = f"A dossier spans at most {MAX_PERIOD.days} days."
        elif count == 0:
            problem = f"{machine_id} has no ended throw in this time."
        elif count > MAX_THROW_COUNT:
            problem = (
                f"{count} throws; a dossier holds at most {MAX_THROW_COUNT}. Shorten the period."
            )
        elif log_bytes > MAX_LOG_BYTES:
            problem = (
                f"{log_bytes // 10**6} MB of logs; a dossier holds at most {MAX_LOG_BYTES // 10**6}. "
                "Shorten the period."
            )
        return DossierExtentView(throw_count=count, log_bytes=int(log_bytes), problem=problem)

    def _make(self, scope: DossierScope, throws: Sequence[Throw], session: Session) -> Dossier:
        folder = self._settings.data_dir
        standing = disk_standing(folder, self._settings.min_free_bytes + MAX_LOG_BYTES // 8)
        if standing != "ok":
            raise UnavailableError("disk", f"No dossier can be made: the disk is {standing}.")
        if not self._turn.acquire(blocking=False):
            raise TooManyRequestsError(
                "dossier_busy", "Another dossier is being made. Try again in a minute."
            )
        try:
            # Without a name: it is gone with its last reader, also where the server dies.
            scratch: Any = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - given to the dossier
            try:
                return self._write(ArchiveBody(scratch), scope, throws, session)
            except DossierError as error:
                scratch.close()
                raise ConflictError("dossier", f"{error}.") from error
            except BaseException:
                scratch.close()
                raise
        finally:
            self._turn.release()

    def _write(
        self, body: ArchiveBody, scope: DossierScope, throws: Sequence[Throw], session: Session
    ) -> Dossier:
        end_s = time.monotonic() + TIME_LIMIT_S
        records: list[ThrowRecord] = []
        for throw in throws:
            if time.monotonic() > end_s:
                raise UnavailableError(
                    "dossier_slow", f"It takes more than {TIME_LIMIT_S:.0f} s. Shorten the period."
                )
            records.append(self._add_throw(body, throw, is_alone=scope.throw_id is not None))
        policies = [
            self._add_policy(body, sha256) for sha256 in sorted({t.policy_sha256 for t in throws})
        ]
        body.add_bytes(KEYS_FILE, model_json(self._approvals.trust()))
        with self._database.read() as database:
            sequence_count, seal = _newest_seal(database)
            shown: list[dict[str, Any]] = []
            body.add(AUDIT_FILE, _kept_lines(audit_rows(database, scope, throws), shown))
        manifest = DossierManifest(
            site=self._settings.site,
            machine_id=scope.machine_id,
            throw_id=scope.throw_id,
            since_utc=scope.since.isoformat() if scope.throw_id is None else None,
            until_utc=scope.until.isoformat() if scope.throw_id is None else None,
            throw_count=len(throws),
            created_utc=utc_now().isoformat(),
            created_by=session.username,
            software=SOFTWARE,
            audit_sequence_count=sequence_count,
            audit_sha256=seal,
            members=tuple(body.members),
        )
        page = dossier_page(manifest, records, policies, shown)
        body.add_bytes(PAGE_FILE, page.encode())
        return self._signed(
            body, manifest.model_copy(update={"members": tuple(body.members)}), session
        )

    def _add_throw(self, body: ArchiveBody, throw: Throw, *, is_alone: bool) -> ThrowRecord:
        folder = f"throws/{throw.throw_id}"
        with self._database.read() as database:
            record = throw_record(database, throw)
        for name, content in record.members:
            body.add_bytes(f"{folder}/{name}", content)
        if throw.has_log:
            try:
                body.add_file(f"{folder}/{LOG_FILE}", self._logs.path(throw.throw_id))
            except (ApiError, OSError) as error:
                raise ConflictError(
                    "log_gone", f"The log of throw {throw.throw_id} cannot be read: {error}."
                ) from error
        return record if is_alone else record.summary()

    def _add_policy(self, body: ArchiveBody, policy_sha256: str) -> dict[str, Any]:
        """Add a version's files and history; returns what the page says of it."""
        folder, stored = f"policies/{policy_sha256}", self._policies.find(policy_sha256)
        with self._database.read() as database:
            steps = policy_history(database, policy_sha256)
        body.add_bytes(f"{folder}/history.json", canonical_json(steps))
        facts: dict[str, Any] = {
            "policy_sha256": policy_sha256,
            "policy_id": self._policies.name_of(policy_sha256),
            "steps": steps,
            "approvals": [
                one.model_dump(mode="json")
                for one in self._approvals.trust().approvals
                if one.policy_sha256 == policy_sha256
            ],
        }
        if stored is None:
            return facts
        try:
            files = read_policy(stored.folder)
        except PolicyError:
            return facts  # removed meanwhile: the history stays
        body.add_bytes(f"{folder}/{POLICY_FILE}", files.policy)
        body.add_bytes(f"{folder}/{CARD_FILE}", files.text)
        if files.golden is not None:
            body.add_bytes(f"{folder}/{GOLDEN_FILE}", files.golden)
        return facts

    def _signed(self, body: ArchiveBody, manifest: DossierManifest, session: Session) -> Dossier:
        text = model_json(manifest)
        key, signature = self._approvals.sign(SIGNED_PREFIX + text)
        signed = DossierSignature(key_id=key.key_id, public_key=key.public_key, signature=signature)
        before, after = body.around(text, model_json(signed))
        self._audit.record(
            Entry(
                session.actor,
                "dossier.export",
                "fact",
                machine_id=manifest.machine_id,
                throw_id=manifest.throw_id,
                detail={
                    "manifest_sha256": hashlib.sha256(text).hexdigest(),
                    "key_id": key.key_id,
                    "throw_count": manifest.throw_count,
                    "since_utc": manifest.since_utc,
                    "until_utc": manifest.until_utc,
                },
            )
        )
        about = manifest.throw_id or f"{manifest.machine_id}_{(manifest.since_utc or '')[:10]}"
        size_bytes = len(before) + body.size_bytes + len(after)
        return Dossier(f"dossier_{about}.zip", size_bytes, before, body.scratch, after)


def _require_machine(database: DatabaseSession, machine_id: str) -> None:
    """Refuse a machine that was never in service; retired ones keep their dossiers."""
    has_served = or_(Machine.is_listed, Machine.retired_utc.is_not(None))
    known = database.scalars(
        select(Machine.machine_id).where(has_served).order_by("machine_id")
    ).all()
    if machine_id not in known:
        more = "" if len(known) <= NAMED_COUNT else f" and {len(known) - NAMED_COUNT} more"
        names = f"known: {', '.join(known[:NAMED_COUNT])}{more}" if known else "none is known yet"
        raise NotFoundError("no_machine", f"There is no machine '{machine_id[:40]}'; {names}.")


def _in_period(
    machine_id: str, since: datetime, until: datetime
) -> tuple[ColumnElement[bool], ...]:
    return (
        Throw.machine_id == machine_id,
        Throw.throw_id >= first_id_at(since),
        Throw.throw_id < first_id_at(until),
        Throw.phase == ThrowPhase.ENDED.value,
    )


def _newest_seal(database: DatabaseSession) -> tuple[int, str]:
    row = database.execute(
        select(Audit.sequence_count, Audit.row_sha256)
        .order_by(Audit.sequence_count.desc())
        .limit(1)
    ).first()
    return (0, FIRST_SHA256) if row is None else (row.sequence_count, row.row_sha256)


def _kept_lines(rows: Iterator[dict[str, Any]], shown: list[dict[str, Any]]) -> Iterator[bytes]:
    """Rows as lines; the first ones are kept for the page."""
    for row in rows:
        if len(shown) < PAGE_AUDIT_COUNT:
            shown.append(row)
        yield canonical_json(row)
