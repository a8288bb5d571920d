"""Gates in force: the defaults, or what a person has set; older settings are kept."""

from pydantic import JsonValue
from sqlalchemy import select

from evaluation.validation.gates import DEFAULT_GATES, Gates
from machine.conventions import Mode
from server.accounts.accounts import Session
from server.accounts.audit_chain import AuditChain, Entry
from server.clock import utc_now
from server.schemas.validation import GatesRequest, GatesView
from server.store.database import Database
from server.store.validation_tables import ValidationGates


class GateSettings:
    """The gates of each mode."""

    def __init__(self, database: Database, audit: AuditChain) -> None:
        self._database = database
        self._audit = audit

    def view(self, mode: Mode) -> GatesView:
        """Gates of a mode."""
        wanted = (
            select(ValidationGates)
            .where(ValidationGates.mode == mode.value)
            .order_by(ValidationGates.version_count.desc())
            .limit(1)
        )
        with self._database.read() as session:
            row = session.scalar(wanted)
        defaults = DEFAULT_GATES[mode.value]
        return GatesView(
            mode=mode,
            gates=defaults if row is None else Gates.model_validate(row.gates),
            defaults=defaults,
            version_count=0 if row is None else row.version_count,
            reason="" if row is None else row.reason,
            set_by=None if row is None else row.created_by,
            set_utc=None if row is None else row.created_utc,
        )

    def set(self, mode: Mode, request: GatesRequest, session: Session) -> GatesView:
        """Put gates into force; validations that have begun keep theirs."""
        before = self.view(mode)
        gates = request.gates.model_dump(mode="json")
        with self._database.write() as database:
            database.add(
                ValidationGates(
                    mode=mode.value,
                    version_count=before.version_count + 1,
                    gates=gates,
                    reason=request.reason,
                    created_by=session.username,
                    created_utc=utc_now(),
                )
            )
            detail: dict[str, JsonValue] = {
                "mode": mode.value,
                "gates": gates,
                "reason": request.reason,
            }
            self._audit.append(
                database, Entry(session.actor, "policy.gates", "fact", detail=detail)
            )
        return self.view(mode)
